"""Profile likelihoods of models whose intervals are known in closed form."""

import numpy as np
import pytest

from estimator import Parameter, ParameterSpace
from estimator.offline.fit import fit
from estimator.offline.profile_likelihood import profile

X = np.linspace(1.0, 4.0, 300)
NOISE = 0.02


class Model:
    """Residuals of a function of theta."""

    def __init__(self, function, truth, seed=0):
        self._function, self.n_evaluations = function, 0
        self._y = function(*truth) + NOISE * np.random.default_rng(seed).standard_normal(len(X))

    def __call__(self, theta):
        return self.many([theta])[0]

    def many(self, thetas):
        self.n_evaluations += len(thetas)
        return [(self._function(*theta) - self._y) / NOISE for theta in thetas]


def profiles_of(function, truth, space, nominal):
    model = Model(function, truth)
    found = fit(model, space, np.array(nominal), "least-squares")
    return found, [profile(model, space, found, j) for j in range(len(space))]


def test_of_a_linear_model_the_interval_is_that_of_the_normal_distribution():
    space = ParameterSpace((Parameter("a", -5.0, 5.0), Parameter("b", -5.0, 5.0), Parameter("c", -5.0, 5.0)))
    found, profiles = profiles_of(lambda a, b, c: a + b * X + c * np.sin(2.0 * X), (1.0, 0.5, -0.3), space, [0, 0, 0])
    half = 1.96 * found.std
    for j, p in enumerate(profiles):
        assert p.is_identifiable
        assert p.lower_set_by == p.upper_set_by == ()
        assert [p.lower, p.upper] == pytest.approx(
            [found.theta[j] - half[j], found.theta[j] + half[j]], abs=0.02 * half[j]
        )
        z = (p.values - found.theta[j]) / found.std[j]
        assert p.rise == pytest.approx(z * z, abs=0.05)


@pytest.mark.parametrize("scale", ["log", "linear"])
def test_a_free_common_factor_makes_profiles_flat(scale):
    """a b is seen: whichever a, b follows along a hyperbola, until it meets its bound."""
    space = ParameterSpace((Parameter("a", 0.5, 2.0, "1", scale), Parameter("b", 0.1, 10.0, "1", scale)))
    _, (a, b) = profiles_of(lambda a, b: np.exp(-0.5 * a * b * X), (1.0, 1.0), space, [1.3, 0.6])
    assert a.is_flat
    assert not a.is_identifiable
    assert (a.values[0], a.values[-1]) == pytest.approx((0.5, 2.0))
    assert (b.lower_set_by, b.upper_set_by) == ((0,), (0,))  # a's bounds hold it: within 1/2 and 2, and a little more
    assert not b.is_identifiable
    assert (b.lower, b.upper) == pytest.approx((0.5, 2.0), rel=0.1)


def test_what_is_only_known_to_be_large_is_open_above():
    """A rate so fast that all is over before the first sample: below it is told, above it is not; 1/s^2 is no help."""
    space = ParameterSpace((Parameter("a", 0.1, 10.0, "1", "log"), Parameter("b", 0.1, 100.0, "1/s", "log")))
    _, (a, b) = profiles_of(lambda a, b: a * (1.0 - np.exp(-b * X)), (1.0, 9.0), space, [1.2, 6.0])
    assert a.is_identifiable
    assert b.upper is None
    assert b.lower is not None
    assert not b.is_flat
    assert b.lower == pytest.approx(np.log(1.0 / (NOISE * 0.4)), rel=0.4)  # a few of the first samples tell it
