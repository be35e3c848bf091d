"""What benchmarks keep: a line for each record, rows that take the place of older ones, and nothing heavy."""

import json
import math
from pathlib import Path

import pytest

from benchmarks import evaluation, report
from cosim.cli import main

ROOT = Path(__file__).parents[2]


def test_a_kept_file_has_a_line_for_each_row_and_null_for_what_is_not_finite(tmp_path):
    report.keep(tmp_path, "some", [{"a": 1.5, "b": {"n": 2}}, {"a": math.nan, "b": {"n": math.inf}}], "a note")
    text = (tmp_path / "some.json").read_text(encoding="utf-8")
    assert '\n{"a": 1.5, "b": {"n": 2}},\n{"a": null, "b": {"n": null}}\n' in text
    assert json.loads(text)["notes"] == "a note"
    assert report.stored(tmp_path, "some") == [{"a": 1.5, "b": {"n": 2}}, {"a": None, "b": {"n": None}}]
    assert report.stored(tmp_path, "none of that name") == []


def test_new_rows_take_the_place_of_those_with_the_same_keys_and_others_stay(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    report.keep(tmp_path, "some", [{"a": 1, "b": 1, "c": "old"}, {"a": 1, "b": 2, "c": "old"}])
    rows = report.updated("some", [{"a": 1, "b": 3, "c": "new"}, {"a": 1, "b": 1, "c": "new"}], "a", "b")
    assert [(row["b"], row["c"]) for row in rows] == [(1, "new"), (2, "old"), (3, "new")]


def test_a_comparison_is_kept_without_its_runs_but_for_what_those_of_the_first_seed_came_to():
    runs = [
        {
            "estimator": "ukf", "seed": seed, "status": "done", "mse": [0.1], "evaluations": 7, "wall_s": 1.0,
            "instants": [{"t": 4.0, "parameters": [{"name": "m", "estimated": 3.0, "true": 2.5}]}],
        }
        for seed in (3, 4)
    ]  # fmt: skip
    figures = [{"estimator": "ukf", "runs": 2}]
    facts = {"scenario": "pendulum", "seeds": [3, 4], "jobs": 1, "cpus": 2, "deadline_ms": 10.0, "versions": {}}
    kept = evaluation.compared({**facts, "estimators": figures, "runs": runs, "settings": {}, "folder": "/somewhere"})
    first = [{"estimator": "ukf", "status": "done", "mse": [0.1], "evaluations": 7, "errors": [[0.5]]}]
    assert kept == facts | {"estimators": figures, "first_seed": first}


@pytest.mark.full
@pytest.mark.fmu
def test_a_comparison_is_made_of_the_runs_of_a_study_and_what_has_none_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluation, "DATA", tmp_path)
    ours = {name: ("out", name, ("target",)) for name in ("pendulum", "stiction")}
    monkeypatch.setattr(evaluation, "COMPARISONS", ours)
    study = tmp_path / "s.toml"
    study.write_text(
        '[study]\nname = "s"\nscenarios = ["pendulum"]\nseeds = { none = 2, true = 2, target = 1 }\nkeep = true\n'
        '[study.settings]\n"scenario.stop_time" = 0.1\n'
    )
    assert main(["study", str(study), "--out", str(tmp_path / "out")]) == 0
    evaluation.collect(tmp_path)
    kept = json.loads((tmp_path / "pendulum.json").read_text(encoding="utf-8"))
    assert (kept["seeds"], [run["estimator"] for run in kept["first_seed"]]) == ([0], ["none", "true", "target"])
    assert "| target |" in (tmp_path / "pendulum.md").read_text(encoding="utf-8")
    assert not list(tmp_path.glob("stiction.*"))


def test_the_kept_files_are_small():
    kept = [*(ROOT / "docs" / "evaluation").rglob("*.json"), *report.RESULTS.glob("*.json")]
    assert kept
    # Half of it are the guard's: a row for each case, estimator and objective, 542 of 280 bytes.
    assert sum(path.stat().st_size for path in kept) <= 350_000


def test_a_document_gets_a_table_between_its_marks_and_nothing_else():
    text = "before\n<!-- a -->\nold\n<!-- end -->\n<!-- b -->\nother\n<!-- end -->\nafter\n"
    assert report.replaced(text, "a", "new") == text.replace("old", "new")
    assert report.replaced(text, "b", "new") == text.replace("other", "new")
    with pytest.raises(ValueError, match="no <!-- c -->"):
        report.replaced(text, "c", "new")
