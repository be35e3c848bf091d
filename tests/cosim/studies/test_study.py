"""Studies from their file to their table, with real runs: the same whatever happens on the way."""

import json
import os
import shlex
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from cosim.cli import main
from cosim.scenarios.scenario import Scenario
from cosim.studies.conduct import enter
from cosim.studies.definition import checked_definition
from cosim.studies.dry_run import of_all
from cosim.studies.folder import STUDY, open_study
from cosim.studies.ledger import LEDGER, open_ledger
from cosim.studies.plan import Study
from cosim.studies.processes import LocalProcesses
from cosim.studies.recipe import KilledFmuError, Recipe
from cosim.studies.row import WALL_TIMES
from cosim.studies.table import RESULTS
from cosim.studies.versions import all_versions
from cosim.studies.worker import make_run
from tests.cosim.studies.chaos import children_of

pytestmark = pytest.mark.fmu

TEXT = """
[study]
name = "payloads"
scenarios = ["pendulum"]
estimators = ["none", "target"]
[study.settings]
"scenario.stop_time" = 0.12
"estimation.budget" = 10
[factors.payload]
set = 'changes."plant.m"'
to = "[[0.0, 1.75], [0.05, {}]]"
list = PAYLOADS
"""


@pytest.fixture
def write(tmp_path):
    """Write a study's file over these payloads."""

    def written(*payloads, more=""):
        path = tmp_path / "payloads.toml"
        path.write_text(TEXT.replace("PAYLOADS", str(list(payloads))) + more)
        return str(path)

    return written


def table_of(folder):
    """The table of a study, but for its wall times."""
    table = pq.read_table(folder / RESULTS)
    return table.drop_columns([name for name in WALL_TIMES if name in table.column_names])


def states(folder):
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        return {state: n for state, n in ledger.counts().items() if n}


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_a_study_is_run_extended_and_told(write, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["study", write(4.0), "--out", str(out), "--jobs", "2"]) == 0
    assert "2 runs over payload and 1 seed" in capsys.readouterr().out
    assert {p.name for p in out.iterdir()} >= {STUDY, LEDGER, RESULTS, "summary.md"}
    first = table_of(out).to_pylist()
    assert [(row["estimator"], row["payload"], row["status"]) for row in first] == [
        ("none", 4.0, "done"), ("target", 4.0, "done"),
    ]  # fmt: skip
    leases = leases_of(out)
    assert main(["study", write(4.0, 3.0), "--out", str(out), "--jobs", "1"]) == 0
    both = table_of(out).to_pylist()
    assert both[:2] == first
    assert [row["payload"] for row in both] == [4.0, 4.0, 3.0, 3.0]
    assert leases_of(out).items() >= leases.items()  # nothing that was done was run again
    assert main(["study", "status", str(out)]) == 0
    assert "4 of 4 runs ended; it has ended\n4 done" in capsys.readouterr().out


def leases_of(folder):
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        return {entry.key: entry.lease for entry in ledger.entries()}


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_the_line_of_a_worst_run_repeats_it(write, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(["study", write(4.0), "--out", str(out)]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("  retune run"))
    assert main([*shlex.split(line)[1:], "--out", str(tmp_path / "run"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert sum(again["mse"]) == table_of(out).to_pylist()[1]["mse"]


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_a_study_whose_head_is_killed_goes_on_to_the_same_table(write, tmp_path, becomes_true):
    path, out, serial = write(4.0, 3.0, 2.0), tmp_path / "out", tmp_path / "serial"
    assert main(["study", path, "--out", str(serial), "--jobs", "1"]) == 0
    command = [sys.executable, "-m", "cosim.cli", "study", path, "--out", str(out), "--jobs", "2"]
    head = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    assert becomes_true(lambda: (out / LEDGER).exists() and is_under_way(out))
    os.kill(head.pid, signal.SIGKILL)
    head.wait()
    assert main(["resume", str(out), "--jobs", "2"]) == 0
    assert table_of(out) == table_of(serial)
    assert main(["resume", str(out)]) == 0  # nothing is left to do
    assert table_of(out) == table_of(serial)


def is_under_way(folder):
    try:
        return states(folder).get("done", 0) > 0
    except Exception:  # it has only just begun
        return False


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_a_run_that_is_refused_is_counted_and_the_others_are_made(write, tmp_path, capsys):
    out, more = (
        tmp_path / "out",
        '[factors.wire]\nset = \'connections."plant.u"\'\nlist = ["controller.u", "controller.v"]\n',
    )
    assert main(["study", write(4.0, more=more), "--out", str(out)]) == 1
    assert states(out) == {"done": 2, "refused": 2}
    assert "2 runs were refused" in capsys.readouterr().out
    assert "no output of controller" in table_of(out).to_pylist()[2]["error"]


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_runs_that_are_kept_have_their_folders_and_nothing_else_is_left(write, tmp_path):
    out = tmp_path / "out"
    path = write(4.0)
    with open(path) as file:
        text = file.read().replace("[study]\n", "[study]\nkeep = true\n")
    with open(path, "w") as file:
        file.write(text)
    assert main(["study", path, "--out", str(out)]) == 0
    names = sorted(p.name for p in (out / "runs").iterdir())
    assert [name.rpartition("-")[0] for name in names] == ["none-0", "target-0"]
    assert sorted(row["run"] for row in table_of(out).to_pylist()) == names


@pytest.mark.full
def test_an_fmu_that_is_killed_from_outside_is_no_result(children, becomes_true):
    recipe = Recipe(Scenario.load("pendulum"), "none", 0, all_versions())
    before = children()
    with LocalProcesses(1) as processes:
        future = processes.submit(make_run, recipe)
        found = []
        assert becomes_true(lambda: found.append(fmus_below(children() - before)) or len(found[-1]) == 3)
        os.kill(found[-1][0], signal.SIGKILL)
        with pytest.raises(KilledFmuError, match="was ended by SIGKILL"):
            future.result()
        short = Scenario.load("pendulum", {"scenario.stop_time": "0.05"})
        assert processes.submit(make_run, replace(recipe, scenario=short)).result().kind == "result"  # it goes on


def fmus_below(workers):
    """The FMUs' processes of some workers, without the server that they are copies of, whose mark is none."""
    none = b"FMU_RETUNE_PROCESS=" + 16 * b"0"
    below = [process for worker in workers for process in children_of(worker)]
    found = []
    for process in below:
        with suppress(OSError):  # it has ended since
            environment = Path(f"/proc/{process}/environ").read_bytes()
            found += [process] if environment and none not in environment else []
    return found


def test_a_dry_run_weighs_runs_by_the_number_of_those_like_them():
    """Those of which none was made, 50 at the end, are taken for as long as the mean."""
    assert of_all([1.0, 1.0, 1.0], [1, 10, 100]) == 111.0
    assert of_all([1.0, 2.0, 3.0], [1, 10, 100, 50]) == 1.0 + 20.0 + 300.0 + 50 * 2.0


@pytest.mark.full
def test_a_dry_run_makes_no_folder_and_says_how_many(write, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["study", write(4.0, 3.0, 2.0), "--dry-run", "--jobs", "2"]) == 0
    told = capsys.readouterr().out
    assert told.startswith("6 runs: 3 points, 2 estimators, 1 seed\nabout ")
    assert {p.name for p in tmp_path.iterdir()} == {"payloads.toml"}


@pytest.mark.full
def test_a_dry_run_says_why_a_run_would_end_early(write, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["study", write(-4.0), "--dry-run"]) == 0
    *_, nominal, retuned = capsys.readouterr().out.splitlines()
    for estimator, line in (("none", nominal), ("target", retuned)):
        assert line.startswith(f"one with {estimator}: faulted, ")
        assert "'m' must be within" in line


@pytest.mark.full
@pytest.mark.usefixtures("leaves_nothing")
def test_a_sweep_is_a_study_over_its_values(tmp_path, capsys):
    out = tmp_path / "out"
    values = ["--set", "scenario.stop_time=0.1", "--set", "estimation.budget=10,20"]
    assert main(["compare", "pendulum", "--estimators", "target", "--seeds", "1", *values, "--out", str(out)]) == 0
    rows = table_of(out).to_pylist()
    assert [(r["estimator"], r["estimation.budget"]) for r in rows] == [
        (e, b) for b in (10, 20) for e in ("none", "true", "target")
    ]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["gone.toml"], "gone.toml: not a readable TOML file"),
        (["status", "."], "is no study's folder"),
        (["a.toml", "b.toml"], "give one study"),
        (["status"], "give one study, or `status` and one folder"),
        (["pendulum"], "pendulum is a scenario"),
        (["payloads.toml", "--on", "tcp://10.0.0.1:8786"], "without TLS runs code"),
        (["payloads.toml", "--on", "head"], "must be the address of a Dask scheduler"),
    ],
)
def test_what_cannot_be_is_one_line_and_makes_no_folder(write, tmp_path, capsys, monkeypatch, arguments, told):
    monkeypatch.chdir(tmp_path)
    write(4.0)
    assert main(["study", *arguments]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert len(error.splitlines()) == 1
    assert {p.name for p in tmp_path.iterdir()} == {"payloads.toml"}


def test_a_point_that_cannot_be_is_named(write, capsys):
    assert main(["study", write("x")]) == 2
    assert "pendulum (payload x): changes" in capsys.readouterr().err


def test_another_study_is_not_mixed_into_a_folder(write, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine").write_text("kept")
    assert main(["study", write(4.0), "--out", str(out)]) == 2
    assert "is not empty" in capsys.readouterr().err
    assert [p.name for p in out.iterdir()] == ["mine"]


def test_a_study_that_somebody_else_has_made_runs_no_code_unasked(axis, tmp_path, capsys, monkeypatch):
    path, out = axis(), tmp_path / "out"
    out.mkdir()
    tables = {"study": {"name": "s", "scenarios": [str(path)], "estimators": ["none"]}}
    study = Study(checked_definition(tables, "s"), (Scenario.load(path),), (str(path),))
    with open_study(out, study, "study") as ledger:
        enter(study, {run.key: run for run in study.runs()}, ledger)
    (tmp_path / "axis_model.py").write_text("raise SystemExit('it ran')")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another user"))
    assert main(["resume", str(out)]) == 2
    assert f"{out} would run Python code (module axis_model), which only --trust allows" in capsys.readouterr().err
    content = json.loads((out / STUDY).read_text())
    content["definition"]["study"]["estimators"] = ["target"]
    (out / STUDY).write_text(json.dumps(content))
    assert main(["resume", str(out)]) == 2
    assert "study.json is not as it was written" in capsys.readouterr().err


def test_a_study_goes_on_only_as_it_was(axis, tmp_path, capsys):
    path, out = axis(), tmp_path / "out"
    out.mkdir()
    tables = {"study": {"name": "s", "scenarios": [str(path)], "estimators": ["none"]}}
    study = Study(checked_definition(tables, "s"), (Scenario.load(path),), (str(path),))
    with open_study(out, study, "study") as ledger:
        enter(study, {run.key: run for run in study.runs()}, ledger)
    with open(tmp_path / "axis_model.py", "a") as file:
        file.write("\n# changed\n")
    assert main(["resume", str(out)]) == 2
    assert "1 of 1 runs are not as they were planned" in capsys.readouterr().err


def test_two_points_that_are_the_same_runs_are_refused(write, capsys):
    assert main(["study", write(2.0, 3.0, 2.0), "--dry-run"]) == 2
    told = capsys.readouterr().err
    assert told == ("retune: pendulum (payload 2.0): the same run as pendulum (payload 2.0); leave one of them out.\n")
