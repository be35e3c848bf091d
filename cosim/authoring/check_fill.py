"""Check of the places where `retune new` has left something to fill in."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from ..findings import Finding
from ..fmi.component import Component
from ..scenarios.scenario import Scenario
from ..variable_name import VariableName

_FILL: Final = "FILL"


def check_fill(findings: list[Finding], scenario: Scenario, components: Mapping[str, Component]) -> Iterator[Finding]:
    """Yield the findings, with one error in place of those where something is still to be filled in.

    components: those that could be read.
    """
    places = set(_places(scenario, components))
    left = dict.fromkeys(f.where for f in findings if f.is_error and f.where in places)
    yield from (f for f in findings if not (f.is_error and f.where in left))
    yield from (Finding(where, "FILL is still there: it is to be filled in") for where in left)


def _places(scenario: Scenario, components: Mapping[str, Component]) -> Iterator[str]:
    """Yield the places of the scenario with a FILL that is no variable, or file, of the user's."""

    def is_left(reference: VariableName) -> bool:
        component = components.get(reference.component)
        return reference.variable == _FILL and (component is None or _FILL not in component.variables)

    for name, settings in scenario.components.items():
        if name not in components and Path(settings.file).stem == _FILL:
            yield f"components.{name}"
    for tracked, reference in scenario.tracking.items():
        if is_left(tracked) or is_left(reference):
            yield f'tracking."{tracked}"'
    for i, parameter in enumerate(scenario.estimation.parameters):
        if any(map(is_left, (scenario.true_reference(parameter), *parameter.written))):
            yield f"estimation.parameters.{i} ({parameter.name})"
