"""`retune estimate --loss`: logs with spikes, of a plant that the FMU describes and of one that it does not."""

import json

import numpy as np
import pytest
import scipy.integrate

import cosim
from cosim.cli import main

pytestmark = pytest.mark.fmu
BOUNDS = {"m": (0.5, 4.0), "c": (0.05, 5.0, "log"), "k": (5.0, 60.0, "log")}
OUTPUTS = {"x [m]": 2e-3, "v [m/s]": 2e-3}


def with_spikes(log, seed):
    """Return the log with 1 % of spikes in each output, ten to a hundred standard deviations, to one side."""
    rng, found = np.random.default_rng([seed, 1]), dict(log)
    for name, noise in OUTPUTS.items():
        y = found[name].copy()
        at = rng.choice(len(y), len(y) // 100, replace=False)
        y[at] += noise * rng.uniform(10.0, 100.0, len(at))
        found[name] = y
    return found


def with_friction(oracles, seed):
    """Return a log of the plant with dry friction of 0.15 N, which the FMU does not know."""
    log, truth = oracles.measure(seed), oracles.TRUTH
    t, force = log["time [s]"], log["force [N]"]

    def slope(s, z):
        pushed = force[min(int(s / 0.01 + 1e-9), len(force) - 1)]
        return [z[1], (pushed - truth.c * z[1] - truth.k * z[0] - 0.15 * np.tanh(z[1] / 0.01)) / truth.m]

    solved = scipy.integrate.solve_ivp(
        slope, (0.0, t[-1]), oracles.START, t_eval=t, max_step=0.01, rtol=1e-8, atol=1e-10
    )
    rng = np.random.default_rng([seed, 2])
    noisy = solved.y + 2e-3 * rng.standard_normal(solved.y.shape)
    return log | dict(zip(OUTPUTS, noisy, strict=True))


@pytest.fixture
def fitted(plant, tmp_path, oracles):
    """fitted(log, **keywords): the estimation of m, c and k."""

    def fit(log, **keywords):
        path = oracles.write_log(tmp_path / f"{len(list(tmp_path.iterdir()))}.csv", log)
        roles = {"measured": {"x": "x", "v": "v"}, "inputs": {"F": "force"}}
        return cosim.estimate(plant, path, BOUNDS, **roles, evaluations=40, holdout=0.0, **keywords)

    return fit


@pytest.mark.full
@pytest.mark.parametrize("seed", range(6))
def test_the_estimate_stays_within_its_interval_and_without_the_loss_it_does_not(fitted, oracles, seed):
    log = with_spikes(oracles.measure(seed), seed)
    truth = np.array([getattr(oracles.TRUTH, name) for name in BOUNDS])
    robust, plain = fitted(log, loss="huber"), fitted(log)
    assert np.abs((robust.fit.theta - truth) / robust.fit.std).max() < 3.0
    assert np.abs((plain.fit.theta - truth) / robust.fit.std).max() > 3.0
    assert robust.fit.misfit < 1.3
    assert plain.fit.misfit > 3.0


@pytest.mark.full
@pytest.mark.parametrize(("loss", "seed"), [("huber", 0), ("soft_l1", 1), ("cauchy", 2)])
def test_of_a_plant_with_friction_that_the_fmu_does_not_know_spikes_move_nothing(fitted, oracles, loss, seed):
    log = with_friction(oracles, seed)
    clean, robust = fitted(log, loss=loss), fitted(with_spikes(log, seed), loss=loss)
    assert clean.fit.autocorrelation > 0.3  # the friction
    assert np.abs((robust.fit.theta - clean.fit.theta) / robust.fit.std).max() < 1.0
    assert robust.fit.std == pytest.approx(clean.fit.std, rel=0.5)


def test_report_and_result_tell_the_loss_and_the_outliers(plant, tmp_path, oracles, capsys):
    log = oracles.write_log(tmp_path / "log.csv", with_spikes(oracles.measure(0), 0))
    options = ["--parameter", "m=0.5:4", "--input", "F=force", "--measured", "x=x", "--measured", "v=v"]
    start = ["--start", f"c={oracles.TRUTH.c}", "--start", f"k={oracles.TRUTH.k}"]
    robust = ["--loss", "cauchy", "--f-scale", "2.4", "--holdout", "0", "--out", str(tmp_path / "out")]
    assert main(["estimate", str(plant), str(log), *options, *start, *robust]) == 0
    printed = capsys.readouterr().out
    assert "method target, loss cauchy (f_scale 2.4), seed 0" in printed
    assert "Under the loss cauchy: 16 of 1602 measured values lie more than 5 standard deviations off" in printed
    written = json.loads((tmp_path / "out" / "estimate.json").read_text())
    assert (written["loss"], written["f_scale"], written["outliers"]) == ("cauchy", 2.4, 16)
