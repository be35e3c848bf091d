"""The end of a rest whose residuals grow far beyond all before in it."""

import numpy as np
import pytest

from estimator.diagnosis.resting import RestingResiduals


def after(*rows):
    rest = RestingResiduals()
    for row in rows:
        rest = rest.take(np.array(row, dtype=float))
    return rest


SINE = [[4.0 * np.sin(0.3 * k), 0.1 * (-1.0) ** k] for k in range(60)]


def test_the_course_of_what_the_model_lacks_is_no_growth():
    assert not any(after(*SINE[:n]).is_outgrown for n in range(1, 61))


@pytest.mark.parametrize(("size", "is_outgrown"), [(11.0, False), (13.0, True), (-13.0, True)])
def test_what_is_three_times_as_large_as_ever_ends_it_once_most_of_the_newest_are(size, is_outgrown):
    grown = [[size, 0.0]] * 5
    assert not after(*SINE, *grown[:2]).is_outgrown
    assert after(*SINE, *grown[:3]).is_outgrown == is_outgrown
    assert after(*SINE, *grown).is_outgrown == is_outgrown


def test_a_spike_is_no_growth_and_a_small_residual_no_measure():
    assert not after(*SINE, [500.0, 0.0], *SINE[:4]).is_outgrown
    assert not after(*[[0.01]] * 40, *[[2.9]] * 5).is_outgrown  # below three standard deviations it may be noise
    assert after(*[[0.01]] * 40, *[[3.1]] * 5).is_outgrown


def test_few_residuals_are_no_measure():
    assert not after(*[[1.0]] * 29, *[[50.0]] * 5).is_outgrown
    assert after(*[[1.0]] * 30, *[[50.0]] * 5).is_outgrown


def test_a_channel_that_is_not_sampled_is_none():
    assert not after(*SINE, *[[np.nan, np.nan]] * 5).is_outgrown
    assert after(*[[np.nan, 1.0]] * 40, *[[np.nan, 9.0]] * 5).growth.tolist() == [0.0, 9.0]


def test_a_value_that_is_missing_is_no_calm():
    loud, lost = [[20.0, 0.1]] * 40, [[np.nan, 0.1]] * 100
    assert after(*loud, *lost).n_calm == 0
    assert after(*loud, *lost, *[[0.1, 0.1]] * 10).n_calm == 8  # once most of the newest five are


def test_a_growth_that_takes_longer_than_the_newest_is_noticed():
    """Twice as large every 20 residuals: none is ever three times as large as those just before it."""
    growing = [[4.0 * 2.0 ** (k / 20.0), 0.0] for k in range(80)]
    first = next(n for n in range(81) if after(*SINE, *growing[:n]).is_outgrown)
    assert 30 < first < 60


def test_what_has_become_usual_in_a_long_rest_is_no_growth():
    louder = [[3.0 * x, y] for x, y in SINE]
    assert not any(after(*SINE[:30], *louder * 3, *louder[:n]).is_outgrown for n in range(1, 61))
