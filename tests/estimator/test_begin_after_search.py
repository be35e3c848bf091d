"""What the filter knows when a search has ended, of samples by hand; SciPy's least squares of all is the truth."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from estimator import Parameter, ParameterSpace, Sample
from estimator.parameter_filter import ParameterFilter
from estimator.sliding_window import ResidualWindow

SPACE = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))
BEFORE, TRUE = np.array([0.2, 0.8]), np.array([0.55, 0.45])


def rows(theta, sample):
    """Residual (2,) of a curved model: the sample has its two inputs, and what was measured."""
    u, v = sample.x
    return 100.0 * np.array([np.sin(theta[0] + u * theta[1]), theta[0] * theta[1] * v]) - np.array(sample.xdot)


def searched(truths, n_before=12, max_length=10, seed=0):
    """A window after a search that began with the first of truths, and its samples since then.

    Their noise is one standard deviation, up or down, so that no test of its size fails by chance.
    """
    rng = np.random.default_rng(seed)
    window = ResidualWindow(rows, 2, max_length)
    samples = []
    for k, truth in enumerate([BEFORE] * n_before + list(truths)):
        at = Sample(0.1 * k, tuple(rng.uniform(0.5, 2.0, 2).tolist()), (), (0.0, 0.0))
        value = rows(truth, at) + rng.choice([-1.0, 1.0], 2)
        samples.append(Sample(at.t, at.x, (), tuple(value.tolist())))
        window.append(samples[-1])
        if k == n_before:
            window.begin(BEFORE)
            window.explain(BEFORE, patient=False)
    return window, samples[n_before:]


def ended(window, found, held=BEFORE):
    known = ParameterFilter(SPACE, drift=0.005, significance=3.0)
    known.begin_after_search(found, held, window)
    return known.arrival_cost


def best_of(samples):
    fit = least_squares(lambda z: np.concatenate([rows(z, s) for s in samples]), TRUE, xtol=1e-12)
    misfit = 2.0 * fit.cost / (2 * len(samples) - 2)
    return fit.x, np.linalg.inv(fit.jac.T @ fit.jac) * max(1.0, misfit)


def valley(window):
    """A place that explains the window's newest sample, which is all that is left of it after others were tried."""
    window.explain(np.array([0.9, 0.1]), patient=False)
    return least_squares(lambda z: rows(z, window.newest), [0.9, 0.1]).x


@pytest.mark.parametrize("seed", range(5))
def test_all_samples_since_the_search_began_count_though_its_incumbent_has_forgotten_most(seed):
    window, samples = searched([TRUE] * 30, seed=seed)
    place = valley(window)
    assert window.lengths == (1, 1)
    known = ended(window, place)
    mean, covariance = best_of(samples)
    assert known.n_known == 30
    assert_allclose(known.mean, mean, atol=0.1 * np.sqrt(covariance.diagonal().min()))
    assert_allclose(known.covariance, covariance, rtol=0.05)


def test_they_count_where_the_window_has_fewer_values_than_parameters():
    _, samples = searched([TRUE] * 30)
    one = ResidualWindow(lambda theta, sample: rows(theta, sample)[:1], 1, 10)
    for k, sample in enumerate(samples):
        one.append(sample)
        if not k:
            one.begin(BEFORE)
    one._lengths = [1]
    assert one.residual(TRUE).shape == (1,)
    assert ended(one, BEFORE).n_known == 30


def test_one_value_that_a_whole_line_of_parameters_explains_begins_no_filter():
    """It would be too sure of the place on it where it starts."""
    one = ResidualWindow(lambda theta, sample: rows(theta, sample)[:1], 1, 10)
    one.append(searched([TRUE])[1][0])
    one.begin(BEFORE)
    assert ended(one, BEFORE) is None


def drifted(rate, seed):
    """What is known after a search in which the first parameter has drifted, and where it is now."""
    drift = [TRUE + rate * np.array([k, 0.0]) for k in range(60)]
    window, _ = searched(drift, max_length=15, seed=seed)
    return ended(window, drift[-1]), drift[-1][0]


@pytest.mark.parametrize("seed", range(5))
def test_parameters_that_have_drifted_since_it_began_are_not_those_of_all(seed):
    """Constant ones do not explain all; those would be off by half of the drift, 0.12."""
    known, now = drifted(0.004, seed)
    assert known.n_known < 60
    assert abs(known.mean[0] - now) < 0.1


def test_a_slow_drift_is_seen_in_the_newest_samples_where_constant_parameters_explain_all():
    known = [drifted(0.0006, seed)[0] for seed in range(10)]
    assert sum(k.n_known < 60 for k in known) >= 4


@pytest.mark.parametrize("places", [(TRUE, np.array([0.98, 0.98])), (np.array([0.98, 0.98]), TRUE)])
def test_it_begins_at_the_better_place_whichever_is_first(places):
    """With a window that constant parameters explain, and samples before it that they do not."""
    window, _ = searched([BEFORE[::-1]] * 15 + [TRUE] * 6, max_length=6)
    known = ended(window, *places)
    assert known.n_known == 6
    assert_allclose(known.mean, TRUE, atol=0.05)


def test_samples_before_it_began_count_where_they_are_of_the_same_parameters():
    window, _ = searched([BEFORE] * 30)
    assert ended(window, BEFORE).n_known == 39  # nine that were in the window then


def test_a_sample_at_which_the_model_has_no_value_leaves_the_window():
    window, samples = searched([TRUE] * 30)
    bad = samples[5]
    window._residual = lambda theta, sample: rows(theta, sample) * (np.nan if sample is bad else 1.0)
    window._rows_at = lambda thetas, at: np.array([[window._residual(z, s) for s in at] for z in thetas])
    assert 10 <= ended(window, TRUE).n_known < 30


def test_after_a_search_that_ends_where_it_began_it_knows_what_it_knew_before():
    """But for rounding: a search's parameters have been on their way to the unit cube and back."""
    window, _ = searched([BEFORE] * 30)
    known = ParameterFilter(SPACE, drift=0.005, significance=3.0)
    known.begin(BEFORE, lambda thetas: window.residuals([*thetas]))
    before = known.arrival_cost
    for knew in (before, None):
        known.arrival_cost = knew
        known.begin_search(BEFORE)
        known.begin_after_search(BEFORE * (1.0 + 1e-15), BEFORE, window)
        assert known.arrival_cost is knew
