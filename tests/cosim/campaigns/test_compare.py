"""Comparisons: figures against numbers worked out by hand, and real runs that are the same for any number of jobs."""

import csv
import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.campaigns.compare import compare, comparison_study
from cosim.campaigns.comparison import Comparison
from cosim.campaigns.tables import WIDTH, estimator_columns, run_columns, to_csv, to_markdown
from cosim.cli import main
from cosim.errors import FolderError, ScenarioError, UnfinishedError, is_refusal
from cosim.runs.lock import new_locked_folder
from cosim.runs.run_files import LOCK
from cosim.scenarios.scenario import Scenario
from cosim.studies.conduct import enter, planned
from cosim.studies.folder import STUDY, open_study
from cosim.studies.head import StudyError
from cosim.studies.ledger import LEDGER, open_ledger

EARLY_CHANGE = {
    'changes."plant.m"': "[[0.0, 1.75], [0.1, 4.271]]",
    'changes."plant.l"': "[[0.0, 0.75], [0.1, 0.981]]",
    "estimation.instants": "[0.05, 0.3]",
}
WALL_TIMES = ("latency_ms", "missed_deadlines", "wall_s", "latencies_ms", "run")


# Figures of made-up runs: nothing is simulated here.


def held(names, estimated, true):
    return [{"name": n, "unit": "", "true": t, "estimated": e} for n, e, t in zip(names, estimated, true, strict=True)]


def record(estimator, seed, mse, held_at=None, **changes):
    """A run of the pendulum as `crew.record_of` tells it; held_at: t to estimated (m, l), the truth being (4, 1)."""
    at = [{"t": t, "parameters": held("ml", e, (4.0, 1.0))} for t, e in (held_at or {}).items()]
    return {
        "scenario": "pendulum", "estimator": estimator, "seed": seed,
        "mse": mse if isinstance(mse, list) else [mse], "max_error": 0.5,
        "parameters": at[-1]["parameters"] if at else [], "instants": at,
        "evaluations": 0, "model_calls": 0, "episodes": 0,
        "latency_ms": {"p50": None, "p99": None, "max": None}, "deadline_ms": 10.0, "missed_deadlines": 0,
        "wall_s": 1.0, "status": "done", "diverged_at": None, "error": None, "run": None, "end": 10.0,
        "reference_mean_square": [1.0], "latencies_ms": [],
    } | changes  # fmt: skip


@pytest.fixture
def made_up():
    """Three seeds: `target` diverges with seed 1 and faults before its first row with seed 2; floors 0.1, 0.2, 0.4."""
    fault = {"status": "faulted", "end": None, "error": "plant: boom", "max_error": float("nan")}
    runs = (
        *(record("none", seed, 1.0, {4.0: (1.0, 1.5)}) for seed in range(3)),
        *(record("true", seed, mse, {4.0: (4.0, 1.0)}) for seed, mse in enumerate((0.1, 0.2, 0.4))),
        record(
            "target", 0, 0.3, {4.0: (4.5, 0.75)},
            evaluations=30, latencies_ms=[[1.0, 2.0], [3.0]], missed_deadlines=1,
        ),
        record(
            "target", 1, 5.0, {}, evaluations=10, latencies_ms=[[101.0, 4.0]], missed_deadlines=2,
            status="diverged", end=3.25, diverged_at=3.25,
        ),
        record("target", 2, float("nan"), {}, reference_mean_square=[None], **fault),
    )  # fmt: skip
    scenario = Scenario.load("pendulum", {"estimation.instants": "[4.0]"})
    return Comparison(scenario, ("none", "true", "target"), (0, 1, 2), runs, jobs=2, cpus=4)


def test_figures_are_median_and_worst_of_the_runs_that_have_them(made_up):
    none, true, target = made_up.rows()
    assert none["mse"] == {"plant.phi": {"median": 1.0, "worst": 1.0, "n": 3}}
    assert true["mse"] == {"plant.phi": {"median": 0.2, "worst": 0.4, "n": 3}}
    # 0.3 and, of the run that diverged, 5.0; the one without rows has none
    assert target["mse"] == {"plant.phi": {"median": pytest.approx(2.65), "worst": 5.0, "n": 2}}
    assert target["evaluations"] == {"median": 10.0, "worst": 30.0, "n": 3}


def test_the_ratio_is_to_the_floor_of_the_same_seed(made_up):
    none, true, target = made_up.rows()
    assert none["ratio"] == {"median": pytest.approx(5.0), "worst": pytest.approx(10.0), "n": 3}  # 10, 5, 2.5
    assert true["ratio"] == {"median": 1.0, "worst": 1.0, "n": 3}
    assert target["ratio"] == {"median": pytest.approx(14.0), "worst": pytest.approx(25.0), "n": 2}  # 3, 25


def test_the_ratio_is_that_of_sums_over_the_tracked_outputs(made_up):
    runs = (
        record("true", 0, [1.0, 3.0], reference_mean_square=[1.0, 1.0]),
        record("none", 0, [2.0, 18.0], reference_mean_square=[1.0, 1.0]),
    )
    comparison = Comparison(made_up.scenario, ("none", "true"), (0,), runs, 1, 1)
    assert comparison.ratio(runs[1]) == 5.0  # and not (2 + 6) / 2


@pytest.mark.parametrize(("floor", "expected"), [(0.0, None), (1e-19, None), (1e-17, 1e17)])
def test_nothing_is_divided_by_a_floor_that_is_rounding(made_up, floor, expected):
    runs = (record("true", 0, floor), record("none", 0, 1.0))
    comparison = Comparison(made_up.scenario, ("none", "true"), (0,), runs, 1, 1)
    assert comparison.ratio(runs[1]) == (expected and pytest.approx(expected))
    assert ("the floor is zero" in comparison.table()) == (expected is None)


def test_parameter_errors_are_those_at_the_instant_and_of_runs_that_reached_it(made_up):
    none, true, target = (row["parameter_errors"] for row in made_up.rows())
    assert [at["t"] for at in none] == [4.0]
    assert none[0]["errors"] == {
        "m [kg]": {"median": 3.0, "worst": 3.0, "n": 3}, "l [m]": {"median": 0.5, "worst": 0.5, "n": 3},
    }  # fmt: skip
    assert true[0]["errors"]["m [kg]"] == {"median": 0.0, "worst": 0.0, "n": 3}
    assert target[0]["errors"]["l [m]"] == {"median": 0.25, "worst": 0.25, "n": 1}


def test_parameters_of_one_unit_are_one_error_in_that_unit():
    scenario = Scenario.load("quadrotor", {"estimation.instants": "[1.5]"})
    names = ("m", "J_x", "J_y", "J_z")
    parameters = held(names, (2.0, 3.0, 4.0, 5.0), (1.5, 1.0, 3.0, 7.0))
    run = record("none", 0, [1.0] * 3, reference_mean_square=[1.0] * 3)
    run["instants"] = [{"t": 1.5, "parameters": parameters}]
    comparison = Comparison(scenario, ("none",), (0,), (run,), 1, 1)
    assert comparison.groups == {"m [kg]": ("m",), "J [kg.m2]": ("J_x", "J_y", "J_z")}
    errors = comparison.rows()[0]["parameter_errors"][0]["errors"]
    assert errors["m [kg]"]["worst"] == pytest.approx(0.5)
    assert errors["J [kg.m2]"]["worst"] == pytest.approx(3.0)  # of (2, 1, -2)


def test_without_an_instant_in_the_run_parameters_are_compared_at_its_end(made_up):
    scenario = Scenario.load("pendulum", {"estimation.instants": "[11.0]"})
    runs = (
        record("none", 0, 1.0, parameters=held("ml", (1.0, 1.5), (4.0, 1.0))),
        record("none", 1, 1.0, parameters=held("ml", (9.0, 9.0), (4.0, 1.0)), status="diverged", end=2.0),
    )
    comparison = Comparison(scenario, ("none",), (0, 1), runs, 1, 1)
    assert comparison.instants == (10.0,)
    assert comparison.rows()[0]["parameter_errors"][0]["errors"]["m [kg]"] == {"median": 3.0, "worst": 3.0, "n": 1}


def test_latencies_are_those_of_all_evaluations_of_all_seeds(made_up):
    none, _, target = made_up.rows()
    # 1, 2, 3, 4, 101: the 99 % quantile lies 0.96 of the way from the fourth to the fifth
    assert target["latency_ms"] == {"p50": 3.0, "p99": pytest.approx(4.0 + 0.96 * 97.0), "n": 5}
    assert (target["missed_deadlines"], target["steps_with_evaluations"]) == (3, 3)
    assert none["latency_ms"] == {"p50": None, "p99": None, "n": 0}


def test_no_run_is_left_out_however_it_ended(made_up):
    target = made_up.rows()[2]
    assert target["runs"] == 3
    assert target["diverged"] == [{"seed": 1, "t": 3.25, "error": None}]
    assert target["faulted"] == [{"seed": 2, "t": None, "error": "plant: boom"}]
    told = [run_columns(made_up, r) for r in made_up.runs]
    assert [(r["estimator"], r["seed"]) for r in told] == [(e, s) for e in made_up.estimators for s in range(3)]
    assert [(r["status"], r["end"], r["error"]) for r in told[-2:]] == [
        ("diverged", 3.25, None), ("faulted", None, "plant: boom"),
    ]  # fmt: skip
    assert [r["mse plant.phi"] for r in told[-3:]] == [0.3, 5.0, pytest.approx(float("nan"), nan_ok=True)]
    assert next(csv.DictReader(to_csv(told[-1:]).splitlines()))["mse plant.phi"] == ""
    for text in (made_up.table(), to_markdown(made_up)):
        assert "target, seed 1: diverged at t = 3.250 s" in text
        assert "target, seed 2: faulted before its first row: plant: boom" in text
        assert "2.65 / 5 (2)" in text


def test_json_has_null_and_never_nan(made_up):
    def refuse(constant):
        pytest.fail(constant)

    content = json.loads(made_up.to_json(), parse_constant=refuse)
    assert content["runs"][-1]["mse"] == [None]
    assert (content["jobs"], content["cpus"], content["seeds"]) == (2, 4, [0, 1, 2])
    assert len(content["runs"]) == 9
    assert content["estimators"][2]["diverged"] == [{"seed": 1, "t": 3.25, "error": None}]


def test_csv_has_the_figures_of_the_rows(made_up):
    table = {row["estimator"]: estimator_columns(row) for row in made_up.rows()}
    assert list(table) == ["none", "true", "target"]
    target = table["target"]
    assert (target["mse plant.phi worst"], target["mse plant.phi n"]) == (5.0, 2)
    assert target["ratio median"] == pytest.approx(14.0)
    assert target["error l [m] at 4 s median"] == 0.25
    assert (target["diverged"], target["diverged seeds and times"]) == (1, "1: 3.250 s")
    assert target["faulted seeds and times"] == "2: no rows"
    assert table["none"]["latency_ms p50"] is None


def test_the_number_of_jobs_is_told_beside_latencies(made_up):
    alone = Comparison(made_up.scenario, made_up.estimators, made_up.seeds, made_up.runs, jobs=1, cpus=4)
    for text in (to_markdown(made_up), made_up.table().replace("\n  ", " ")):
        assert "2 runs at a time on 4 processors" in text
    assert "one run at a time" in to_markdown(alone)


def test_every_table_of_the_quadrotor_fits_the_terminal_and_has_every_column():
    scenario = Scenario.load("quadrotor")
    names = ("m", "J_x", "J_y", "J_z")
    wide = (1.23456e-5, 2.34567e-5, 3.45678e-5, 4.56789e-5)
    instants = [{"t": t, "parameters": held(names, wide, (0.0,) * 4)} for t in scenario.estimation.instants]
    estimators = ("none", "true", "an-estimator-of-a-long-name")
    runs = tuple(
        record(
            e, s, [1.23456e-7] * 3, reference_mean_square=[1.0] * 3, instants=instants,
            status="faulted", error="x " * 150,
        )
        for e in estimators for s in (0, 1)
    )  # fmt: skip
    comparison = Comparison(scenario, estimators, (0, 1), runs, 1, 1)
    lines = comparison.table().splitlines()
    assert max(map(len, lines)) <= WIDTH == 120
    for t in scenario.estimation.instants:
        assert sum(f"t = {t:g} s" in line for line in lines) >= 2  # mass, inertia
    assert sum(line.startswith("an-estimator-of-a-long-name  ") for line in lines) >= 4


# Real runs.


def real(test):
    """A test with real FMUs in processes of their own."""
    return pytest.mark.fmu(pytest.mark.usefixtures("leaves_nothing")(test))


@pytest.mark.full
@real
def test_the_number_of_jobs_changes_no_bit_but_those_of_wall_times(pendulum, tmp_path):
    scenario = pendulum(EARLY_CHANGE)
    results = []
    for jobs in (1, 2):
        out = tmp_path / f"jobs {jobs}"
        seen = []
        comparison = compare(
            scenario,
            ["target"],
            [4, 2],
            jobs,
            out,
            keep=jobs == 2,
            progress=lambda r, k, n: seen.append((k, n)),  # noqa: B023
        )
        assert seen == [(k, 6) for k in range(1, 7)]
        assert (comparison.jobs, comparison.estimators) == (jobs, ("none", "true", "target"))
        results.append([{k: v for k, v in r.items() if k not in WALL_TIMES} for r in comparison.runs])
        check_folder(out, comparison)
    assert results[0] == results[1]
    assert [(r["estimator"], r["seed"]) for r in results[0]] == [
        (e, s) for e in ("none", "true", "target") for s in (4, 2)
    ]
    assert results[0][4]["evaluations"] > 0
    assert results[0][4]["parameters"] != results[0][5]["parameters"]  # of another seed
    assert not [p for p in (tmp_path / "jobs 1").iterdir() if p.is_dir()]
    kept = {p.name for p in (tmp_path / "jobs 2").iterdir() if p.is_dir()}
    assert kept == {f"{e}-{s}" for e in ("none", "true", "target") for s in (4, 2)}
    assert json.loads((tmp_path / "jobs 2" / "target-2" / "manifest.json").read_text())["seed"] == 2


def check_folder(out, comparison):
    files = {p.name for p in out.iterdir() if p.is_file()}
    assert files == {"comparison.json", "comparison.md", "comparison.csv", "runs.csv", STUDY, LEDGER}
    assert json.loads((out / "comparison.json").read_text()) == json.loads(comparison.to_json())
    with open_ledger(out / LEDGER, is_read_only=True) as ledger:
        assert {(r["estimator"], r["seed"]) for r in ledger.records()} == {
            (r["estimator"], r["seed"]) for r in comparison.runs
        }
    with open(out / "comparison.csv", newline="") as file:
        assert [row[0] for row in csv.reader(file)] == ["estimator", "none", "true", "target"]


@pytest.mark.full
@real
def test_runs_that_diverge_are_rows_with_their_time(pendulum):
    comparison = compare(pendulum(EARLY_CHANGE | {"limits.divergence": "0.01"}), ["none"], 2, jobs=2)
    assert comparison.estimators == ("none", "true")
    none, true = comparison.rows()
    assert [d["seed"] for d in none["diverged"]] == [0, 1]
    assert all(0.1 < d["t"] < 0.5 for d in none["diverged"])
    assert (none["mse"]["plant.phi"]["n"], true["diverged"]) == (2, [])
    assert next(at["errors"]["m [kg]"]["n"] for at in none["parameter_errors"]) == 2


@real
def test_a_full_folder_is_refused_before_a_run(pendulum, tmp_path):
    (tmp_path / "precious").write_text("mine")
    before = {p: p.read_text() for p in tmp_path.iterdir() if p.is_file()}
    with pytest.raises(FolderError, match="is not empty"):
        compare(pendulum(), [], 1, 1, tmp_path, progress=lambda *_: pytest.fail("ran"))
    assert {p: p.read_text() for p in tmp_path.iterdir() if p.is_file()} == before


@real
def test_what_is_refused_in_a_process_is_one_line_here_and_leaves_nothing(pendulum, tmp_path):
    out = tmp_path / "out"
    with pytest.raises(StudyError, match=r"seed 0: .*no output of controller") as caught:
        compare(pendulum({'connections."plant.u"': "controller.v"}), [], 1, 2, out, keep=True)
    assert len(str(caught.value).splitlines()) == 1
    assert is_refusal(caught.value)
    assert list(out.iterdir()) == []


@pytest.mark.full
@real
def test_a_disk_that_is_full_ends_a_comparison_which_can_go_on(pendulum, tmp_path, children):
    others = children()

    def _at_first_end(*_):
        (process,) = children() - others
        resource.prlimit(process, resource.RLIMIT_FSIZE, (1000, 1000))

    told = r"seed 0: .*File too large.* 1 of 2 runs have ended; retune resume"
    with pytest.raises(StudyError, match=told) as caught:
        compare(pendulum(), [], 1, 1, tmp_path / "out", keep=True, progress=_at_first_end)
    assert isinstance(caught.value, UnfinishedError)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {STUDY, LEDGER, "none-0"}


@pytest.mark.full
@real
def test_a_run_whose_process_was_killed_is_made_again(pendulum, children):
    others, seen = children(), []

    def at_end(record, n_ended, n_runs):
        seen.append((record["estimator"], n_ended, n_runs))
        for process in children() - others if n_ended == 1 else ():
            os.kill(process, signal.SIGKILL)

    comparison = compare(pendulum({"scenario.stop_time": "0.2"}), [], 1, 1, progress=at_end)
    assert seen == [("none", 1, 2), ("true", 2, 2)]
    assert [r["status"] for r in comparison.runs] == ["done", "done"]


@pytest.mark.full
@real
def test_a_comparison_of_which_a_run_was_lost_is_resumed_to_its_end(pendulum, tmp_path, capsys):
    out = tmp_path / "out"
    study = comparison_study(pendulum({"scenario.stop_time": "0.1"}), [], 1, keep=False)
    with new_locked_folder("pendulum", out), open_study(out, study, "compare") as ledger:
        enter(study, planned(study), ledger)
        lost = ledger.queued()[0]
        while ledger.lose(lost, ledger.lease(lost), "killed") == "queued":
            pass
        assert ledger.counts() | {"queued": 1, "lost": 1} == ledger.counts()
    assert main(["resume", str(out), "--jobs", "1"]) == 0
    assert "true" in capsys.readouterr().out
    assert n_done(out) == 2


@real
def test_an_unknown_estimator_is_refused_before_a_folder_is_made(pendulum, tmp_path):
    with pytest.raises(ScenarioError, match="did you mean 'target'"):
        compare(pendulum(), ["targt"], 1, 1, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_text_in_place_of_a_list_of_estimators_is_refused():
    with pytest.raises(TypeError, match=r"^estimators must be a list of names, got 'none'\.$"):
        compare("pendulum", "none", seeds=1)


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"seeds": 0}, "seeds must be"), ({"seeds": [1, 1]}, "seeds must be"), ({"seeds": [-1]}, "seeds must be"),
        ({"seeds": [0.5]}, "seeds must be"), ({"seeds": [2**63]}, "seeds must be"),
        ({"jobs": 0}, "jobs must be"), ({"keep": True}, "keep needs a folder"),
    ],
    ids=["no seed", "a seed twice", "a negative seed", "half a seed", "65 bits", "no job", "keep nowhere"],
)  # fmt: skip
@real
def test_what_makes_no_sense_is_refused(pendulum, settings, rule):
    with pytest.raises(ValueError, match=rule):
        compare(pendulum(), [], **settings)


@pytest.mark.full
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "killed"])
@real
def test_an_interrupted_comparison_keeps_what_is_done_and_leaves_no_process(
    tmp_path, leaves_nothing, becomes_true, number
):
    out = tmp_path / "out"
    temporary = str(leaves_nothing)
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS, str(out)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert becomes_true(lambda: (out / LEDGER).exists() and n_done(out) > 0)
        assert becomes_true(lambda: len(others_with(temporary, process.pid)) > 2)  # two that run, and FMUs
    finally:
        os.kill(process.pid, number)
        _, err = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else -number), err
    left = {p.name for p in out.iterdir()} - {f"{LEDGER}-wal", f"{LEDGER}-shm"}  # of a process that was killed
    assert left == {STUDY, LEDGER} | ({LOCK} if number == signal.SIGKILL else set())
    with open_ledger(out / LEDGER, is_read_only=True) as ledger:
        told = list(ledger.records())
    assert told
    assert all(r["status"] == "done" for r in told)
    assert becomes_true(lambda: not others_with(temporary, process.pid))


def n_done(out):
    try:
        with open_ledger(out / LEDGER, is_read_only=True) as ledger:
            return ledger.counts()["done"]
    except FolderError:  # it has only just begun
        return 0


ENDLESS = """
import sys
from pathlib import Path
from cosim.campaigns.compare import compare
from cosim.campaigns.comparison import Comparison
from cosim.scenarios.scenario import Scenario
try:
    compare(Scenario.load("pendulum", {"scenario.stop_time": "1.0"}), [], 10000, 2, Path(sys.argv[1]))
except KeyboardInterrupt:
    sys.exit(130)
"""


def others_with(temporary, process_id):
    """Ids of living processes that keep their temporary files in that folder or below, but for this and one other."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
            environment = (folder / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if any(entry.startswith(f"TMPDIR={temporary}".encode()) for entry in environment) and state != "Z":
            found.add(int(folder.name))
    return found - {os.getpid(), process_id}
