"""Flattening of the connections of nested systems to those between FMUs, units converted on the way."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple
from xml.etree.ElementTree import Element

from ..errors import SspError, one_line
from ..names import did_you_mean
from ..ssv.xml import attribute, number
from ..units import IDENTITY, Linear, conversion
from .arrays import FmuArray
from .tree import Connector, SystemElement

_PARAMETERS = ("parameter", "structuralParameter")
_GIVES = ("output", "calculatedParameter", "inout")
_TAKES = ("input", *_PARAMETERS, "inout")


LONGEST_WAY: Final = 200
"""Connections from an input to the output that it takes: down and up again through nested systems."""


class End(NamedTuple):
    """One end of a connection."""

    element: str
    """Hierarchical name; empty for the top system."""
    connector: str
    """Its connector."""

    def __str__(self) -> str:
        return f"{self.element}.{self.connector}" if self.element else self.connector


class Connection(NamedTuple):
    """An input of an FMU, and what it is set to."""

    source: End
    """An output of an FMU."""
    target: End
    """An input of an FMU."""
    transform: Linear
    """Transformation from the source's number to the target's."""


class FlatConnections(NamedTuple):
    """The connections of a whole system structure, followed through its nested systems."""

    connections: tuple[Connection, ...]
    """Connections between FMUs, in the file's order of inputs."""
    inherited: Mapping[End, Sequence[Connection]]
    """Connections of variables that take the value of a system's connector (`source`), by variable: those of all
    connectors on the way, the outermost first."""


@dataclass(frozen=True)
class _Edge:
    source: End
    transformation: Linear
    is_converted: bool


def connect(top: SystemElement, where: str) -> FlatConnections:
    """Follow every connection to an FMU through the systems' connectors. Raises SspError."""
    edges: dict[End, _Edge] = {}
    kinds: dict[End, Connector] = {}
    is_component: dict[str, bool] = {}
    for node in _nodes(top):
        is_component[node.name] = node.component is not None
        kinds |= {End(node.name, name): connector for name, connector in node.connectors.items()}
        for element in node.element.findall("Connections/Connection"):
            for target, edge in _edges(node, element, where):
                if target in edges:
                    raise SspError(f"{where}: two connections lead to '{target}'.")
                edges[target] = edge
    connections: list[Connection] = []
    inherited: dict[End, Sequence[Connection]] = {}
    for target in edges:
        if not is_component[target.element]:
            continue
        way = _way_to(target, edges, is_component, where)
        source, transform = way[-1], _along(way, edges, kinds, where)
        if not is_component[source.element]:
            parts = (way[: n + 1] for n in range(len(way) - 1, 0, -1))
            inherited[target] = [Connection(p[-1], target, _along(p, edges, kinds, where)) for p in parts]
        elif kinds[target].kind in _PARAMETERS:
            raise SspError(f"{where}: '{source}' leads to the parameter '{target}', not to an input.")
        else:
            connections.append(Connection(source, target, transform))
    return FlatConnections(tuple(connections), inherited)


def _nodes(node: SystemElement) -> Iterator[SystemElement]:
    yield node
    for child in node.children.values():
        yield from _nodes(child)


def _edges(system: SystemElement, element: Element, where: str) -> Iterator[tuple[End, _Edge]]:
    """Yield target and edge of a connection, those between two arrays element by element."""
    ends: list[FmuArray | None] = []
    for side in ("start", "end"):
        name = element.get(f"{side}Element")
        node = system.children.get(name) if name else system
        ends.append(node.arrays.get(element.get(f"{side}Connector", "")) if node is not None else None)
    start, end = ends
    between = " -> ".join(_written(element, side) for side in ("start", "end"))
    if element.get("startIndices") or element.get("endIndices"):
        raise SspError(f"{where}: connection {between} is one of single elements, which is not supported.")
    if start is None and end is None:
        yield _edge(system, element, where)
        return
    if start is None or end is None or start.sizes != end.sizes:
        raise SspError(f"{where}: connection {between} must join arrays of one size.")
    for one, other in zip(start.elements, end.elements, strict=True):
        part = Element(element.tag, {**element.attrib, "startConnector": one, "endConnector": other})
        part.extend(element)
        yield _edge(system, part, where)


def _edge(system: SystemElement, element: Element, where: str) -> tuple[End, _Edge]:
    """Return the target and the edge of a connection: the standard names a start and an end, some tools swap them."""
    place = f"{where}: connection {' -> '.join(_written(element, side) for side in ('start', 'end'))}"
    (start, start_gives, start_takes), (end, end_gives, end_takes) = (
        _end(system, element, side, place) for side in ("start", "end")
    )
    if start_gives and end_takes:
        source, target = start, end
    elif end_gives and start_takes:
        source, target = end, start
    else:
        raise SspError(f"{place} must join an output to an input.")
    is_converted = element.get("suppressUnitConversion", "false") not in ("true", "1")
    return target, _Edge(source, transformation(element, place), is_converted)


def _end(system: SystemElement, element: Element, side: str, place: str) -> tuple[End, bool, bool]:
    """Return one end, whether it can give a value within the system, and whether it can take one."""
    name, connector = element.get(f"{side}Element"), attribute(element, f"{side}Connector", place)
    node = system
    if name:
        if name not in system.children:
            raise SspError(f"{place}: no element '{one_line(name)}'{did_you_mean(name, system.children) or '.'}")
        node = system.children[name]
    if connector not in node.connectors:
        hint = did_you_mean(connector, node.connectors) or "."
        raise SspError(f"{place}: no connector '{one_line(connector)}' of '{node.name or 'the system'}'{hint}")
    kind = node.connectors[connector].kind
    gives, takes = kind in _GIVES, kind in _TAKES
    return (End(node.name, connector), gives, takes) if name else (End(node.name, connector), takes, gives)


def _written(element: Element, side: str) -> str:
    parts = (element.get(f"{side}Element"), element.get(f"{side}Connector"))
    return one_line(".".join(part for part in parts if part))


def transformation(element: Element, place: str) -> Linear:
    """Return the linear transformation in an element, the only kind that is supported. Raises SspError."""
    for child in element:
        if child.tag == "LinearTransformation":
            factor, offset = number(child, "factor", place, 1.0), number(child, "offset", place, 0.0)
            return Linear(1.0 if factor is None else factor, offset or 0.0)
        if child.tag.endswith("Transformation"):
            raise SspError(f"{place}: a {child.tag} is not supported, only a LinearTransformation.")
    return IDENTITY


def _way_to(target: End, edges: Mapping[End, _Edge], is_component: Mapping[str, bool], where: str) -> list[End]:
    """Return the ends on the way back from a target to a component, or a connector that nothing leads to."""
    way = [target]
    while way[-1] in edges and (way[-1] == target or not is_component[way[-1].element]):
        source = edges[way[-1]].source
        if source in way:
            raise SspError(f"{where}: the connections of '{source}' go round in a circle.")
        if len(way) == LONGEST_WAY:
            raise SspError(f"{where}: '{target}' is more than {LONGEST_WAY} connections from its source.")
        way.append(source)
    return way


def _along(way: Sequence[End], edges: Mapping[End, _Edge], kinds: Mapping[End, Connector], where: str) -> Linear:
    """Return the transformation from the last end of a way to its first."""
    unit, total = kinds[way[-1]].unit, IDENTITY
    for end in reversed(way[:-1]):
        edge, own = edges[end], kinds[end].unit
        try:
            total = total.then(conversion(unit, own) if edge.is_converted else IDENTITY).then(edge.transformation)
        except ValueError as e:
            raise SspError(f"{where}: connection {edge.source} -> {end}: {e}.") from e
        unit = own or unit
    return total
