"""The filter between searches: when its estimate is worth a write, and what it goes back to."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import Parameter, ParameterSpace
from estimator.parameter_filter import ParameterFilter

SPACE = ParameterSpace((Parameter("m", 0.0, 10.0, "kg"), Parameter("c", 0.0, 2.0, "N.s/m")))
SIGMA = 0.05
"""Standard deviation of a sample of m [kg], and five times that of one of c."""
TRUTH = np.array([4.0, 0.5])


def measured(noise, truth=TRUTH, sees_c=True):
    """Residuals of samples of m and c themselves, with noise (n, 2) in standard deviations."""
    scale = SIGMA * np.array([1.0, 0.2])

    def residual(theta):
        rows = (theta[..., None, :] - truth) / scale + noise
        rows = rows if sees_c else rows[..., :1]
        return rows.reshape(*theta.shape[:-1], -1)

    return residual


def begun(sees_c=True, n=40):
    known = ParameterFilter(SPACE, drift=0.005, significance=3.0)
    noise = np.random.default_rng(0).standard_normal((n, 2))
    known.begin(TRUTH, measured(noise, sees_c=sees_c))
    return known, noise


def test_it_has_no_estimate_and_needs_a_search_before_it_has_begun():
    known = ParameterFilter(SPACE, drift=0.005, significance=3.0)
    assert known.estimate(TRUTH) is None
    assert not known.follow(measured(np.zeros((1, 2))), False)


def test_its_estimate_is_the_mean_of_all_samples():
    known, noise = begun()
    more = np.random.default_rng(1).standard_normal((20, 2))
    for row in more:
        assert known.follow(measured(row[None]), False)
    mean = TRUTH - SIGMA * np.array([1.0, 0.2]) * np.vstack([noise, more]).mean(axis=0)
    estimate = known.estimate(np.array([6.0, 1.5]))
    assert_allclose(estimate.theta, mean, rtol=1e-3)
    assert_allclose(estimate.std, SIGMA * np.array([1.0, 0.2]) / np.sqrt(60.0), rtol=0.2)


@pytest.mark.parametrize(("n_std", "is_worth_it"), [(0.5, False), (1.5, True)])
def test_less_than_a_standard_deviation_is_not_worth_a_write(n_std, is_worth_it):
    known, noise = begun()
    m = TRUTH[0] - SIGMA * noise[:, 0].mean() + n_std * SIGMA / np.sqrt(40.0)
    c = TRUTH[1] - 0.2 * SIGMA * noise[:, 1].mean()
    assert (known.estimate(np.array([m, c])) is not None) == is_worth_it


def test_a_write_moves_only_parameters_that_differ_by_a_standard_deviation():
    known, noise = begun()
    mean, std = (SIGMA * np.array([1.0, 0.2]) * of for of in (noise.mean(axis=0), 1.0 / np.sqrt(40.0)))
    held = TRUTH - mean + np.array([0.5, 4.0]) * std
    estimate = known.estimate(held)
    assert estimate.theta[0] == held[0]
    assert_allclose(estimate.theta[1], TRUTH[1] - mean[1], rtol=1e-3)
    assert_allclose(estimate.std, std * np.array([np.hypot(1.0, 0.5), 1.0]), rtol=0.2)


def test_what_the_samples_do_not_see_stays_where_it_is_held():
    known, _ = begun(sees_c=False)
    estimate = known.estimate(np.array([6.0, 1.1]))
    assert estimate.theta[1] == pytest.approx(1.1, abs=1e-9)
    assert estimate.theta[0] == pytest.approx(TRUTH[0], abs=0.05)
    assert estimate.is_identifiable == (True, False)


def test_after_a_failed_search_it_knows_again_what_agrees_with_the_parameters_held():
    known, _ = begun()
    before = known.arrival_cost
    known.before_search = before
    for held, expected in ((TRUTH, before), (TRUTH + np.array([1.0, 0.0]), None)):
        known.begin(TRUTH + 1.0, measured(np.zeros((9, 2)), TRUTH + 1.0))
        known.recall(held)
        assert known.arrival_cost is expected


def test_what_is_forgotten_does_not_come_back():
    known, _ = begun()
    known.before_search = known.arrival_cost
    known.forget()
    known.recall(TRUTH)
    assert known.arrival_cost is None
