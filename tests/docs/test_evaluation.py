"""docs/evaluation.md is what its files say, and its files are what the commands in it make."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cosim import Scenario, run
from cosim.studies.definition import read_definition
from cosim.studies.factor import toml_text

ROOT = Path(__file__).parents[2]
DATA = ROOT / "docs" / "evaluation"
STUDY = ROOT / "benchmarks" / "studies" / "evaluation.toml"


def rendered(code="print(render(), end='')"):
    program = f"from benchmarks.evaluation import *\n{code}"
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, env=os.environ | {"PYTHONIOENCODING": "utf-8"},
        capture_output=True, text=True, encoding="utf-8",
    )  # fmt: skip
    return done.stdout if done.returncode == 0 else done.stderr


def test_the_document_is_what_prose_and_files_give():
    assert (ROOT / "docs" / "evaluation.md").read_text(encoding="utf-8") == rendered()


def test_the_document_has_no_place_left_empty_and_its_pictures_are_there():
    text = (ROOT / "docs" / "evaluation.md").read_text(encoding="utf-8")
    assert "{{" not in text
    pictures = re.findall(r"!\[.*?\]\((.+?)\)", text)
    assert len(pictures) >= 4
    assert all((ROOT / "docs" / name).read_bytes().startswith(b"\x89PNG") for name in pictures)


@pytest.mark.full
def test_a_number_that_no_file_has_is_an_error():
    assert "KeyError" in rendered(
        "import benchmarks.evaluation as e; e._value(['quadrotor', 'estimators', 'targte', 'ratio'])"
    )


def test_the_prose_names_no_measured_number_by_hand():
    """But for what is quoted from the paper, the settings, and counts: no decimal fraction without its file."""
    prose = (ROOT / "docs" / "evaluation.in.md").read_text(encoding="utf-8")
    ours = re.sub(r"\{\{[^}]+\}\}|```.*?```", "", prose.split("## The paper's slips")[0], flags=re.DOTALL)
    quoted = {"1.3", "1.5", "5.662", "0.144", "1.39", "1.365", "0.115", "0.03", "1.2", "3.8", "0.2"}
    assert set(re.findall(r"\d+\.\d+", ours)) <= quoted


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.parametrize("estimator", ["none", "true", "least-squares", "target"])
def test_a_part_of_it_is_measured_again(estimator):
    """Seed 0 of the quadrotor. Another machine's linear algebra rounds otherwise, and a search follows every bit."""
    kept = json.loads((DATA / "quadrotor.json").read_text(encoding="utf-8"))
    (record,) = [r for r in kept["first_seed"] if r["estimator"] == estimator]
    settings = {key: toml_text(value) for key, value in read_definition(STUDY).study.settings.items()}
    result = run(Scenario.load("quadrotor", settings), estimator, 0).summary()
    tolerance = {"target": 0.5, "least-squares": 0.02}.get(estimator, 1e-6)
    assert result["mse"] == pytest.approx(record["mse"], rel=tolerance)
    assert result["status"] == record["status"]
    assert result["evaluations"] == pytest.approx(record["evaluations"], rel=tolerance)
    for at, before in zip(result["instants"], record["errors"], strict=True):
        errors = [p["estimated"] - p["true"] for p in at["parameters"]]
        assert errors == pytest.approx(before, rel=tolerance, abs=0.0 if estimator in ("none", "true") else 0.3)
