"""The measurement of the guard: cases are what they are called, and a row says what its runs say."""

from dataclasses import replace

import pytest

from benchmarks import guard, report
from benchmarks.guard import Task
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from fmu_models.build import MODELS

POSSIBLE = [
    (name, case, objective)
    for name in guard.SCENARIOS
    for case in guard.CASES
    for objective in guard.OBJECTIVES
    if guard.is_possible(name, case, "target", objective)
]


@pytest.mark.parametrize("name", guard.SCENARIOS)
def test_every_case_is_a_scenario_of_its_own(name):
    made: dict[str, list[str]] = {}
    for case, objective in ((case, objective) for other, case, objective in POSSIBLE if other == name):
        scenario = Scenario.load(name, guard.overrides(name, case, objective))
        assert (scenario.guard.enabled, scenario.observations.enabled, scenario.diagnosis.enabled) == (True, True, True)
        made.setdefault(scenario.model_dump_json(), []).append(case)
    alike = [cases for cases in made.values() if len(cases) > 1]
    assert all(sorted(cases) == ["named", "noise-large"] for cases in alike)  # whose noise no setting makes less


@pytest.mark.parametrize("name", guard.SCENARIOS)
def test_where_nothing_changes_the_nominal_controller_is_right(name):
    scenario = Scenario.load(name, guard.overrides(name, "quiet"))
    controller = scenario.components["controller"].fmu
    starts = {v.name: v.start for v in MODELS[controller].table}
    truth = {variable.variable: value for variable, value in scenario.changes.items()}
    assert truth == {p.name: starts[p.writes.variable] for p in scenario.estimation.parameters}


def test_a_gust_begins_and_ends_at_zero_and_a_constant_force_stays():
    gust, constant = (
        Scenario.load("pendulum", guard.overrides("pendulum", case)).change_functions()["plant.F_d"]
        for case in ("gust", "constant")
    )
    assert [gust(t) for t in (0.0, 0.5, 0.65, 0.81)] == pytest.approx([0.0, 0.0, 8.0, 0.0])
    assert [constant(t) for t in (0.0, 0.49, 0.5, 2.0)] == [0.0, 0.0, 4.0, 4.0]


def test_without_the_guard_nothing_else_differs():
    guarded, bare = (
        Scenario.load("pendulum", guard.overrides("pendulum", "named", mode=mode)) for mode in ("guarded", "unguarded")
    )
    switches = {"guard", "observations", "diagnosis"}
    assert not any(getattr(bare, switch).enabled for switch in switches)
    assert guarded.model_dump(exclude=switches) == bare.model_dump(exclude=switches)


@pytest.mark.parametrize(
    ("cell", "is_possible"),
    [
        (("pendulum", "friction", "rls", "filtered"), True),
        (("quadrotor", "friction", "target", "derivatives"), False),
        (("quadrotor", "named", "target", "roll-outs"), False),
        (("pendulum", "named", "ukf", "roll-outs"), False),
        (("stiction", "named", "rls", "derivatives"), False),
    ],
)
def test_runs_that_cannot_be_are_left_out(cell, is_possible):
    assert guard.is_possible(*cell) == is_possible


def test_an_interrupted_measurement_has_every_case_about_as_often():
    cells = [
        ("pendulum", case, estimator, "derivatives") for case in ("bias", "sign") for estimator in ("target", "ukf")
    ]
    tasks = list(guard.tasks(cells, None, ["guarded"]))
    assert len(tasks) == len(set(tasks)) == 2 + 2 * (20 + 5)
    assert [task.mode for task in tasks[:3]] == ["none", "none", "guarded"]
    assert {task.seed for task in tasks[2:6]} == {0}
    assert len(list(guard.tasks(cells, 3, ["guarded", "unguarded"]))) == 2 + 4 * 3 * 2


def _run(mode="guarded", seed=0, **figures):
    usual = {"status": "done", "mse": 2.0, "largest": 1.0, "episodes": 2, "writes": 4, "undone": 0, "reverted": 0,
             "vetoed": 0, "named": True, "unexplained": 0, "rest": 0, "first": 0.1}  # fmt: skip
    task = Task("pendulum", "gust", "none" if mode == "none" else "target", "derivatives", mode, seed)
    return task._asdict() | usual | figures


def test_a_row_compares_its_runs_with_the_nominal_controller():
    lost = _run(seed=2, status="diverged", mse=1e-9)
    runs = [_run("none"), _run(), _run(seed=1, mse=3.0, named=False, first=None), lost]
    (row,) = guard.rows([*runs, _run("unguarded", mse=8.0)])
    assert (row["runs"], row["lost"], row["nominal mse"]) == (3, 1, 2.0)
    assert (row["mse ratio"], row["worst"], row["largest ratio"]) == (1.25, 1.5, 1.0)
    assert (row["named"], row["episodes"], row["writes"], row["first write"]) == (pytest.approx(2 / 3, 1e-4), 2, 4, 0.1)
    assert (row["unguarded: lost"], row["unguarded: mse ratio"]) == (0, 4.0)
    lost_too = [{**run, "status": "diverged"} for run in runs]
    assert guard.rows(lost_too)[0]["lost"] == 0
    assert guard.rows(runs[1:]) == []  # no nominal controller to compare with


@pytest.mark.parametrize(
    ("case", "figures", "missed"),
    [
        ("gust", {}, []),
        ("gust", {"mse": 2.3}, ["median mse 1.15 > 1.1 of nominal"]),
        ("named", {"mse": 2.3, "named": False, "episodes": 9}, []),
        ("constant", {"named": False}, ["named in 0% < 90 %"]),
        ("drag", {"episodes": 4}, ["4 > 3 episodes"]),
        ("named", {"largest": 1.01}, ["largest error 1.01 of nominal"]),
        ("gust", {"status": "faulted", "mse": 1e-9}, ["1 lost"]),
    ],
)
def test_a_row_misses_the_targets_of_its_case(case, figures, missed):
    (row,) = guard.rows([_run("none", case=case), _run(case=case, **figures)])
    assert guard.misses(row) == missed


def test_the_quadrotor_has_targets_of_its_own():
    runs = [_run(mode, scenario="quadrotor", case="bias") for mode in ("none", "guarded")]
    assert guard.misses(*guard.rows(runs)) == ["mse 2 > 0.15"]


@pytest.mark.fmu
def test_a_run_is_measured_once_and_its_events_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RAW", tmp_path)
    monkeypatch.setitem(guard.SCENARIOS, "pendulum", replace(guard.SCENARIOS["pendulum"], stop=0.8))
    tasks = [Task("pendulum", "named", "target", "derivatives", "guarded", 0)]
    (row,) = guard.with_missing(tasks, 1)
    assert row["status"] == "done"
    assert row["episodes"] >= 1
    assert row["writes"] >= 1
    assert 0.0 < row["first"] < 0.3
    assert guard.with_missing(tasks, 1) == [row]


@pytest.mark.fmu
def test_less_noise_than_declared_is_a_tenth_of_it(monkeypatch):
    monkeypatch.setitem(guard.SCENARIOS, "pendulum", replace(guard.SCENARIOS["pendulum"], stop=0.1))
    seen = []
    monkeypatch.setattr(guard, "run", lambda *args: seen.append(run(*args)) or seen[-1])
    for case in ("noise-large", "named"):
        guard.measure(Task("pendulum", case, "none", "derivatives", "none", 0))
    errors = [r["sampled.plant.der(phi_dot)"] - r["plant.der(phi_dot)"] for r in seen]
    assert errors[0] == pytest.approx(0.1 * errors[1], abs=1e-12)
