"""The measurement of the guard: cases are what they are called, and a row says what its runs say."""

from functools import cache
from pathlib import Path

import pytest

from benchmarks import guard
from cosim.scenarios.scenario import Scenario
from cosim.studies.definition import read_definition
from cosim.studies.plan import Study
from fmu_models.build import MODELS

STUDIES = Path(__file__).parents[2] / "benchmarks" / "studies"


@cache
def scenarios_of(name):
    """The scenarios of a study, by scenario and case."""
    definition = read_definition(STUDIES / f"{name}.toml")
    names = definition.study.scenarios
    study = Study(definition, tuple(map(Scenario.load, names)), names)
    return {(names[k], point.values["case"]): study.scenario_at(k, point) for k, point in study.places()}


@pytest.mark.parametrize("name", guard.OBJECTIVES)
def test_every_case_is_a_scenario_of_its_own_and_guarded(name):
    made = scenarios_of(name)
    assert len({scenario.model_dump_json() for scenario in made.values()}) == len(made)
    assert {scenario for scenario, _ in made} <= set(guard.SCENARIOS)
    assert {case for _, case in made} <= guard.CASES.keys()
    for scenario in made.values():
        assert scenario.guard.enabled
        assert scenario.observations.enabled
        assert scenario.diagnosis.enabled
        assert (scenario.estimation.objective == "rollout") == (name == "guard-roll-outs")


@pytest.mark.parametrize("name", guard.SCENARIOS)
def test_where_nothing_changes_the_nominal_controller_is_right(name):
    scenario = scenarios_of("guard")[name, "quiet"]
    controller = scenario.components["controller"].fmu
    starts = {v.name: v.start for v in MODELS[controller].table}
    truth = {variable.variable: value for variable, value in scenario.changes.items()}
    assert truth == {p.name: starts[p.writes.variable] for p in scenario.estimation.parameters}


def test_a_gust_begins_and_ends_at_zero_and_a_constant_force_stays():
    made = scenarios_of("guard")
    gust, constant = (made["pendulum", case].change_functions()["plant.F_d"] for case in ("gust", "constant"))
    assert [gust(t) for t in (0.0, 0.5, 0.65, 0.81)] == pytest.approx([0.0, 0.0, 8.0, 0.0])
    assert [constant(t) for t in (0.0, 0.49, 0.5, 2.0)] == [0.0, 0.0, 4.0, 4.0]


def _run(estimator="target", seed=0, **figures):
    usual = {
        "scenario": "pendulum", "case": "gust", "estimator": estimator, "objective": "derivatives", "seed": seed,
        "status": "done", "mse": 2.0, "largest error": 1.0, "triggers": 2, "writes": 4, "disturbances": 1,
        "first write [s]": 0.6,
    }  # fmt: skip
    return usual | figures


def test_a_row_compares_its_runs_with_the_nominal_controller():
    lost = _run(seed=2, status="diverged", mse=1e-9)
    runs = [_run("none"), _run(), _run(seed=1, mse=3.0, disturbances=0, **{"first write [s]": None}), lost]
    (row,) = guard.rows(runs)
    assert (row["runs"], row["lost"], row["nominal mse"]) == (3, 1, 2.0)
    assert (row["mse ratio"], row["worst"], row["largest ratio"]) == (1.25, 1.5, 1.0)
    assert (row["episodes"], row["writes"], row["first write"]) == (2, 4, 0.6)
    assert row["named"] == pytest.approx(2 / 3, 1e-4)
    lost_too = [{**run, "status": "diverged"} for run in runs]
    assert guard.rows(lost_too)[0]["lost"] == 0
    assert guard.rows(runs[1:]) == []  # no nominal controller to compare with
    assert guard.rows([_run("none", objective="filtered"), *runs[1:]]) == []  # nor of that objective


@pytest.mark.parametrize(
    ("case", "figures", "missed"),
    [
        ("gust", {}, []),
        ("gust", {"mse": 2.3}, ["median mse 1.15 > 1.1 of nominal"]),
        ("named", {"mse": 2.3, "disturbances": 0, "triggers": 9}, []),
        ("constant", {"disturbances": 0}, ["named in 0% < 90 %"]),
        ("drag", {"triggers": 4}, ["4 > 3 episodes"]),
        ("named", {"largest error": 1.01}, ["largest error 1.01 of nominal"]),
        ("gust", {"status": "faulted", "mse": 1e-9}, ["1 lost"]),
    ],
)
def test_a_row_misses_the_targets_of_its_case(case, figures, missed):
    (row,) = guard.rows([_run("none", case=case), _run(case=case, **figures)])
    assert guard.misses(row) == missed


def test_the_quadrotor_has_targets_of_its_own():
    runs = [_run(name, scenario="quadrotor", case="bias") for name in ("none", "target")]
    assert guard.misses(*guard.rows(runs)) == ["mse 2 > 0.15"]
