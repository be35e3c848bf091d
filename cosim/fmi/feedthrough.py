"""Direct feedthrough: which inputs an output depends on within a communication point, and the loops that close by it.

FMI 2.0.4, section 2.2.8 (ModelStructure): an output without `dependencies` may depend on every input.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from fmpy.model_description import Unknown
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

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


def feedthrough(component: Component) -> dict[str, list[str]]:
    """Return the inputs that each output depends on, by its name: all of them where the FMU declares none."""
    inputs = {v.name: None for v in component.having("input")}
    return {name: [i for i in inputs if on is None or i in on] for name, on in declared(component).items()}


def algebraic_loops(components: Mapping[str, Component], connections: Mapping[str, str]) -> list[AlgebraicLoop]:
    """Return one loop for each set of variables that depend on each other. connections: input = output."""
    depends: dict[str, list[str]] = {target: [source] for target, source in connections.items()}
    for name, component in components.items():
        for output, inputs in feedthrough(component).items():
            depends[f"{name}.{output}"] = [f"{name}.{i}" for i in inputs]
    nodes = list(dict.fromkeys([*depends, *(n for sources in depends.values() for n in sources)]))
    place = {node: i for i, node in enumerate(nodes)}
    edges = [(place[a], place[b]) for a, sources in depends.items() for b in sources]
    if not edges:
        return []
    rows, columns = np.array(edges).T
    graph = csr_array((np.ones(len(edges)), (rows, columns)), shape=(len(nodes), len(nodes)))
    labels = connected_components(graph, directed=True, connection="strong")[1].tolist()
    members: dict[int, list[str]] = {}
    for node, label in zip(nodes, labels, strict=True):
        members.setdefault(label, []).append(node)
    return [_loop(found, depends, components) for found in members.values() if len(found) > 1]


def _loop(members: list[str], depends: Mapping[str, list[str]], components: Mapping[str, Component]) -> AlgebraicLoop:
    """Follow the dependencies within a set of variables until one is reached again."""
    way = [members[0]]
    while True:
        following = next(n for n in depends[way[-1]] if n in members)
        if following in way:
            break
        way.append(following)
    nodes = way[way.index(following) :]
    outputs = [node.partition(".") for node in nodes]
    silent = [c for c, _, variable in outputs if declared(components[c]).get(variable, []) is None]
    return AlgebraicLoop(tuple(nodes), tuple(dict.fromkeys(silent)))


def _key(component: Component, variable: Any) -> tuple[str, int]:
    """Return a key that an array's elements share; in FMI 2.0 value references are unique within a type only."""
    kind = str(variable.type) if component.description.fmiVersion == "2.0" else ""
    return kind, variable.valueReference & _REFERENCE
