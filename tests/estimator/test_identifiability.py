"""What the data see of the parameters, against the textbook of linear regression and by hand."""

import numpy as np
import pytest

from estimator import identifiability
from estimator.identifiability import information


def test_std_is_that_of_linear_least_squares(oracles):
    oracles.check_std_against_the_covariance_of_least_squares(identifiability)


def test_std_is_the_scatter_of_refits_of_noisy_data(oracles):
    oracles.check_std_against_refits_of_noisy_data(identifiability)


def test_what_the_data_do_not_see_is_known_to_the_bounds(oracles):
    oracles.check_std_of_what_is_not_seen_is_the_whole_cube(identifiability)


def test_covariance_with_a_prior_is_that_of_the_normal_equations(oracles):
    oracles.check_covariance_with_a_prior_is_that_of_the_normal_equations(identifiability)


def test_least_moved_is_the_mean_given_the_parameters_held(oracles):
    oracles.check_least_moved_is_the_mean_given_the_parameters_held(identifiability)


def test_least_moved_of_parameters_that_are_known_to_rounding(oracles):
    oracles.check_least_moved_of_parameters_that_are_known_to_rounding(identifiability)


def test_significant_directions_by_hand(oracles):
    oracles.check_significant_directions_by_hand(identifiability)


def test_significant_is_a_projector_that_loses_little(oracles):
    oracles.check_significant_is_a_projector_that_loses_little(identifiability)


@pytest.mark.parametrize("shape", [(1, 3), (3, 3), (20, 3)], ids=["fewer-rows", "square", "more-rows"])
def test_directions_and_singular_values_make_up_the_fisher_information(shape):
    J = np.random.default_rng(0).normal(size=shape)
    seen = information(J)
    V, s = seen.directions, seen.singular_values
    np.testing.assert_allclose(V @ V.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(V.T @ np.diag(s**2) @ V, J.T @ J, atol=1e-13)
    assert np.all(np.diff(s) <= 0.0)
    assert np.sum(s > 0.0) == min(shape)
