"""The tables of layers: a folder imports from the folders before it, never from those after it."""

import ast
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import pytest


class Package(NamedTuple):
    """A package's folders from the ground up; its loose modules are the ground below them, but for its doors."""

    name: str
    layers: tuple[str, ...]
    doors: frozenset[str]
    some: frozenset[tuple[str, str]]
    """Arrows (from, to) that there are."""

    @property
    def root(self):
        return Path(str(files(self.name)))

    def sources(self):
        """The tree of each module, by its name as a tuple."""
        for path in sorted(self.root.rglob("*.py")):
            yield path.relative_to(self.root).with_suffix("").parts, ast.parse(path.read_text(encoding="utf-8"))

    def arrows(self):
        """(module, folder or loose module that it is, folder or loose module it imports from) of every import."""
        for place, tree in self.sources():
            for node in ast.walk(tree):
                if isinstance(node, ast.ImportFrom) and node.level:
                    above = place[: len(place) - node.level]
                    yield ".".join(place), place[0], [*above, *(node.module or "").split(".")][0]


COSIM = Package(
    "cosim",
    (
        "scenarios", "fmi", "slaves", "ssv", "system", "sampling", "objectives", "retuning", "runs", "studies",
        "campaigns", "plots", "pages", "paper", "offline", "ssp", "authoring", "estimator_fmu", "terminal", "commands",
    ),
    frozenset({"__init__", "cli"}),
    frozenset({("commands", "terminal"), ("retuning", "objectives"), ("fmi", "errors")}),
)  # fmt: skip
ESTIMATOR = Package(
    "estimator",
    ("bayesian", "baselines", "effects", "diagnosis", "retuning", "offline"),
    frozenset({"__init__", "methods"}),
    frozenset({("retuning", "diagnosis"), ("diagnosis", "effects"), ("bayesian", "space")}),
)
EACH = pytest.mark.parametrize("package", [COSIM, ESTIMATOR], ids=lambda package: package.name)


@EACH
def test_every_folder_has_its_layer(package):
    assert {path.parent.name for path in package.root.glob("*/__init__.py")} == set(package.layers)


@EACH
def test_no_import_goes_up_a_layer(package):
    seen = set()
    for module, room, target in package.arrows():
        if room in package.doors:
            continue
        seen.add((room, target))
        if target in package.layers:
            assert room in package.layers, f"{module} is of the ground, and imports from {target}"
            is_above = package.layers.index(target) > package.layers.index(room)
            assert not is_above, f"{module} imports from {target}, which is above it"
    assert package.some <= seen


@EACH
def test_the_ground_has_no_circle(package):
    below = {}
    for _, room, target in package.arrows():
        if room not in (*package.layers, *package.doors):
            below.setdefault(room, set()).add(target)
    while below:
        free = {room for room, targets in below.items() if targets.isdisjoint(below)}
        assert free, f"these import each other: {sorted(below)}"
        below = {room: targets for room, targets in below.items() if room not in free}


@EACH
def test_no_modules_import_each_other_in_a_circle(package):
    known = {".".join(place) for place, _ in package.sources()}
    below = {}
    for place, tree in package.sources():
        imported = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.level:
                stem = [*place[: len(place) - node.level], *([node.module] if node.module else [])]
                imported |= known & {".".join(stem), *(".".join([*stem, alias.name]) for alias in node.names)}
        below[".".join(place)] = imported
    below = {name: found for name, found in below.items() if name not in package.doors}
    assert len(below) > 50
    while free := {name for name, found in below.items() if found.isdisjoint(below)}:
        below = {name: found for name, found in below.items() if name not in free}
    assert not below, f"these import each other: {sorted(below)}"
