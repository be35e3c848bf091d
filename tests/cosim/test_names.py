"""One name, one meaning: no two classes of the packages share a name, and docstrings stand by themselves."""

import ast
from collections import defaultdict
from importlib.resources import files
from pathlib import Path

import pytest

PACKAGES = ("cosim", "estimator", "fmu_models")
SHARED = {
    "Slave": "FMI's word, seen by an importer and by the FMU itself",
    "State": "of each plant's equations",
    "Gains": "of each plant's controller",
    "Fmi3CoSimulation": "an interface, seen by an importer and by the FMU itself",
}
"""Names that may stand twice, and why."""
RIDDLES = ("Of ", "What ", "Which ", "Whether ", "Why ", "How ", "As ", "Who ", "Where ", "That ")
"""Beginnings of a sentence that is none without the name above it."""


def sources(*packages):
    for package in packages:
        root = Path(str(files(package)))
        for path in sorted(root.rglob("*.py")):
            yield f"{package}/{path.relative_to(root).as_posix()}", ast.parse(path.read_text(encoding="utf-8"))


def test_no_two_classes_share_a_name():
    places = defaultdict(list)
    for name, tree in sources(*PACKAGES):
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    assert {name: where for name, where in places.items() if len(where) > 1 and name not in SHARED} == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_the_first_line_of_a_docstring_stands_by_itself(package):
    found = []
    for name, tree in sources(package):
        for node in ast.walk(tree):
            if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                continue
            text = ast.get_docstring(node) or ""
            if text.startswith(RIDDLES):
                found.append(f"{name}:{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}")
    assert found == []
