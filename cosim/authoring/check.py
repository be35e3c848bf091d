"""Errors and risks in a scenario, found before any of its components runs.

An error is something that `run` would refuse or that gives meaningless results; a warning may be intended. The only
code that is called is the estimator's model: a function of the user's or a model-exchange FMU.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from estimator import Sample

from ..errors import CosimError, ScenarioError, one_line
from ..findings import Finding
from ..fmi.archive import FmuFile
from ..fmi.component import Component, read_component
from ..objectives.choice import check_objective, chosen
from ..retuning.assembly import try_model
from ..scenarios.scenario import Scenario
from ..scenarios.validation import error_texts
from ..ssp.load import load_scenario
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import component_path
from ..system.parameters import start_values
from ..system.plant import plant_of
from .check_estimation import check_changes, check_parameters, check_sampling, check_tracking
from .check_filter import check_filter, check_filtered_model
from .check_noise import check_noise
from .check_wiring import check_connections, check_inputs, check_loops, check_starts, check_steps

_CHECKS: tuple[Callable[[Scenario, Mapping[str, Component]], Iterator[Finding]], ...] = (
    check_starts, check_connections, check_inputs, check_changes, check_tracking, check_sampling, check_filter,
    check_parameters, check_loops, check_steps,
)  # fmt: skip


def check(source: str | Path, overrides: Mapping[str, str] | None = None) -> list[Finding]:
    """Return all findings about a scenario, errors and warnings. Raises ScenarioError if the file is not TOML."""
    try:
        scenario = load_scenario(source, overrides)
    except ScenarioError as e:
        if not isinstance(e.__cause__, ValidationError):
            raise
        found = [_split(text) for text in error_texts(e.__cause__, Scenario)]
        return [f for f in found if not any(other.where.startswith(f"{f.where}.") for other in found)]  # what follows
    components: dict[str, Component] = {}
    findings: list[Finding] = []
    for name, c in scenario.components.items():
        try:
            components[name] = read_component(component_path(c, scenario.folder))
        except CosimError as e:
            findings.append(Finding(f"components.{name}", _plain(e)))
    if len(components) == len(scenario.components):
        try:
            files = {name: FmuFile(name, c.description) for name, c in components.items()}
            scenario = as_the_fmus_have_it(scenario, files)
        except CosimError as e:
            return [Finding("connections", _plain(e))]
    findings += [finding for one in _CHECKS for finding in one(scenario, components)]
    if not any(f.is_error for f in findings):
        findings += [*_check_model(scenario, components), *check_noise(scenario)]
    return findings


def _check_model(scenario: Scenario, components: Mapping[str, Component]) -> Iterator[Finding]:
    """Call the model once at the start values, or describe the objective; used when all other checks have passed."""
    files = {name: FmuFile(name, c.description) for name, c in components.items()}
    try:
        plant = plant_of(scenario, files[scenario.plant])
        if chosen(scenario).kind != "derivative":
            for text in check_objective(scenario, plant):
                yield Finding("estimation.objective", text, is_error=False, is_note=True)
            return
        x = tuple(start_values(scenario, files, [f"{plant.name}.{name}" for name in plant.states]))
        theta = np.array(start_values(scenario, files, [p.writes for p in scenario.estimation.parameters]))
        zeros = (0.0,) * len(scenario.sampling.derivatives)
        sample = Sample(scenario.scenario.start_time, x, tuple(plant.inputs.values()), zeros)
        try_model(scenario, "target", plant, theta, sample)
        yield from check_filtered_model(scenario, plant, np.array(x), theta)
    except CosimError as e:
        yield _split(_plain(e)) if str(e).startswith("estimation.") else Finding("estimation.model", _plain(e))


def _split(text: str) -> Finding:
    """Return the finding of a schema error in the form `key: rule`."""
    key, colon, rule = text.partition(": ")
    return Finding(key, rule) if colon and " " not in key else Finding("scenario", text)


def _plain(error: CosimError) -> str:
    return one_line(str(error)).rstrip(".")
