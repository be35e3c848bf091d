"""The benchmark on plants that no scenario has: each plant, its controller, and the comparison of runs."""

import json
from itertools import product
from math import isnan
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks import foreign
from benchmarks.foreign_cases import CASES, OBJECTIVES, tables
from benchmarks.foreign_fmus import PLANTS, plant_named

EVERY = pytest.mark.parametrize("plant", [plant_named(name) for name in PLANTS], ids=PLANTS)


@EVERY
def test_the_controller_follows_the_reference_where_its_parameters_are_right(plant):
    """In continuous time, by DOP853: to half a percent of its range, and worse with the changed ones."""
    x, _, right = plant.start()
    end = min(plant.n_steps, 300) * plant.step
    places = {s.name: i for i, s in enumerate(plant.states)}
    of = {s.name: i for i, s in enumerate(plant.references)}

    def error(plants_own):
        def f(t, x):
            return plant.derivative(tuple(x), plant.control(tuple(x), plant.reference(t), *right), *plants_own)

        times = np.linspace(0.0, end, 200)
        found = solve_ivp(f, (0.0, end), x, method="DOP853", rtol=1e-9, atol=1e-10, t_eval=times)
        assert found.success
        wanted = np.array([plant.reference(t) for t in times])
        pairs = [(found.y[places[name]], wanted[:, of[ref]]) for name, ref in plant.tracked.items()]
        return max(np.abs(y - r).max() / np.ptp(r) for y, r in pairs)

    exact, wrong = error(right), error([p.changed for p in plant.parameters])
    assert exact < 5e-3
    assert wrong > 3.0 * exact


@EVERY
def test_what_is_left_out_is_a_case_and_the_others_have_scenarios(plant):
    assert set(plant.omitted) <= set(CASES)
    for case, objective in product(set(CASES) - set(plant.omitted), OBJECTIVES):
        found = tables(plant, case, 0, objective)
        assert found["scenario"]["name"] == f"{plant.name}-{case}"
        sensors = {f"plant.der({name})" if objective == "derivatives" else f"plant.{name}" for name in plant.noise}
        assert {fault["sensor"] for fault in found["sampling"]["faults"]} <= sensors


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_coloured_noise_is_of_the_sensors_that_are_compared_with(objective):
    """The noise has three times the declared size, which is, for a state, its derivative's over a step of 5 ms."""
    plant = plant_named("ball")
    found = tables(plant, "coloured", 0, objective)
    if objective == "derivatives":
        (changes,) = [np.array(found["changes"]["plant.e_v"])]
        assert changes[:, 1].std() == pytest.approx(3.0 * plant.noise["v"], rel=0.3)
    else:
        sizes = {fault["sensor"]: fault["size"] for fault in found["sampling"]["faults"]}
        assert sizes == {f"plant.{name}": pytest.approx(3.0 * 0.005 * sigma) for name, sigma in plant.noise.items()}


@pytest.mark.fmu
@pytest.mark.full
@pytest.mark.parametrize("objective", OBJECTIVES)
def test_runs_are_compared_with_the_nominal_controller_and_the_true_parameters(
    tmp_path, monkeypatch, capsys, objective
):
    out = tmp_path / "found.json"
    arguments = ["foreign", "--plants", "ball", "--cases", "none", "change", "--jobs", "1", "--out", str(out)]
    arguments += ["--objective", objective]
    monkeypatch.setattr("sys.argv", arguments)
    foreign.main()
    none, change = json.loads(out.read_text())["rows"]
    assert (none["ratio"], none["episodes"], none["lost"]) == (1.0, 0.0, 0)
    assert none["floor ratio"] is None or isnan(none["floor ratio"])
    assert 0.0 < change["floor ratio"] < change["ratio"] < 0.01
    assert change["parameter error"] < 0.01
    assert "2 runs" in capsys.readouterr().out


def test_a_run_that_fails_at_the_start_is_a_row_with_its_reason(tmp_path, monkeypatch):
    empty = {"m": np.empty(0)}
    run = SimpleNamespace(status="faulted", error="plant: refused", mse=(0.0,), true_parameters=empty, estimates=empty)
    monkeypatch.setattr(foreign.cosim, "run", lambda *_: run)
    row = foreign.measured(foreign.Task("ball", "none", 0, "target", "filtered", tmp_path, is_kept=False))
    assert (row["status"], row["error"]) == ("faulted", "plant: refused")
    assert isnan(row["parameter error"])


@pytest.mark.fmu
def test_a_run_that_raises_is_told_and_is_an_error(monkeypatch, capsys):
    monkeypatch.setattr(
        "sys.argv", ["foreign", "--plants", "ball", "--cases", "none", "--jobs", "1", "--estimator", "x:Y"]
    )
    assert foreign.main() == 1
    assert "ball none seed 0 x:Y: Traceback" in capsys.readouterr().out
