"""Wiring of a scenario's FMUs: the variables that are set and read, and the groups in which the FMUs step."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..errors import WiringError
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from .master import Wiring
from .plant import Described, disturbances_of, numeric_outputs
from .unit_conversions import unit_conversions


def wire(scenario: Scenario, slaves: Mapping[str, Described]) -> tuple[dict[str, Wiring], list[list[str]]]:
    """Return each component's part in the co-simulation, and the groups in which they step. Raises WiringError.

    Sequential coupling: first those whose parameters are re-tuned, the controllers, then all others.
    """
    sources: dict[str, dict[str, str]] = {name: {} for name in slaves}
    for target, source in scenario.connections.items():
        component, variable = target.parts
        sources[component][variable] = source
    disturbed = disturbances_of(scenario, slaves)
    tunables: dict[str, list[str]] = {name: [] for name in slaves}
    disturbances: dict[str, list[str]] = {name: [] for name in slaves}
    for reference in [*scenario.changes, *scenario.written]:
        component, variable = reference.parts
        if variable in tunables[component]:
            raise WiringError(f"'{reference}' is set twice: a parameter is either changed, or written by one estimate.")
        (disturbances if reference in disturbed else tunables)[component].append(variable)
    outputs = {name: numeric_outputs(slave) for name, slave in slaves.items()}
    known = {name: set(own) for name, own in outputs.items()}
    sampling = scenario.sampling
    measured = [] if sampling.filter else sampling.derivatives
    read = {
        "connections": scenario.connections.values(),
        "tracking": [*scenario.tracking, *scenario.tracking.values()],
        "sampling": [*measured, *sampling.outputs, *sampling.states],
    }
    for table, references in read.items():
        for component, variable in (reference.parts for reference in references):
            if variable not in known[component]:
                hint = did_you_mean(variable, outputs[component]) or "."
                raise WiringError(f"{table}: '{component}.{variable}' is no output of {component}{hint}")
    conversions = unit_conversions(scenario, {name: slave.description for name, slave in slaves.items()})
    wiring = {
        name: Wiring(
            sources[name],
            tuple(tunables[name]),
            outputs[name],
            scenario.components[name].start,
            conversions[name],
            tuple(disturbances[name]),
        )
        for name in slaves
    }
    return wiring, _groups(scenario, list(slaves))


def with_read_back(wiring: Mapping[str, Wiring]) -> dict[str, Wiring]:
    """Return the wiring with the parameters that are set read too, after the outputs."""
    return {name: replace(w, outputs=(*w.outputs, *w.tunables)) for name, w in wiring.items()}


def _groups(scenario: Scenario, names: Sequence[str]) -> list[list[str]]:
    controllers = {reference.component for reference in scenario.written}
    if scenario.scenario.coupling == "parallel" or len(controllers) == len(names):
        return [list(names)]
    return [[n for n in names if n in controllers], [n for n in names if n not in controllers]]
