"""Start values from an SSV file whose parameters are named `component.variable`, as for a whole system."""

from collections.abc import Mapping
from pathlib import Path

from ..errors import SspError
from ..fmi.block import Value
from ..fmi.component import Component, read_component
from ..names import did_you_mean
from ..ssp.connections import End
from ..ssp.parameters import variable_value
from ..ssp.ssv import read_ssv
from .scenario import Scenario
from .system import component_path


def with_start_values(scenario: Scenario, path: Path) -> Scenario:
    """The scenario with the start values of an SSV file in place of its own.

    Raises SspError, one line with the file and the parameter, for one that no component has: nothing is passed over.
    """
    found = {
        name: read_component(component_path(c, scenario.folder)) for name, c in scenario.components.items() if c.fmu
    }
    start = read_start_values(path, found)
    components = {
        name: c.model_copy(update={"start": {**c.start, **start[name]}}) if name in start else c
        for name, c in scenario.components.items()
    }
    return scenario.model_copy(update={"components": components})


def read_start_values(path: Path, components: Mapping[str, Component]) -> dict[str, dict[str, Value]]:
    """Start values by component and variable, converted to the variable's unit. Raises SspError."""
    parameters = read_ssv(path)
    start: dict[str, dict[str, Value]] = {name: {} for name in components}
    for parameter in parameters.values:
        name = parameter.name
        owner = max((c for c in components if name.startswith(f"{c}.")), key=len, default=None)
        if owner is None:
            known = [f"{c}.{v}" for c, component in components.items() for v in component.variables]
            raise SspError(f"{path}: parameter '{name}' is no COMPONENT.VARIABLE{did_you_mean(name, known) or '.'}")
        variable = name[len(owner) + 1 :]
        if variable not in components[owner].variables:
            hint = did_you_mean(variable, components[owner].variables) or "."
            raise SspError(f"{path}: no variable '{variable}' in {owner}{hint}")
        start[owner][variable] = variable_value(parameters, parameter, End(owner, variable), components[owner])
    return start
