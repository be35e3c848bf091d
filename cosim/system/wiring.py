"""Wiring of a scenario's FMUs: the variables that are set and read, and the groups in which the FMUs step."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import WiringError, told_at
from ..fmi.ports import Catalogue
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..variable_name import VariableName
from .master import Wiring
from .parameters import key_of
from .plant import Described, disturbances_of, numeric_outputs
from .unit_conversions import unit_conversions


def wire(scenario: Scenario, slaves: Mapping[str, Described]) -> tuple[dict[str, Wiring], list[list[str]]]:
    """Return each component's part in the co-simulation, and the groups in which they step. Raises WiringError.

    Sequential coupling: first those whose parameters are re-tuned, the controllers, then all others.
    """
    sources: dict[str, dict[str, str]] = {name: {} for name in slaves}
    catalogues = {
        name: Catalogue(Path(scenario.components[name].file).name, slave.description.modelVariables)
        for name, slave in slaves.items()
    }
    for target, source in scenario.connections.items():
        component, variable = target.parts
        with told_at(f'connections."{target}"'):
            catalogues[component].ports("input", [variable])
        sources[component][variable] = source
    disturbed = disturbances_of(scenario, slaves)
    tunables: dict[str, list[str]] = {name: [] for name in slaves}
    disturbances: dict[str, list[str]] = {name: [] for name in slaves}
    for place, reference in _set(scenario):
        component, variable = reference.parts
        if reference in disturbed:
            disturbances[component].append(variable)
            continue
        with told_at(place):
            if variable in tunables[component]:
                twice = "is set twice: a parameter is either changed, or written by one estimate."
                raise WiringError(f"'{reference}' {twice}")
            catalogues[component].ports("tunable parameter", [variable])
        tunables[component].append(variable)
    outputs = {name: numeric_outputs(slave) for name, slave in slaves.items()}
    known = {name: set(own) for name, own in outputs.items()}
    for place, reference in _read(scenario):
        component, variable = reference.parts
        if variable not in known[component]:
            hint = did_you_mean(variable, outputs[component]) or "."
            raise WiringError(f"{place}: '{reference}' is no output of {component}{hint}")
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


def _set(scenario: Scenario) -> Iterator[tuple[str, VariableName]]:
    """Yield what is set while it runs, but for connected inputs, with its place in the scenario's file."""
    yield from ((f'changes."{reference}"', reference) for reference in scenario.changes)
    for parameter in scenario.estimation.parameters:
        yield from ((key_of(parameter), reference) for reference in parameter.written)


def _read(scenario: Scenario) -> Iterator[tuple[str, VariableName]]:
    """Yield what must be an output, with its place in the scenario's file."""
    yield from ((f'connections."{target}"', source) for target, source in scenario.connections.items())
    for tracked, reference in scenario.tracking.items():
        yield from ((f'tracking."{tracked}"', name) for name in (tracked, reference))
    sampling = scenario.sampling
    measured = {} if sampling.filter else sampling.derivatives
    for table, names in {"derivatives": measured, "outputs": sampling.outputs, "states": sampling.states}.items():
        yield from ((f'sampling.{table}."{name}"', name) for name in names)


def with_read_back(wiring: Mapping[str, Wiring]) -> dict[str, Wiring]:
    """Return the wiring with the parameters that are set read too, after the outputs."""
    return {name: replace(w, outputs=(*w.outputs, *w.tunables)) for name, w in wiring.items()}


def _groups(scenario: Scenario, names: Sequence[str]) -> list[list[str]]:
    controllers = {reference.component for reference in scenario.written}
    if scenario.scenario.coupling == "parallel" or len(controllers) == len(names):
        return [list(names)]
    return [[n for n in names if n in controllers], [n for n in names if n not in controllers]]
