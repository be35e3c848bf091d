"""Start values from an SSV file, of a whole system (parameters named `component.variable`) or of one component."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import SspError
from ..fmi.component import Component, read_component
from ..fmi.types import Value
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..ssv.document import read_ssv
from ..system.fmu_cache import component_path
from .connections import End
from .parameters import variable_value

StartValues = tuple[str | None, Path]
"""An SSV file, and the component whose variables it names; None: it names `component.variable`."""


def with_start_values(scenario: Scenario, files: Sequence[StartValues]) -> Scenario:
    """Return the scenario with the start values of SSV files in place of its own; a later file wins.

    Raises SspError, one line with the file and the parameter, for one that no component has: none is ignored.
    """
    if not files:
        return scenario
    found = {
        name: read_component(component_path(c, scenario.folder)) for name, c in scenario.components.items() if c.fmu
    }
    start = read_start_values(files, found)
    components = {
        name: c.model_copy(update={"start": {**c.start, **start[name]}}) if name in start else c
        for name, c in scenario.components.items()
    }
    return scenario.model_copy(update={"components": components})


def read_start_values(files: Sequence[StartValues], components: Mapping[str, Component]) -> dict[str, dict[str, Value]]:
    """Return start values by component and variable, converted to the variable's unit. Raises SspError."""
    start: dict[str, dict[str, Value]] = {name: {} for name in components}
    for component, path in files:
        if component is not None and component not in components:
            hint = did_you_mean(component, components) or f"; there are {', '.join(components)}."
            raise SspError(f"{path}: no component '{component}'{hint}")
        parameters = read_ssv(path)
        for parameter in parameters.values:
            owner, variable = (component, parameter.name) if component else _parts(parameter.name, path, components)
            if variable not in components[owner].variables:
                hint = did_you_mean(variable, components[owner].variables) or "."
                raise SspError(f"{path}: no variable '{variable}' in {owner}{hint}")
            value = variable_value(parameters, parameter, End(owner, variable), components[owner])
            start[owner][variable] = value
    return start


def _parts(name: str, path: Path, components: Mapping[str, Component]) -> tuple[str, str]:
    """Return component and variable of a parameter that names both. Raises SspError."""
    owner = max((c for c in components if name.startswith(f"{c}.")), key=len, default=None)
    if owner is not None:
        return owner, name[len(owner) + 1 :]
    known = [f"{c}.{v}" for c, component in components.items() for v in component.variables]
    having = next((c for c, component in components.items() if name in component.variables), None)
    hint = did_you_mean(name, known) or (f"; of {having} alone? --start-values {having}={path}" if having else ".")
    raise SspError(f"{path}: parameter '{name}' is no COMPONENT.VARIABLE{hint}")
