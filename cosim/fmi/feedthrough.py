"""Direct feedthrough: which inputs an output depends on within a communication point, and the loops that close by it.

FMI 2.0.4, section 2.2.8 (ModelStructure): an output without `dependencies` may depend on every input.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from fmpy.model_description import Unknown

from ..variable_name import VariableName
from .component import Component

_REFERENCE: Final = 0xFFFFFFFF  # of an array's element: its other bits say which one


@dataclass(frozen=True)
class AlgebraicLoop:
    """A path from a variable back to itself without a state in between."""

    nodes: tuple[str, ...]
    """`component.variable`, each but the last depending on the next, and that on the first."""
    undeclared: tuple[str, ...]
    """Components on it that do not declare what their outputs depend on: there may be no loop."""


def declared(component: Component, unknowns: Iterable[Unknown] | None = None) -> dict[str, list[str] | None]:
    """Return the variables that each output depends on, by its name; None where the FMU does not declare them.

    unknowns: another list of its ModelStructure than the outputs.
    """
    names: dict[Any, list[str]] = {}
    for v in component.variables.values():
        names.setdefault(_key(component, v), []).append(v.name)
    said: dict[Any, list[str] | None] = {}
    for unknown in component.description.outputs if unknowns is None else unknowns:
        on = unknown.dependencies
        said[_key(component, unknown.variable)] = (
            None if on is None else [name for v in on for name in names.get(_key(component, v), [])]
        )
    return {v.name: said.get(_key(component, v)) for v in component.having("output")}


def feedthrough(component: Component, inputs: Sequence[str], outputs: Collection[str]) -> dict[str, list[str]]:
    """Return those of the inputs that each of the outputs depends on: all of them where the FMU declares none."""
    found: dict[str, list[str]] = {}
    for name, on in declared(component).items():
        if name in outputs:
            entering = None if on is None else set(on)
            found[name] = [i for i in inputs if entering is None or i in entering]
    return found


def algebraic_loops(components: Mapping[str, Component], connections: Mapping[str, str]) -> list[AlgebraicLoop]:
    """Return one loop for each set of variables that depend on each other. connections: input = output."""
    depends: dict[str, list[str]] = {target: [source] for target, source in connections.items()}
    connected = {*connections, *connections.values()}  # a loop leads through no other variables
    for name, component in components.items():
        own = {v for v in component.variables if f"{name}.{v}" in connected}
        its_inputs = [v.name for v in component.having("input") if v.name in own]
        for output, inputs in feedthrough(component, its_inputs, own).items():
            depends[f"{name}.{output}"] = [f"{name}.{i}" for i in inputs]
    nodes = list(dict.fromkeys([*depends, *(n for sources in depends.values() for n in sources)]))
    place = {node: i for i, node in enumerate(nodes)}
    edges = [(place[a], place[b]) for a, sources in depends.items() for b in sources]
    if not edges:
        return []
    from scipy.sparse import csgraph, csr_array  # for some connected FMUs, not for the process of each

    graph = csr_array(([1.0] * len(edges), tuple(zip(*edges, strict=True))), shape=(len(nodes), len(nodes)))
    labels = csgraph.connected_components(graph, directed=True, connection="strong")[1].tolist()
    members: dict[int, list[str]] = {}
    for node, label in zip(nodes, labels, strict=True):
        members.setdefault(label, []).append(node)
    return [_loop(found, depends, components) for found in members.values() if len(found) > 1]


def _loop(members: list[str], depends: Mapping[str, list[str]], components: Mapping[str, Component]) -> AlgebraicLoop:
    """Follow the dependencies within a set of variables until one is reached again."""
    found, way = set(members), {members[0]: None}
    while (following := next(n for n in depends[next(reversed(way))] if n in found)) not in way:
        way[following] = None
    nodes = list(way)[list(way).index(following) :]
    outputs = [VariableName(node).parts for node in nodes]
    on = {name: declared(components[name]) for name, _ in outputs}
    silent = [name for name, variable in outputs if on[name].get(variable, []) is None]
    return AlgebraicLoop(tuple(nodes), tuple(dict.fromkeys(silent)))


def _key(component: Component, variable: Any) -> tuple[str, int]:
    """Return a key that an array's elements share; in FMI 2.0 value references are unique within a type only."""
    kind = str(variable.type) if component.description.fmiVersion == "2.0" else ""
    return kind, variable.valueReference & _REFERENCE
