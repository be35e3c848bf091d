"""The offline fit on residuals of known answer."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import curve_fit

from estimator import Parameter, ParameterSpace
from estimator.offline.evaluated import CubeResidual
from estimator.offline.fit import OFFLINE, NoFitError, fit

X = np.linspace(0.0, 4.0, 200)
SPACE = ParameterSpace((Parameter("a", 0.1, 10.0, "m", "log"), Parameter("b", 0.0, 3.0, "1/s"), Parameter("d", -1, 1)))
NOISE = 0.02


class Counted:
    """Residuals of a function of theta, as an objective of roll-outs has them."""

    def __init__(self, function):
        self._function, self.n_evaluations = function, 0

    def __call__(self, theta):
        return self.many([theta])[0]

    def many(self, thetas):
        self.n_evaluations += len(thetas)
        return [self._function(*theta) for theta in thetas]


def decay(x, a, b, d):
    return a * np.exp(-b * x) + d


def data(seed, noise=NOISE):
    return decay(X, 2.0, 0.7, 0.3) + noise * np.random.default_rng(seed).standard_normal(len(X))


@pytest.mark.parametrize("method", OFFLINE)
def test_values_and_deviations_are_those_of_scipy_curve_fit(method):
    y = data(0)
    found = fit(Counted(lambda *theta: (decay(X, *theta) - y) / NOISE), SPACE, np.array([1.0, 1.0, 0.0]), method)
    theta, covariance = curve_fit(decay, X, y, p0=[1.0, 1.0, 0.0])
    std = np.sqrt(np.diag(covariance))
    assert found.theta == pytest.approx(theta, abs=0.01 * std.min())
    assert found.std == pytest.approx(std, rel=1e-3)
    assert found.is_identifiable == (True, True, True)


def test_the_deviations_do_not_depend_on_the_noise_that_was_guessed():
    y = data(1)
    exact, wrong = (
        fit(Counted(lambda *theta, s=s: (decay(X, *theta) - y) / s), SPACE, np.array([1.0, 1.0, 0.0]))
        for s in (NOISE, 10.0 * NOISE)
    )
    assert wrong.std == pytest.approx(exact.std, rel=1e-3)
    assert wrong.misfit == pytest.approx(0.1 * exact.misfit, rel=1e-3)


def test_correlated_residuals_are_measured():
    rng = np.random.default_rng(0)
    walk = np.zeros(5000)
    for k, e in enumerate(rng.standard_normal(4999)):
        walk[k + 1] = 0.8 * walk[k] + e
    space = ParameterSpace((Parameter("d", -1.0, 1.0),))
    found = fit(Counted(lambda d: walk - d), space, np.zeros(1))
    assert found.autocorrelation == pytest.approx(0.8, abs=0.03)
    assert found.inflation == pytest.approx([3.0], abs=0.5)  # sqrt(1.8 / 0.2)


def test_a_direction_without_information_stays_at_the_nominal_value():
    y = data(2)
    found = fit(Counted(lambda a, b, d: (decay(X, 2.0, b, 0.3) - y) / NOISE), SPACE, np.array([1.5, 1.0, 0.25]))
    assert found.theta[[0, 2]] == pytest.approx([1.5, 0.25])
    assert found.is_identifiable == (False, True, False)
    assert found.std[2] == pytest.approx(2.0)  # as wide as the bounds


def test_places_that_fail_are_avoided_and_a_model_that_always_fails_is_told():
    y = data(3)

    def fails_beyond(a, b, d):
        return (decay(X, a, b, d) - y) / NOISE if b < 1.2 else np.full(len(X), np.nan)

    found = fit(Counted(fails_beyond), SPACE, np.array([1.0, 2.0, 0.0]))
    assert np.abs((found.theta - [2.0, 0.7, 0.3]) / found.std).max() < 4.0
    with pytest.raises(NoFitError):
        fit(Counted(lambda *_: np.full(len(X), np.nan)), SPACE, np.array([1.0, 1.0, 0.0]))


def test_a_valley_beside_the_first_one_is_found():
    """The phase of an oscillation has many valleys; the search begins in a wrong one."""
    t = np.linspace(0.0, 8.0, 600)
    y = np.sin(2.0 * t) + 0.05 * np.random.default_rng(0).standard_normal(len(t))
    space = ParameterSpace((Parameter("w", 0.5, 6.0),))
    found = fit(Counted(lambda w: (np.sin(w * t) - y) / 0.05), space, np.array([4.0]), n_evaluations=60)
    assert abs(found.theta[0] - 2.0) < 4.0 * found.std[0]


def test_the_places_of_differences_are_simulated_together():
    """As many at a time as there are jobs: one call, not one a place."""
    batches = []

    class Counted:
        n_evaluations = 0

        def many(self, thetas):
            batches.append(len(thetas))
            return [np.array([theta[0] - 1.0]) for theta in thetas]

    space = ParameterSpace((Parameter("a", 0.0, 2.0),))
    found = CubeResidual(Counted(), space, lambda n, cost: None).residuals([np.array([v]) for v in (0.5, 1.0, 1.5)])
    assert batches == [3]
    assert_allclose(np.concatenate(found), [-0.5, 0.0, 0.5], atol=1e-12)
