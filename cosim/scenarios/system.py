"""From a scenario's names to wired FMUs: which variables are set and read, and in which groups the FMUs step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import ScenarioError, WiringError, seconds
from ..fmi.archive import FmuFile
from ..fmi.component import ModelVariable
from ..fmi.ports import attribute, is_numeric
from ..fmi.table import TableSlave
from ..master import Wiring
from ..names import did_you_mean
from ..slaves.slave import Slave
from .library import find_fmu, find_table
from .scenario import Scenario
from .schema import Component, EstimatedParameter
from .unit_conversions import unit_conversions

Described = Slave | FmuFile | TableSlave


@dataclass(frozen=True)
class Plant:
    """The component whose derivatives or outputs are sampled, as the estimator's model sees it."""

    name: str
    """Instance name."""
    states: tuple[str, ...]
    """Its states, in the order of the model description: the model's x. None where there is no model and they are
    not all outputs."""
    inputs: Mapping[str, float]
    """Its inputs with their start values, in the order of the model description: the model's u."""
    channels: tuple[int, ...]
    """Places in x of the states whose derivatives are sampled."""


def fmu_paths(scenario: Scenario) -> dict[str, Path]:
    """File of each component's FMU, built where need be, or table. Raises ScenarioError."""
    return {name: component_path(c, scenario.folder) for name, c in scenario.components.items()}


def component_path(component: Component, folder: Path) -> Path:
    """File of a component's FMU, built where need be, or table. Raises ScenarioError."""
    if component.fmu is not None:
        return find_fmu(component.fmu, folder, component.fmi)
    return find_table(component.table or "", folder)


def wire(scenario: Scenario, slaves: Mapping[str, Described]) -> tuple[dict[str, Wiring], list[list[str]]]:
    """Each component's part in the co-simulation, and the groups in which they step. Raises WiringError.

    Sequential coupling: first those whose parameters are re-tuned, the controllers, then all others.
    """
    sources: dict[str, dict[str, str]] = {name: {} for name in slaves}
    for target, source in scenario.connections.items():
        component, _, variable = target.partition(".")
        sources[component][variable] = source
    tunables: dict[str, list[str]] = {name: [] for name in slaves}
    for reference in [*scenario.changes, *(p.writes for p in scenario.estimation.parameters)]:
        component, _, variable = reference.partition(".")
        tunables[component].append(variable)
    outputs = {name: _outputs(slave) for name, slave in slaves.items()}
    read = [*scenario.connections.values(), *scenario.tracking, *scenario.tracking.values()]
    sampling = scenario.sampling
    measured = [name for name, d in sampling.derivatives.items() if not d.of]
    for reference in [*read, *measured, *sampling.outputs, *sampling.states]:
        component, _, variable = reference.partition(".")
        if variable not in outputs[component]:
            known = outputs[component]
            raise WiringError(f"'{reference}' is no output of {component}{did_you_mean(variable, known) or '.'}")
    conversions = unit_conversions(scenario, {name: slave.description for name, slave in slaves.items()})
    wiring = {
        name: Wiring(
            sources[name], tuple(tunables[name]), outputs[name], scenario.components[name].start, conversions[name]
        )
        for name in slaves
    }
    return wiring, _groups(scenario, list(slaves))


def with_read_back(wiring: Mapping[str, Wiring], writes: Sequence[str]) -> dict[str, Wiring]:
    """The wiring with the re-tuned parameters among what is read, after the outputs."""
    names = {name: [r.partition(".")[2] for r in writes if r.partition(".")[0] == name] for name in wiring}
    return {
        name: replace(w, outputs=(*w.outputs, *(n for n in names[name] if n not in w.outputs)))
        for name, w in wiring.items()
    }


def plant_of(scenario: Scenario, slave: Described) -> Plant:
    """The plant's states, inputs and sampled channels. Raises WiringError where a derivative has no state.

    States are those that it declares; with a filter, which needs none declared, those of them that are outputs, and
    what the scenario lists as such.
    """
    variables = slave.description.modelVariables
    state_of = derivatives_of(slave)
    sampling = scenario.sampling
    outputs, is_state = set(_outputs(slave)), set(state_of.values())
    if sampling.filter is not None:
        is_state = (is_state & outputs) | {name.partition(".")[2] for name in sampling.states}
    elif not sampling.derivatives and not is_state <= outputs:
        is_state = set()  # where no model takes them they need not be seen
    states = tuple(v.name for v in variables if v.name in is_state)
    for reference in sampling.states:
        if reference not in {f"{slave.name}.{name}" for name in states}:
            raise WiringError(f"'{reference}' is no state of {slave.name}{did_you_mean(reference, states) or '.'}")
    channels: list[int] = []
    for reference, derivative in sampling.derivatives.items():
        name = reference.partition(".")[2]
        if derivative.of is None and name not in state_of:
            raise WiringError(
                f"'{reference}' is not declared as a state's derivative{did_you_mean(name, state_of) or '.'}"
            )
        channels.append(states.index(derivative.of.partition(".")[2] if derivative.of else state_of[name]))
    inputs = {v.name: float(v.start or 0.0) for v in variables if v.causality == "input"}
    return Plant(slave.name, states, inputs, tuple(channels))


def derivatives_of(slave: Described) -> dict[str, str]:
    """Of which state each declared derivative is, by name."""
    return {v.name: v.derivative.name for v in slave.description.modelVariables if v.derivative is not None}


def start_value(scenario: Scenario, slaves: Mapping[str, Described], reference: str) -> float:
    """Value that a variable has before the first step: the scenario's, else the FMU's. Raises WiringError."""
    component, _, variable = reference.partition(".")
    start: Any = scenario.components[component].start.get(variable)
    if start is None:
        found = {v.name: v.start for v in slaves[component].description.modelVariables}
        if variable not in found:
            raise WiringError(f"no variable '{variable}' in {component}{did_you_mean(variable, found) or '.'}")
        start = found[variable]
    if start is None:
        raise WiringError(f"'{reference}' has no start value; give it one under components.{component}.start.")
    return float(start)


def check_parameters(scenario: Scenario, slaves: Mapping[str, Described]) -> None:
    """Raises WiringError where an estimate could be written that the controller does not accept."""
    for parameter in scenario.estimation.parameters:
        component, _, name = parameter.writes.partition(".")
        found = {v.name: v for v in slaves[component].description.modelVariables}
        if name not in found:
            raise WiringError(f"no variable '{name}' in {component}{did_you_mean(name, found) or '.'}")
        if problem := parameter_problem(parameter, found[name]):
            raise WiringError(problem)


def parameter_problem(parameter: EstimatedParameter, variable: ModelVariable) -> str | None:
    """Why a variable does not take every estimate of the parameter, in its unit; None where it does."""
    unit = attribute(variable, "unit") or "1"
    if unit != parameter.unit:
        return f"'{parameter.writes}' has the unit {unit}, but '{parameter.name}' {parameter.unit}."
    low, high = (float(x) if x is not None else None for x in (attribute(variable, "min"), attribute(variable, "max")))
    if (low is not None and parameter.lower < low) or (high is not None and parameter.upper > high):
        bounds = f"[{parameter.lower:g}, {parameter.upper:g}] {unit}"
        return f"'{parameter.writes}' takes {low} to {high} {unit}; '{parameter.name}' has {bounds}."
    return None


def true_parameters(scenario: Scenario, slaves: Mapping[str, Described]) -> dict[str, Callable[[float], float]]:
    """What the plant's changed and estimated parameters are, as functions of t [s]. Raises WiringError.

    The functions raise ScenarioError where a formula has no value.
    """
    truth: dict[str, Callable[[float], float]]
    truth = {name: partial(value_of_change, name, change) for name, change in scenario.change_functions().items()}
    for parameter in scenario.estimation.parameters:
        reference = scenario.true_reference(parameter)
        if reference not in truth:
            truth[reference] = partial(_constant, start_value(scenario, slaves, reference))
    return truth


def value_of_change(name: str, change: Callable[[float], float], t: float) -> float:
    """What a changed parameter is at t [s]. Raises ScenarioError."""
    try:
        return change(t)
    except (ArithmeticError, ValueError) as e:
        raise ScenarioError(f"changes.{name} has no value at t = {seconds(t)} s: {e}.") from e


def _constant(value: float, t: float) -> float:
    return value


def _outputs(slave: Described) -> tuple[str, ...]:
    return tuple(v.name for v in slave.description.modelVariables if v.causality == "output" and is_numeric(v))


def _groups(scenario: Scenario, names: Sequence[str]) -> list[list[str]]:
    controllers = {p.writes.partition(".")[0] for p in scenario.estimation.parameters}
    if scenario.scenario.coupling == "parallel" or len(controllers) == len(names):
        return [list(names)]
    return [[n for n in names if n in controllers], [n for n in names if n not in controllers]]
