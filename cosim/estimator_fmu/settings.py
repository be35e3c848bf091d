"""Settings of an estimator FMU from its scenario, as JSON values that are written into its entry script."""

import re
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import asdict, fields
from math import inf, nextafter
from typing import Any

import numpy as np

from estimator import Sample, Vector
from estimator.triggers import TriggerSettings
from fmu_models.kernel.description import base_unit

from ..errors import ScenarioError
from ..fmi.archive import FmuFile
from ..fmi.component import read_component
from ..objectives.choice import chosen
from ..retuning.assembly import make_supervisor, through_actuators, try_model
from ..retuning.estimators import find_method
from ..scenarios.scenario import Scenario
from ..system.fmu_cache import fmu_paths
from ..system.parameters import check_parameters, first_states, start_value
from ..system.plant import Plant, plant_of
from ..system.tuning import check_first_values, first_parameters, tuning_rule, written_variables
from ..system.wiring import wire
from ..variable_name import VariableName


def estimator_settings(scenario: Scenario, method: str = "target") -> dict[str, Any]:
    """Return the settings of the scenario's estimator FMU, as JSON values. Raises what `build_estimator` does."""
    if ":" in method or method in ("none", "true"):
        raise ScenarioError(f"'{method}' cannot be built into an FMU; the estimators of the package can.")
    if scenario.sampling.filter is not None:
        raise ScenarioError("sampling.filter cannot be built into an FMU: its estimator takes measured derivatives.")
    how = find_method(method, scenario)
    if chosen(scenario).kind != "derivative":
        raise ScenarioError("estimation.objective: an estimator FMU takes derivatives; it cannot hold other FMUs.")
    fmus = {name: FmuFile(name, read_component(path).description) for name, path in fmu_paths(scenario).items()}
    plant = plant_of(scenario, fmus[scenario.plant])
    check_parameters(scenario, fmus)
    wire(scenario, fmus)
    theta = np.array(first_parameters(scenario, fmus))
    check_first_values(scenario, tuning_rule(scenario), theta)
    _try(scenario, method, plant, fmus, theta)
    loop, linear = scenario.estimation.loop(method), scenario.estimation.linear
    variables = _Variables(scenario, fmus, plant)
    tracking_unit = variables.of(next(iter(scenario.tracking)))["unit"]
    return {
        "experiment": [scenario.scenario.start_time, scenario.scenario.stop_time, scenario.scenario.macro_step],
        "model": scenario.estimation.model,
        "linear": [linear.rows, linear.coefficients] if linear and how.needs_linear_form else None,
        "method": method,
        "settings": asdict(scenario.estimation.settings(method)),
        "requires": ["numpy", "scipy", "GPy", *([how.needs_package] if how.needs_package else [])],
        "parameters": [
            {
                "name": p.name, "lower": p.lower, "upper": p.upper, "unit": p.unit, "fmi_unit": _fmi_unit(p.unit),
                "scale": p.scale, "start": min(max(start, p.lower), p.upper),
            }
            for p, start in zip(scenario.estimation.parameters, theta.tolist(), strict=True)
        ],
        "rule": _rule(scenario, fmus),
        "states": [variables.of(VariableName(f"{plant.name}.{name}")) for name in plant.states],
        "inputs": [variables.of(VariableName(f"{plant.name}.{name}")) for name in plant.inputs],
        "may_lag": through_actuators(scenario, plant),
        "held": [_suffixed(name, "_held") for name in plant.inputs],
        "derivatives": [
            variables.of(reference)
            | {"noise": noise.noise, "channel": channel, "noise_name": "noise_" + _word(reference.variable)}
            for (reference, noise), channel in zip(scenario.sampling.derivatives.items(), plant.channels, strict=True)
        ],
        "watched": variables.watched,
        "tracking": [[variables.name_of(a), variables.name_of(b)] for a, b in scenario.tracking.items()],
        "tracking_unit": tracking_unit,
        "trigger": loop.trigger.kind,
        "trigger_parameters": _trigger_parameters(loop.trigger, tracking_unit),
        "commit": loop.commit,
        "diagnosis": asdict(scenario.diagnosis),
        "loop": {
            "budget": loop.budget, "evaluations_per_step": loop.evaluations_per_step, "window": loop.window, "seed": 0,
        },
    }  # fmt: skip


def _rule(scenario: Scenario, fmus: Mapping[str, FmuFile]) -> list[dict[str, Any]]:
    """Return name, formula and unit of the controllers' parameters that formulas give, which are outputs."""
    variables = written_variables(scenario, fmus)
    names = [name.variable for name in variables]
    return [
        {
            "name": name.variable if names.count(name.variable) == 1 else str(name),
            "formula": scenario.formulas[name], "unit": _fmi_unit(v.unit or "1"), "of": name.component,
        }
        for name, v in variables.items()
    ]  # fmt: skip


def _trigger_parameters(trigger: TriggerSettings, tracking_unit: str | None) -> list[dict[str, Any]]:
    """Return the trigger's numbers as parameters of the FMU; for an excluded limit, min or max is the next number."""
    return [
        {
            "name": f.name, "unit": tracking_unit if f.metadata["is_tracking_error"] else "1",
            "start": getattr(trigger, f.name), "text": f.metadata["description"],
            "min": max(nextafter(f.metadata["gt"], inf), sys.float_info.min),
            "max": nextafter(f.metadata["lt"], -inf) if "lt" in f.metadata else None,
        }
        for f in fields(trigger)
        if f.name != "kind"
    ]  # fmt: skip


class _Variables:
    """Inputs of the estimator, named as the FMUs' variables, with the component's name where ambiguous."""

    def __init__(self, scenario: Scenario, fmus: Mapping[str, FmuFile], plant: Plant) -> None:
        self._scenario, self._fmus = scenario, fmus
        own = {VariableName(f"{plant.name}.{name}") for name in plant.states} | set(scenario.sampling.derivatives)
        taken = {reference.variable for reference in own}
        self._names: dict[str, str] = {}
        self.watched: list[dict[str, Any]] = []
        """Tracked variables and their references, except those that are states."""
        for reference in (r for pair in scenario.tracking.items() for r in pair if r not in own):
            if reference not in self._names:
                name = reference.variable
                self._names[reference] = reference if name in taken else name
                taken.add(self._names[reference])
                text = f"{reference.component}: {self._declared(reference).description or name}"
                self.watched.append(self.of(reference) | {"text": text})

    def name_of(self, reference: VariableName) -> str:
        return self._names.get(reference) or reference.variable

    def of(self, reference: VariableName) -> dict[str, Any]:
        declared = self._declared(reference)
        has_start = declared.start is not None
        start = start_value(self._scenario, self._fmus, reference) if has_start else 0.0
        return {"name": self.name_of(reference), "unit": _fmi_unit(declared.unit or "1"), "start": start}

    def _declared(self, reference: VariableName) -> Any:
        component, name = reference.parts
        return next(v for v in self._fmus[component].description.modelVariables if v.name == name)


def _try(scenario: Scenario, method: str, plant: Plant, fmus: Mapping[str, FmuFile], theta: Vector) -> None:
    """Construct the FMU's loop, and call the model once. Raises ScenarioError."""
    with ExitStack() as stack:
        make_supervisor(scenario, method, plant, theta, np.random.default_rng(0), stack)
    x, _ = first_states(scenario, fmus, plant)
    first = Sample(0.0, tuple(x), tuple(plant.inputs.values()), (0.0,) * len(plant.channels))
    try_model(scenario, method, plant, theta, first)


def _fmi_unit(unit: str) -> str | None:
    """Return the unit, if its dimension is known; a wrong one would be worse than none."""
    try:
        base_unit(unit)
    except ValueError:
        return None
    return unit


def _suffixed(name: str, suffix: str) -> str:
    """Return the name with a suffix: `u_held`, and for an element of an array `u_held[1]`."""
    stem, bracket, index = name.partition("[")
    return stem + suffix + bracket + index


def _word(name: str) -> str:
    """Return `der(v_x)` as a part of a name: `der_v_x`."""
    return re.sub(r"\W+", "_", name).strip("_")
