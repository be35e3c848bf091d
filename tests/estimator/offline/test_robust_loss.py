"""Robust losses: their minimum is SciPy's, and their intervals hold where a part of the samples are spikes."""

import numpy as np
import pytest
import scipy.optimize
import scipy.stats

from estimator import Parameter, ParameterSpace
from estimator.offline.fit import OFFLINE, fit
from estimator.offline.profile_likelihood import profile
from estimator.offline.robust_loss import LOSSES, Loss

X = np.linspace(0.0, 4.0, 600)
SPACE = ParameterSpace((Parameter("a", 0.1, 10.0, "m", "log"), Parameter("b", 0.0, 3.0, "1/s")))
NOMINAL, TRUTH, NOISE = np.array([1.0, 1.0]), np.array([2.0, 0.7]), 0.02
ROBUST = [name for name in LOSSES if name != "linear"]
SEEDS = range(20)


class Decay:
    """Residuals of a exp(-b x), in standard deviations of the noise."""

    def __init__(self, y, x=X, noise=NOISE):
        self._x, self._y, self._noise, self.n_evaluations = x, y, noise, 0

    def __call__(self, theta):
        return self.many([theta])[0]

    def many(self, thetas):
        self.n_evaluations += len(thetas)
        return [(a * np.exp(-b * self._x) - self._y) / self._noise for a, b in thetas]


def spiked(seed, x=X, share=0.01):
    """Return measurements with spikes, ten to a hundred standard deviations to one side, as a bad contact makes."""
    rng = np.random.default_rng(seed)
    e = rng.standard_normal(len(x))
    at = rng.choice(len(x), int(share * len(x)), replace=False)
    e[at] += rng.uniform(10.0, 100.0, len(at))
    return TRUTH[0] * np.exp(-TRUTH[1] * x) + NOISE * e


@pytest.mark.parametrize("name", LOSSES)
@pytest.mark.parametrize("method", OFFLINE)
def test_the_minimum_is_that_of_scipy(name, method):
    objective = Decay(spiked(0))
    found = fit(objective, SPACE, NOMINAL, method, loss=Loss(name, 1.3))
    theirs = scipy.optimize.least_squares(objective, found.theta, loss=name, f_scale=1.3, xtol=1e-12, ftol=1e-12)
    assert found.theta == pytest.approx(theirs.x, abs=0.02 * found.std.min())
    assert found.residual @ found.residual == pytest.approx(2.0 * theirs.cost, rel=1e-5)


@pytest.mark.parametrize("name", ROBUST)
def test_what_is_seen_to_a_hundred_thousandth_of_the_bounds_is_so_under_a_loss(name):
    """A loss bends residuals that pass through thousands of deviations, which is no noise of a solver."""
    noise = 1e-5
    y = TRUTH[0] * np.exp(-TRUTH[1] * X) + noise * np.random.default_rng(0).standard_normal(len(X))
    objective = Decay(y, noise=noise)
    found = fit(objective, SPACE, NOMINAL, "least-squares", loss=Loss(name))
    theirs = scipy.optimize.least_squares(objective, TRUTH, loss=name, x_scale=noise, xtol=1e-14, ftol=1e-14)
    assert found.solver_noise < 1e-3
    assert found.theta == pytest.approx(theirs.x, abs=0.05 * found.std.min())
    plain = fit(Decay(y, noise=noise), SPACE, NOMINAL, "least-squares")
    assert found.white_std == pytest.approx(plain.white_std, rel=0.3)


@pytest.mark.parametrize("name", ["huber", *(pytest.param(n, marks=pytest.mark.full) for n in ROBUST if n != "huber")])
def test_with_spikes_the_estimate_stays_within_its_interval_and_without_the_loss_it_does_not(name):
    """At least 33 of 40 intervals of 95 % hold, but once in 10 000 times."""
    robust = [fit(Decay(spiked(seed)), SPACE, NOMINAL, "least-squares", 9, loss=Loss(name)) for seed in SEEDS]
    plain = [fit(Decay(spiked(seed)), SPACE, NOMINAL, "least-squares", 9) for seed in SEEDS]
    least = scipy.stats.binom.ppf(1e-4, 2 * len(SEEDS), 0.95)
    assert np.sum([np.abs(f.theta - TRUTH) <= 1.96 * f.std for f in robust]) >= least
    outside = [np.abs(f.theta - TRUTH) > 1.96 * g.std for f, g in zip(plain, robust, strict=True)]
    assert np.mean(np.any(outside, axis=1)) > 0.9
    assert np.median([f.std[0] for f in plain]) > 3.0 * np.median([f.std[0] for f in robust])


@pytest.mark.full
@pytest.mark.parametrize("name", ROBUST)
def test_the_deviation_is_the_scatter_of_repeated_measurements(name):
    """With normal noise, 200 repetitions tell the deviation to 5 % (one standard deviation)."""
    x = X[::6]
    found = [
        fit(Decay(spiked(seed, x, share=0.0), x), SPACE, TRUTH, "least-squares", 3, loss=Loss(name))
        for seed in range(200)
    ]
    scatter = np.std([f.theta for f in found], axis=0)
    assert np.median([f.white_std for f in found], axis=0) == pytest.approx(scatter, rel=0.15)


@pytest.mark.parametrize("name", ROBUST)
def test_a_profile_agrees_with_the_deviation(name):
    objective = Decay(spiked(3))
    found = fit(objective, SPACE, NOMINAL, "least-squares", loss=Loss(name))
    for j in range(2):
        p = profile(objective, SPACE, found, j)
        assert [p.lower, p.upper] == pytest.approx(
            found.theta[j] + 1.96 * found.std[j] * np.array([-1.0, 1.0]), abs=0.25 * found.std[j]
        )


@pytest.mark.parametrize("arguments", [("hubert", 1.0), ("huber", 0.0), ("huber", np.nan)])
def test_a_loss_that_is_none_is_refused(arguments):
    with pytest.raises(ValueError, match=r"no loss 'hubert'|must be positive"):
        Loss(*arguments)
