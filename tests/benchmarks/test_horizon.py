"""The moving-horizon benchmarks: peers solve our problem, and do-mpc's example is the system that it describes."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from benchmarks import oscillating_masses as example
from benchmarks.horizon import STREAMS, main, measured, stepper
from benchmarks.horizon_peers import PEERS
from cosim import Scenario, run
from estimator import Sample
from fmu_models import pendulum, quadrotor

RNG = np.random.default_rng


def needs(name):
    pytest.importorskip({"do-mpc": "do_mpc", "casadi-ipopt": "casadi"}[name])


@pytest.mark.parametrize("name", STREAMS)
def test_the_symbols_are_the_models_own(name):
    needs("casadi-ipopt")
    import casadi

    _, symbols, n_states, n_inputs = STREAMS[name]
    model, channels, theta = {
        "pendulum": (pendulum.derivative, [1], [2.1, 0.6]),
        "quadrotor": (quadrotor.derivative, [3, 4, 5, 15, 16, 17], [1.7, 2.0, 3.0, 4.0]),
    }[name]
    rng = RNG(0)
    x, u = rng.normal(size=n_states), rng.normal(size=n_inputs)
    X, U, T = (casadi.SX.sym("v", n) for n in (n_states, n_inputs, len(theta)))
    pieces = [[V[i] for i in range(V.shape[0])] for V in (X, U, T)]
    function = casadi.Function("f", [X, U, T], [casadi.vertcat(*symbols(*pieces))])
    expected = model(tuple(x), tuple(u), *theta)
    assert_allclose(np.array(function(x, u, theta))[:, 0], [expected[i] for i in channels], rtol=1e-12)


@pytest.fixture(scope="module")
def recorded():
    spread = {"estimation.mhe.spread": "0.3"}
    return run(Scenario.load("pendulum", {"scenario.isolation": "none", "scenario.stop_time": "0.5"} | spread), "none")


@pytest.mark.fmu
@pytest.mark.full
@pytest.mark.parametrize("name", PEERS)
def test_peers_solve_the_problem_of_our_own_horizon(recorded, name):
    """The one in CasADi has our arrival cost, and gives our estimates; do-mpc's are near, once it has forgotten."""
    needs(name)
    rng, truth = RNG(1), (2.6, 0.9)
    steps = [stepper(recorded, one, "pendulum", 0.3, 0) for one in ("mhe", name)]
    for k in range(40):
        x, u = (1.2 * np.sin(0.4 * k), 1.6 * np.cos(0.4 * k)), (6.0 * np.cos(0.9 * k + 0.5),)
        y = pendulum.derivative(x, u, *truth)[1] + 1e-3 * rng.standard_normal()
        ours, theirs = (step(Sample(0.01 * k, x, u, (y,))) for step in steps)
        if k > 10:
            assert_allclose(theirs, ours, rtol=1e-4 if name == "casadi-ipopt" else 0.02)
    assert_allclose(ours, truth, rtol=0.01)


@pytest.mark.fmu
@pytest.mark.full
def test_a_row_has_errors_and_times_and_absent_peers_are_named(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("benchmarks.report.RESULTS", tmp_path)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("benchmarks.horizon.OURS", ("mhe",))
    monkeypatch.setattr("benchmarks.horizon.STREAMS", {"pendulum": STREAMS["pendulum"]})
    monkeypatch.setattr("sys.argv", ["horizon", "--seeds", "1", "--samples", "5", "--spreads", "0.3"])
    main()
    told = capsys.readouterr().out
    assert "do-mpc: absent, pip install '.[peers]'" in told
    assert "casadi-ipopt: absent" in told
    (row,) = measured("pendulum", ["mhe"], 0.3, 1, 5)
    assert row["median error"] > 0.0
    assert row["ms a sample"]["n"] == 5


def test_the_masses_move_as_an_integrator_says():
    inputs = np.array([[0.3, -0.2], [0.1, 0.4], [-0.5, 0.2]])
    x, inertia = example.START.copy(), 1.4e-4
    angles = example.rolled_out(inertia, x, list(inputs))
    c, d = np.array([2.697, 2.66, 3.05, 2.86]) * 1e-3, np.array([6.78, 8.01, 8.82]) * 1e-5
    for k, u in enumerate(inputs):

        def slope(_, x, u=u):
            (a, b, e), v, (m, n) = x[:3], x[3:6], x[6:]
            return [
                *v,
                (-c[0] * (a - m) - c[1] * (a - b) - d[0] * v[0]) / inertia,
                (-c[1] * (b - a) - c[2] * (b - e) - d[1] * v[1]) / 2.25e-4,
                (-c[2] * (e - b) - c[3] * (e - n) - d[2] * v[2]) / 2.25e-4,
                *((u - x[6:]) / 1e-2),
            ]

        x = solve_ivp(slope, (0.0, 0.1), x, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        assert_allclose(angles[k], x[:3], rtol=1e-8)


@pytest.mark.full
@pytest.mark.parametrize("name", ["target", "ukf", "enkf", "least-squares"])
def test_our_estimators_find_the_inertia(name):
    assert example.of_ours(name, *example.log_of(0)) == pytest.approx(2.25e-4, rel=0.02)


@pytest.mark.full
@pytest.mark.parametrize("function", [example.of_casadi, example.of_do_mpc])
def test_the_peers_estimates_of_the_inertia_are_within_its_bounds(function):
    needs("do-mpc")
    inertia = function(*(rows[:15] for rows in example.log_of(0)[:2]), example.log_of(0)[2])
    assert 1e-5 <= inertia <= 1e-3
