"""Checks of the estimator's model and objective: what can be known without a call, then one call of what may run.

A stranger's code is not loaded, and a stranger's FMU not started: that is for `run`, once the user asks for it.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from estimator import Sample
from fmu_models.build import PLANTS

from ..errors import CosimError, one_line
from ..findings import Finding
from ..fmi.archive import FmuFile
from ..fmi.component import Component
from ..objectives.choice import check_objective, chosen
from ..objectives.model import check_model_fmu, model_fmu
from ..retuning.assembly import try_model
from ..scenarios.scenario import Scenario
from ..system.parameters import check_parameters, first_states, true_parameters
from ..system.plant import Plant, plant_of
from ..system.tuning import first_parameters
from ..system.wiring import wire
from ..user_code import is_built_in, is_trusted
from .check_filter import check_filtered_model
from .check_fmu import check_fmu
from .check_rule import check_rule


def check_model(scenario: Scenario, components: Mapping[str, Component]) -> Iterator[Finding]:
    """Yield what `run` refuses of the system as a whole, and problems of model and objective; a note says what ran.

    Used when all other checks have passed.
    """
    files = {name: FmuFile(name, c.description) for name, c in components.items()}
    try:
        plant = plant_of(scenario, files[scenario.plant])
        check_parameters(scenario, files)
        wire(scenario, files)
        true_parameters(scenario, files)
        theta = np.array(first_parameters(scenario, files))
    except CosimError as e:
        yield split(plain(e))
        return
    yield from check_rule(scenario, files, theta)
    try:
        kind = chosen(scenario).kind
        if kind == "derivative":
            yield from _derivative(scenario, plant, files)
        elif kind == "function" and not is_trusted(scenario.estimation.objective, scenario.origin):
            yield _note("estimation.objective", f"{_named(scenario.estimation.objective, scenario)} was not loaded")
        else:
            for text in check_objective(scenario, plant):
                yield _note("estimation.objective", text)
    except CosimError as e:
        yield split(plain(e)) if str(e).startswith("estimation.") else Finding("estimation.model", plain(e))


def _derivative(scenario: Scenario, plant: Plant, files: Mapping[str, FmuFile]) -> Iterator[Finding]:
    """Yield problems with a model for derivatives; it is called once, at the start values, if it may run."""
    reference = scenario.estimation.model or ""
    x, hidden = first_states(scenario, files, plant)
    theta = np.array(first_parameters(scenario, files))
    if (fmu := model_fmu(scenario)) is not None:
        check_model_fmu(scenario, plant)
        errors = [f"{fmu}: {f.where}: {f.what}" for f in check_fmu(fmu) if f.is_error]
        yield from (Finding("estimation.model", text) for text in errors)
        if errors:
            return
    is_ours = is_built_in(reference) or reference in PLANTS
    may_run = is_ours or is_trusted(reference, scenario.origin)
    if may_run:
        zeros = (0.0,) * len(scenario.sampling.derivatives)
        sample = Sample(scenario.scenario.start_time, tuple(x), tuple(plant.inputs.values()), zeros)
        try_model(scenario, "target", plant, theta, sample)
        yield from check_filtered_model(scenario, plant, np.array(x), theta)
    if not is_ours:
        how = "was called, at the start values" if may_run else "was not called"
        how += f" and zero for {', '.join(hidden)}, which the FMU starts itself" if may_run and hidden else ""
        yield _note("estimation.model", f"{_named(reference, scenario)} {how}")


def _named(reference: str, scenario: Scenario) -> str:
    stranger = scenario.origin.stranger
    return f"'{reference}'" + (f" of {stranger}" if stranger and reference not in scenario.origin.own else "")


def _note(where: str, what: str) -> Finding:
    return Finding(where, what, is_error=False, is_note=True)


def split(text: str) -> Finding:
    """Return the finding of a schema error in the form `key: rule`."""
    key, colon, rule = text.partition(": ")
    return Finding(key, rule) if colon and " " not in key else Finding("scenario", text)


def plain(error: CosimError) -> str:
    """Return the message of an error as a finding has it."""
    return one_line(str(error)).rstrip(".")
