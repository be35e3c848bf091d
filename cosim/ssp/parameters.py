"""Start values of FMUs from the parameter bindings of a system structure: SSP 1.0, section 5.4.1.3."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from ..errors import SspError
from ..fmi.component import Component, items_of
from ..fmi.types import Value
from ..ssv.document import ParameterSet, ParameterValue, parameter_set
from ..ssv.xml import attribute, check, parse
from ..units import IDENTITY, Linear, Unit, conversion
from .connections import End, FlatConnections, transformation
from .tree import DEEPEST, SystemElement, resource


class _Bound(NamedTuple):
    """A value on its way to a variable."""

    value: Value
    unit: Unit | None
    transformation: Linear
    where: str
    depth: int
    """Depth of the system whose binding it is of: 0 for the top."""


@dataclass
class _Found:
    """The values bound so far; one that is bound later, higher up, takes their place."""

    variables: dict[End, _Bound] = field(default_factory=dict[End, _Bound])
    connectors: dict[End, _Bound] = field(default_factory=dict[End, _Bound])
    ignored: list[str] = field(default_factory=list[str])


def start_values(
    top: SystemElement, wiring: FlatConnections, folder: Path, units: Mapping[str, Unit], where: str
) -> tuple[dict[str, dict[str, Value]], tuple[str, ...]]:
    """Return start values by component and variable, in the variable's unit, and the names that no component has.

    Bindings of a system come before those of what is in it, and later ones before earlier ones. Raises SspError.
    """
    found = _Found()
    _collect(top, found, folder, units, where)
    components = dict(top.components())
    start: dict[str, dict[str, Value]] = {name: {} for name in components}
    for (name, variable), bound in found.variables.items():
        start[name][variable] = _value(bound, components[name], name, variable, IDENTITY)
    for target, ways in wiring.inherited.items():
        way = next((way for way in ways if way.source in found.connectors), None)
        if way is None:
            continue
        bound, (name, variable) = found.connectors[way.source], target
        if target not in found.variables or bound.depth <= found.variables[target].depth:
            start[name][variable] = _value(bound, components[name], name, variable, way.transform)
    return start, tuple(dict.fromkeys(found.ignored))


def variable_value(parameters: ParameterSet, given: ParameterValue, target: End, component: Component) -> Value:
    """Return a parameter as the start value of a component's variable, converted to its unit. Raises SspError."""
    bound = _Bound(given.value, _unit(parameters, given.unit), IDENTITY, parameters.where, 0)
    return _value(bound, component, target.element, target.connector, IDENTITY)


def _collect(
    node: SystemElement, found: _Found, folder: Path, units: Mapping[str, Unit], where: str, depth: int = 0
) -> None:
    for child in node.children.values():
        _collect(child, found, folder, units, where, depth + 1)
    for binding in node.element.findall("ParameterBindings/ParameterBinding"):
        for name, bound in _bound_in(binding, folder, units, f"{where}: parameter binding of '{node.name}'"):
            _place(node, name, bound._replace(depth=depth), found)


def _place(node: SystemElement, name: str, bound: _Bound, found: _Found) -> None:
    """Put a value where its hierarchical name leads from an element."""
    if node.component is not None:
        if name in node.component.variables:
            found.variables[End(node.name, name)] = bound
        else:
            found.ignored.append(str(End(node.name, name)))
    elif name in node.connectors:
        unit = node.connectors[name].unit
        converted = _in_unit(bound, unit, f"{node.name}.{name}")
        # The way from a connector with a unit to the variable converts from that unit.
        found.connectors[End(node.name, name)] = converted if unit is None else converted._replace(unit=None)
    else:
        own = next((part for part in _heads(name) if part in node.children), None)
        if own is not None:
            _place(node.children[own], name[len(own) + 1 :], bound, found)
        else:
            found.ignored.append(str(End(node.name, name)))


def _heads(name: str) -> Iterator[str]:
    """Yield what is before each dot of a name, the longest first; of a name without end the first dots count."""
    parts = name.split(".")
    for n in range(min(len(parts) - 1, DEEPEST), 0, -1):
        yield ".".join(parts[:n])


def _bound_in(binding: Element, folder: Path, units: Mapping[str, Unit], place: str) -> Iterator[tuple[str, _Bound]]:
    """Yield names, as seen from the element, and values of one binding."""
    parameters = _parameters_of(binding, folder, units, place)
    prefix = binding.get("prefix", "")
    given = {prefix + p.name: _Bound(p.value, _unit(parameters, p.unit), IDENTITY, parameters.where, 0)
             for p in parameters.values}  # fmt: skip
    mapping = binding.find("ParameterMapping")
    if mapping is None:
        yield from given.items()
        return
    content = _content(mapping, "ParameterMapping", folder, place)
    for entry in content.findall("MappingEntry"):
        source, target = attribute(entry, "source", place), attribute(entry, "target", place)
        if source in given:
            is_converted = entry.get("suppressUnitConversion", "false") not in ("true", "1")
            unit = given[source].unit if is_converted else None
            linear = transformation(entry, f"{place}: mapping of '{source}'")
            yield target, given[source]._replace(unit=unit, transformation=linear)


def _parameters_of(binding: Element, folder: Path, units: Mapping[str, Unit], place: str) -> ParameterSet:
    kind = binding.get("type", "application/x-ssp-parameter-set")
    if kind != "application/x-ssp-parameter-set":
        raise SspError(f"{place} is of type {kind}, not application/x-ssp-parameter-set.")
    inline = binding.find("ParameterValues")
    root = _content(binding if inline is None else inline, "ParameterSet", folder, place)
    return parameter_set(
        root, f"{place}: {binding.get('source') or 'inline values'}", units if inline is not None else None
    )


def _content(element: Element, kind: str, folder: Path, place: str) -> Element:
    """Return the parameter set or mapping that an element holds, or that its file has. Raises SspError."""
    inline = element.find(kind)
    if inline is not None:
        return check(inline, place, kind)
    if element.get("sourceBase", "SSD") != "SSD":
        raise SspError(f"{place}: sources within a component are not supported.")
    source = attribute(element, "source", place)
    return parse(resource(folder, source, place).read_bytes(), f"{place}: {source}", kind)


def _unit(parameters: ParameterSet, name: str | None) -> Unit | None:
    return parameters.units.get(name, Unit(name)) if name else None


def _value(bound: _Bound, component: Component, name: str, variable: str, way: Linear) -> Value:
    """Return the value in the variable's unit and of its type. Raises SspError."""
    value, v = bound.value, component.variables[variable]
    items = items_of(v)
    if isinstance(value, str) and items is not None:
        if value not in items:
            raise SspError(f"{bound.where}: '{value}' is no item of the enumeration '{name}.{variable}'.")
        return items[value]
    value = _in_unit(bound, component.unit(variable), f"{name}.{variable}").value
    return value if isinstance(value, str | bool) or way == IDENTITY else way(value)


def _in_unit(bound: _Bound, unit: Unit | None, name: str) -> _Bound:
    """Convert a number to another unit; it stays as it is where either unit is not given. Raises SspError."""
    try:
        convert = conversion(bound.unit, unit).then(bound.transformation)
    except ValueError as e:
        raise SspError(f"{bound.where}: parameter '{name.removeprefix('.')}': {e}.") from e
    if convert == IDENTITY or isinstance(bound.value, str | bool):
        return bound._replace(unit=unit or bound.unit, transformation=IDENTITY)
    return bound._replace(value=convert(bound.value), unit=unit or bound.unit, transformation=IDENTITY)
