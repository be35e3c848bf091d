"""Leaps over a jump of the model: the step against SciPy's minimiser of Huber's loss, the search against the truth."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import Parameter, ParameterSpace, TargetVector
from estimator.bayesian import leap

SPACE = ParameterSpace(tuple(Parameter(name, 0.0, 1.0) for name in "abc"))
TRUTH, START = np.array([0.6, 0.4, 0.5]), np.array([0.35, 0.6, 0.55])
JUMP, EDGE = 300.0, 0.59
"""Residual of the first row, in standard deviations, wherever a is below the edge."""


def model(seed, edge=EDGE):
    """Residuals, their least squares beyond the edge, and its covariance."""
    rng = np.random.default_rng(seed)
    H, noise = 400.0 * rng.normal(size=(60, 3)), rng.standard_normal(60)
    H[0] = 400.0, 0.0, 0.0

    def residual(theta):
        r = H @ (theta - TRUTH) + noise
        r[0] += JUMP * (theta[0] < edge)
        return r

    beyond = noise + JUMP * (edge > 1.0) * np.eye(60)[0]
    return residual, TRUTH - np.linalg.lstsq(H, beyond, rcond=None)[0], np.linalg.inv(H.T @ H)


def searched(residual, seed, n=30):
    search = TargetVector(SPACE, START, np.random.default_rng(seed))
    for _ in range(n):
        theta = search.ask()
        search.tell(theta, residual(theta))
    return search


def test_the_step_is_hubers(oracles):
    oracles.check_step_is_the_minimum_of_hubers_loss(leap)


def test_a_leap_stays_within_the_bounds_and_tries_each_parameter_there():
    found = leap.leap(np.array([0.9, 0.5]), np.array([-40.0, 5.0]), np.diag([100.0, 1e4]))
    assert_allclose(found.place, [1.0, 0.4995], atol=1e-6)
    assert_allclose(np.array(found.about) - found.place, np.diag([-0.003, 0.001]), atol=1e-12)
    assert found.has_succeeded(found.place, np.array([20.0, 0.0]))
    assert not found.has_succeeded(found.place, np.array([40.0, 0.0]))
    assert not found.has_succeeded(found.place + 1e-3, np.array([20.0, 0.0]))


@pytest.mark.parametrize("seed", range(6))
def test_a_search_gets_over_a_jump_of_one_row(seed):
    """On this side of the edge the first row, off by 300 standard deviations, draws the least squares away from it."""
    residual, minimum, covariance = model(seed)
    estimate = searched(residual, seed).estimate()
    assert_allclose((estimate.theta - minimum) / np.sqrt(covariance.diagonal()), 0.0, atol=0.3)
    assert_allclose(estimate.std, np.sqrt(covariance.diagonal()), rtol=0.3)


@pytest.mark.parametrize("seed", range(3))
def test_a_row_that_no_parameter_puts_right_leaves_the_least_squares(seed):
    residual, minimum, covariance = model(seed, edge=2.0)
    estimate = searched(residual, seed, n=45).estimate()
    std = np.sqrt(covariance.diagonal() * estimate.cost / 57)  # of the misfit
    assert_allclose((estimate.theta - minimum) / std, 0.0, atol=0.3)
    assert np.all(np.abs(estimate.theta - TRUTH) < 1.96 * estimate.std)
