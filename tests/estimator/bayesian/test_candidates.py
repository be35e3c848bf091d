"""Stored candidates: which stay, and those at which the model has no value."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from estimator import NoEstimateError, Parameter, ParameterSpace
from estimator.bayesian.candidates import Candidates

SPACE = ParameterSpace((Parameter("a", 0.0, 2.0, "1"), Parameter("b", 0.0, 2.0, "1")))


def told(costs):
    """Candidates on a line whose sums of squared residuals are these."""
    stored = Candidates(SPACE, n_modelled=3)
    for i, cost in enumerate(costs):
        stored.add(np.array([0.01 * i, 1.0]), np.array([np.sqrt(cost), 0.0]))
    return stored


def test_without_a_residual_there_are_no_costs():
    stored = Candidates(SPACE, n_modelled=3)
    stored.fail(np.array([1.0, 1.0]))
    assert stored.is_empty
    assert not stored.are_near
    with pytest.raises(NoEstimateError, match="no candidate has succeeded"):
        _ = stored.costs


def test_an_episode_keeps_the_first_the_best_that_differ_and_the_newest():
    stored = told([400.0, 100.0, 900.0, 4.0, 2500.0, 36.0, 1600.0, 3600.0, 4900.0])
    stored.begin_episode()
    assert_array_equal(stored.costs, [400.0, 100.0, 900.0, 4.0, 36.0, 1600.0, 3600.0, 4900.0])


def test_candidates_that_do_not_differ_count_once():
    stored = told([100.0] * 3 + [400.0, 900.0, 2500.0, 4900.0, 6400.0])
    assert_array_equal(stored.modelled, [0, 3, 4, 6, 7])


def test_new_residuals_drop_candidates_without_a_value():
    stored = told([1.0, 4.0, 9.0])
    stored.rescore(np.array([[3.0, 0.0], [np.nan, 0.0], [1.0, 0.0]]))
    assert_array_equal(stored.costs, [9.0, 1.0])
    assert stored.best == 1
    stored.rescore(np.full((2, 2), np.nan))
    assert stored.is_empty


def test_the_nearest_that_fits_may_cost_what_is_allowed():
    stored = told([100.0, 9.0, 1.0])
    assert_array_equal(stored.nearest(np.zeros(2), allowed=10.0)[0], [0.005, 0.5])
    assert stored.nearest(np.zeros(2), allowed=0.5)[1] == 1.0


def test_places_nearer_to_a_failed_candidate_are_no_hope():
    stored = told([1.0])
    pool = np.array([[0.1, 0.5], [0.9, 0.5]])
    assert_array_equal(stored.hopeful(pool, stored.place(np.array([0]))), pool)
    stored.fail(np.array([2.0, 1.0]))
    assert_array_equal(stored.hopeful(pool, stored.place(np.array([0]))), pool[:1])
    assert stored.has_failed_near(np.array([0.999, 0.5]), 0.003)
    assert not stored.is_new(np.array([0.999, 0.5]), 0.003)
    assert stored.is_new(np.array([0.5, 0.5]), 0.003)
    stored.begin_episode()
    assert not stored.has_failed_near(np.array([0.999, 0.5]), 0.003)


def test_however_many_are_told_no_more_than_128_stay():
    stored = told(np.arange(1.0, 300.0) ** 2)
    assert len(stored) <= 128
    assert stored.costs.min() == 1.0


def test_candidates_are_near_where_the_best_is_within_fifty_standard_deviations():
    assert told([60.0**2 * 2, 49.0**2 * 2]).are_near
    assert not told([60.0**2 * 2, 51.0**2 * 2]).are_near
