"""Minimising a surrogate's mean, against SciPy's solvers on means whose slopes are known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from estimator.bayesian.search import least_change, least_squares_of_mean


class Mean:
    """A posterior's mean as a function of z (d,), with its slope."""

    def __init__(self, mean, slope):
        self._mean, self._slope = mean, slope

    def mean_and_jacobian(self, z):
        return self._mean(z), self._slope(z)


CURVED = Mean(
    lambda z: np.array([10.0 * (z[1] - z[0] ** 2), 0.6 - z[0], 0.3 * z[1]]),
    lambda z: np.array([[-20.0 * z[0], 10.0], [-1.0, 0.0], [0.0, 0.3]]),
)


def linear(J, truth):
    return Mean(lambda z: J @ (z - truth), lambda z: J)


@pytest.mark.parametrize("start", [(0.1, 0.9), (0.9, 0.1), (0.5, 0.5)])
def test_the_minimum_is_scipys(start):
    truth = least_squares(lambda z: CURVED.mean_and_jacobian(z)[0], start, bounds=([0, 0], [1, 1]), xtol=1e-14).x
    assert_allclose(least_squares_of_mean(CURVED, np.array(start)), truth, atol=5e-3)


def test_a_mean_without_slope_moves_nothing_anywhere():
    flat = Mean(lambda z: np.ones(3), lambda z: np.zeros((3, 2)))
    z = np.array([0.3, 0.7])
    np.testing.assert_array_equal(least_squares_of_mean(flat, z), z)
    np.testing.assert_array_equal(least_change(flat, z, 2), z)


def test_the_least_change_is_least_squares_in_the_directions_best_seen():
    J = np.random.default_rng(0).standard_normal((5, 3)) * (30.0, 3.0, 0.3)
    z, truth = np.full(3, 0.5), np.array([0.52, 0.45, 0.6])
    _, _, directions = np.linalg.svd(J)
    for n_moved in (1, 2, 3):
        V = directions[:n_moved].T
        by_hand = z + V @ np.linalg.lstsq(J @ V, J @ (truth - z), rcond=None)[0]
        assert_allclose(least_change(linear(J, truth), z, n_moved), by_hand, atol=1e-10)


def test_a_direction_that_is_not_seen_is_not_moved():
    J = np.array([[2.0, 0.0], [1.0, 0.0]])
    moved = least_change(linear(J, np.array([0.4, 0.9])), np.full(2, 0.5), 2)
    assert_allclose(moved, [0.4, 0.5], atol=1e-12)
