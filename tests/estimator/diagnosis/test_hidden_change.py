"""Change of a parameter that many samples show together, against what else may explain them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import Sample
from estimator.diagnosis.hidden_change import hidden_change
from estimator.differences import OfMany

N, Z = 300, np.array([0.5, 0.5])
K = np.arange(N)
X, U = np.sin(0.23 * K), np.cos(0.37 * K)
SAMPLES = [Sample(0.1 * k, (x,), (u,), (0.0, 0.0)) for k, (x, u) in enumerate(zip(X, U, strict=True))]
EFFECTS = {
    "dry friction": np.sign(X),
    "quadratic friction": np.abs(X) * X,
    "lag": np.diff(U, prepend=U[0]),
    "constant force": np.ones(N),
    "slow force": np.sin(0.01 * K),
}


def found(effect, seed, size=0.7):
    """What is found of two parameters, and least squares (2,), where the first acts on a channel as the effect does.

    The residuals are noise of one standard deviation, and the effect, of this size.
    """
    rng = np.random.default_rng(seed)
    effect = effect / np.sqrt(np.mean(effect**2))
    slope = 4.0 * np.stack([np.stack([effect, np.zeros(N)], -1), rng.standard_normal((N, 2))], -1)  # (n, c, d)
    rows = rng.standard_normal((N, 2))
    rows[:, 0] += size * effect
    known = hidden_change(OfMany(lambda z: rows + np.einsum("ncd,...d->...nc", slope, z - Z)), SAMPLES, Z, 0.003)
    return known, Z - np.linalg.lstsq(slope.reshape(-1, 2), rows.reshape(-1))[0]


@pytest.mark.parametrize("seed", range(5))
def test_a_parameter_that_nothing_else_acts_as_is_found_as_least_squares_has_it(seed):
    known, expected = found(X * U, seed, size=0.45)
    assert_allclose(known.mean, expected, atol=0.01)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_a_parameter_that_acts_as_something_else_may_is_not_found(effect, seed):
    assert found(effect, seed)[0] is None


@pytest.mark.parametrize("seed", range(5))
def test_noise_is_no_change(seed):
    assert found(X * U, seed, size=0.0)[0] is None


@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_states_that_is_in_slope_and_residual_is_no_change(seed):
    """A plant at rest where a parameter acts on the distance from there alone: the slope is that of the noise."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((N, 2))  # of the state
    rows = rng.standard_normal((N, 2)) - 0.5 * noise
    slope = 4.0 * np.stack([noise, np.zeros((N, 2))], -1)
    assert hidden_change(OfMany(lambda z: rows + np.einsum("ncd,...d->...nc", slope, z - Z)), SAMPLES, Z, 0.003) is None
