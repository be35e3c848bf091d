"""The JSON Schema of scenario files is in step with the loader: on whole files, and on 1000 that are mutated."""

import copy
import json
import random
import re
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from cosim.cli import main
from cosim.scenarios.json_schema import URL, json_schema
from cosim.scenarios.named import named_scenarios
from cosim.scenarios.scenario import Scenario, ScenarioError
from estimator import METHODS

ROOT = Path(__file__).parents[3]
SCHEMA = Draft202012Validator(json_schema())
FILES = [
    *(Path(str(files("cosim") / "scenarios" / f"{name}.toml")) for name in named_scenarios()),
    *sorted((ROOT / "examples").glob("*/*.toml")),
    ROOT / "tests" / "foreign" / "axis.toml",
]
FURTHER = {
    "limits": {"divergence": 10.0},
    "observations": {"outlier": 5.0},
    "diagnosis": {"false_alarm": 1e-5, "rest": 500},
    "guard": {"tolerance": 0.1, "foresight": True},
    "definitions": {"w": "sin(t)"},
}
"""Tables that few files have, one key with its former name."""
OTHERS = ["text", "1.5", "", True, False, -1, 0, 1, 7, 0.5, 1e12, -0.5, [], [1.0], ["a"], {}, {"a": 1}, [[0.0, "t"]]]


def tables_of(path):
    return tomllib.loads(path.read_text(encoding="utf-8"))


def places(tree, path=()):
    """All keys and places of a tree, with the path to each."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def mutated(tables, rng):
    """The tables with one fault, or what may be one."""
    tree = copy.deepcopy(tables) | (copy.deepcopy(FURTHER) if rng.random() < 0.3 else {})
    *path, last = rng.choice(list(places(tree)))
    parent = tree
    for key in path:
        parent = parent[key]
    match rng.randrange(4 if isinstance(parent, dict) else 2):
        case 0:
            del parent[last]
        case 1:
            parent[last] = rng.choice(OTHERS)
        case 2:
            parent[f"{last}x"] = parent.pop(last)
        case 3:
            parent["unknown"] = rng.choice(OTHERS)
    return tree


def faults(tables, folder):
    """The loader's errors: pydantic's types of them, and the text."""
    try:
        Scenario.from_tables(tables, None, folder, Path("s.toml"))
    except ScenarioError as e:
        assert isinstance(e.__cause__, ValidationError), e
        return {error["type"] for error in e.__cause__.errors()}, str(e)
    return set(), ""


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_whole_files_are_valid(path):
    assert [error.message for error in SCHEMA.iter_errors(tables_of(path) | FURTHER)] == []


@pytest.mark.full
def test_it_is_in_step_with_the_loader_on_1000_mutated_files(tmp_path):
    """What the loader takes is valid; what it refuses for a key, a type or a range is not. Rules that a schema cannot
    say, such as that a component is one that there is, are the loader's `value_error`s."""
    rng = random.Random(0)
    trees = [tables_of(path) for path in FILES]
    n_refused = n_taken = 0
    for i in range(1000):
        tables = mutated(trees[i % len(trees)], rng)
        types, text = faults(tables, tmp_path)
        follows = {"too_short"} if "value_error" in types else set()  # a list whose only item was refused
        is_valid = SCHEMA.is_valid(tables)
        if not types:
            n_taken += 1
            assert is_valid, (tables, [error.message for error in SCHEMA.iter_errors(tables)])
        elif types - follows != {"value_error"} or re.search(r": must be (a|true)", text):
            n_refused += 1
            assert not is_valid, text
    assert n_taken > 100
    assert n_refused > 400


def test_every_estimator_and_key_is_described():
    estimation = json_schema()["$defs"]["EstimationSettings"]["properties"]
    assert set(METHODS) <= set(estimation)
    assert "trigger" in estimation["target"]["properties"]
    assert SCHEMA.schema["$defs"]["SimulationSettings"]["properties"]["macro_step"]["description"].endswith("[s].")


@pytest.mark.parametrize(
    ("key", "value", "reason"),
    [
        ("scenario.stop_time", '"10.0"', "scenario.stop_time: must be a number, got '10.0'"),
        ("estimation.budget", "true", "estimation.budget: must be a whole number, got True"),
        ("guard.enabled", "1", "guard.enabled: must be true or false, got 1"),
        ("diagnosis.rest", '"7"', "diagnosis.rest: must be a whole number, got '7'"),
        ("estimation.trigger.false_alarm", '"1"', "estimation.trigger.false_alarm: must be a number, got '1'"),
        ("estimation.least-squares.max_evaluations", '"9"', r"estimation.least-squares.\w+: "),
    ],
)
def test_a_text_is_no_number_and_a_truth_value_none(key, value, reason):
    with pytest.raises(ScenarioError, match=reason):
        Scenario.load("pendulum", {key: value})


def test_the_committed_schema_is_fresh():
    text = (ROOT / "docs" / Path(URL).name).read_text(encoding="utf-8")
    assert json.loads(text) == json_schema(), "make docs-tables"


def test_the_command_prints_or_writes_it(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema()
    assert main(["schema", "-o", "s.json"]) == 0
    assert json.loads(Path("s.json").read_text()) == json_schema()
    assert main(["schema", "-o", "s.json"]) == 2
    assert "exists" in capsys.readouterr().err
