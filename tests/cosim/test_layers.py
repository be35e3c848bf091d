"""The table of layers: a room imports from the rooms before it, never from those after it."""

import ast
from importlib.resources import files
from pathlib import Path

LAYERS = (
    "scenarios", "fmi", "slaves", "ssv", "system", "sampling", "objectives", "retuning", "runs", "studies", "campaigns",
    "plots", "pages", "paper", "offline", "ssp", "authoring", "estimator_fmu", "terminal", "commands",
)  # fmt: skip
"""Folders of cosim, from the ground up; loose modules are the ground below them, but for these two."""
DOORS = {"__init__", "cli"}
ROOT = Path(str(files("cosim")))


def arrows():
    """(module, folder it stands in, folder or loose module that it imports from) of every import within cosim."""
    for path in sorted(ROOT.rglob("*.py")):
        place = path.relative_to(ROOT).with_suffix("").parts
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                above = place[: len(place) - node.level]
                target = [*above, *(node.module or "").split(".")]
                yield ".".join(place), place[0], target[0]


def test_every_folder_has_its_layer():
    assert {path.parent.name for path in ROOT.glob("*/__init__.py")} == set(LAYERS)


def test_no_import_goes_up_a_layer():
    seen = set()
    for module, room, target in arrows():
        if room in DOORS:
            continue
        seen.add((room, target))
        if target in LAYERS:
            assert room in LAYERS, f"{module} is of the ground, and imports from {target}"
            assert LAYERS.index(target) <= LAYERS.index(room), f"{module} imports from {target}, which is above it"
    assert {("commands", "terminal"), ("retuning", "objectives"), ("fmi", "errors")} <= seen


def test_the_ground_has_no_circle():
    below = {}
    for _, room, target in arrows():
        if room not in (*LAYERS, *DOORS):
            below.setdefault(room, set()).add(target)
    while below:
        free = {room for room, targets in below.items() if targets.isdisjoint(below)}
        assert free, f"these import each other: {sorted(below)}"
        below = {room: targets for room, targets in below.items() if room not in free}


def modules_below():
    """The modules that each module of cosim imports, by name."""
    known = {".".join(path.relative_to(ROOT).with_suffix("").parts): path for path in ROOT.rglob("*.py")}
    below = {}
    for name, path in known.items():
        place = name.split(".")
        imported = set()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level:
                stem = [*place[: len(place) - node.level], *([node.module] if node.module else [])]
                names = {".".join(stem), *(".".join([*stem, alias.name]) for alias in node.names)}
                imported |= names & known.keys()
        below[name] = imported
    return below


def test_no_modules_import_each_other_in_a_circle():
    below = {name: found for name, found in modules_below().items() if name not in DOORS}
    assert len(below) > 100
    while free := {name for name, found in below.items() if found.isdisjoint(below)}:
        below = {name: found for name, found in below.items() if name not in free}
    assert not below, f"these import each other: {sorted(below)}"
