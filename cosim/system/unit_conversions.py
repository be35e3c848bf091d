"""Units of connected and compared variables: converted along connections; a comparison in two units is refused."""

from collections.abc import Mapping
from pathlib import Path

from ..errors import WiringError
from ..fmi.component import Component, ModelDescription, component_of
from ..scenarios.scenario import Scenario
from ..units import IDENTITY, Linear, Unit, conversion
from ..variable_name import VariableName
from .parameters import key_of


def unit_conversions(scenario: Scenario, descriptions: Mapping[str, ModelDescription]) -> dict[str, dict[str, Linear]]:
    """Return the conversion from each input's source to its unit, by component and input, where the units differ.

    It is done as in SSP and Simulink: where a unit is not given, or an FMU does not define it, the number is taken as
    it is.
    Raises WiringError for units of other dimensions, and for numbers that are compared, a tracked output and its
    reference, a parameter of plant and controller, in different units.
    """
    components = {name: component_of(Path(name), description) for name, description in descriptions.items()}
    found: dict[str, dict[str, Linear]] = {name: {} for name in components}
    for target, source in scenario.connections.items():
        is_ours = scenario.components[source.component].table is not None
        convert = _conversion(f'connections."{target}"', source, target, components, is_ours)
        if convert != IDENTITY:
            component, variable = target.parts
            found[component][variable] = convert
    compared = [(f'tracking."{tracked}"', reference, tracked) for tracked, reference in scenario.tracking.items()]
    for p in scenario.estimation.parameters:
        if p.is_written_as_it_is:
            compared += [(key_of(p), scenario.true_reference(p), name) for name in p.written]
    for where, one, other in compared:
        if _conversion(where, one, other, components) != IDENTITY:
            raise WiringError(f"{where}: {different(one, other, components)}, and both must be in one unit.")
    return found


def different(source: str, target: str, components: Mapping[str, Component]) -> str:
    """Return a message on two variables of one dimension in different units, with the factor."""
    a, b = (_unit(reference, components) for reference in (source, target))
    convert = conversion(a, b)
    more = f" {convert.offset:+.9g}" if convert.offset else ""
    of, to = (unit.name if unit else "" for unit in (a, b))
    return f"'{source}' is in {of}, '{target}' in {to} (x {of} = {convert.factor:.9g} x{more} {to})"


def _unit(reference: str, components: Mapping[str, Component]) -> Unit | None:
    name, variable = VariableName(reference).parts
    component = components[name]
    return component.unit(variable) if variable in component.variables else None


def _conversion(
    where: str, source: str, target: str, components: Mapping[str, Component], is_ours: bool = False
) -> Linear:
    """Return the conversion between two variables; is_ours: the source's unit is the user's, and must be known."""
    units = [_unit(reference, components) for reference in (source, target)]
    try:
        return conversion(*units)
    except ValueError as e:
        if not is_ours and any(unit is not None and unit.exponents is None for unit in units):
            return IDENTITY
        raise WiringError(f"{where}: '{source}' to '{target}': {e}.") from e
