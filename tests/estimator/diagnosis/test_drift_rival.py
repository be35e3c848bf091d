"""A walking disturbance against drifting parameters: likelihoods, and which of the two is refuted."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from estimator.arrival_cost import ArrivalCost
from estimator.diagnosis import drift_rival
from estimator.diagnosis.drift_rival import DriftRival, walk_deviances
from estimator.identifiability import information

SLOPE = np.array([[4.0, 0.0], [0.0, 3.0], [2.0, -2.0]])  # of the residual at two parameters in the unit cube


def known_of(deviance=0.0):
    known = ArrivalCost.of_estimate(np.array([0.5, 0.5]), information(SLOPE), 0.005)
    return known if not deviance else known.__class__(**{**vars(known), "deviance": deviance})


def deviances(rows, walks, monkeypatch):
    """-2 log likelihood of each row given those before, of which the first is taken as known."""
    monkeypatch.setattr(drift_rival, "_WALKS", np.array(walks)[:, None])
    monkeypatch.setattr(drift_rival, "_MOST", np.inf)
    rival, before, found = DriftRival.of_rows(rows[:1], 0), 0.0, []
    for row in rows[1:]:
        rival = rival.updated(row, known_of(1e6))
        found.append(1e6 - (rival.lead - before))
        before = rival.lead
    return np.array(found)


def covariance(n, walk):
    """Covariance (n, n) of samples of a disturbance of variance 100 that walks, with noise of variance 1."""
    i = np.arange(1, n + 1)
    return 100.0 + walk * np.minimum.outer(i, i) + np.eye(n)


@pytest.mark.parametrize("walk", [0.003, 0.3])
def test_the_likelihood_is_that_of_a_normal_vector(walk, monkeypatch):
    rows = np.random.default_rng(1).normal(0.0, 2.0, (12, 2))
    whole = [
        -2.0 * multivariate_normal(np.zeros(n), covariance(n, walk)).logpdf(rows[:n].T).sum()
        - 2 * n * np.log(2 * np.pi)
        for n in range(1, 13)
    ]
    assert_allclose(deviances(rows, [walk], monkeypatch), np.diff(whole), rtol=1e-7)


def test_walks_are_weighed_by_their_likelihoods_which_fade(monkeypatch):
    walks, rows = [0.03, 3.0], np.random.default_rng(2).normal(0.0, 3.0, (8, 1))
    log = np.array(
        [[multivariate_normal(np.zeros(n), covariance(n, w)).logpdf(rows[:n, 0]) for n in range(1, 9)] for w in walks]
    )
    each = np.diff(np.hstack([np.zeros((2, 1)), log]), axis=1) + 0.5 * np.log(2 * np.pi)
    weights, expected = np.zeros(2), []
    for k in range(8):
        weights = 0.95 * weights
        expected.append(-2.0 * (np.logaddexp.reduce(weights + each[:, k]) - np.logaddexp.reduce(weights)))
        weights = weights + each[:, k]
    assert_allclose(deviances(rows, walks, monkeypatch), expected[1:], rtol=1e-7)


def test_a_channel_without_a_value_says_nothing(monkeypatch):
    rows = np.random.default_rng(3).normal(0.0, 2.0, (10, 2))
    alone = deviances(rows[:, :1], [0.3], monkeypatch)
    rows[:, 1] = 0.0
    assert_allclose(deviances(rows, [0.3], monkeypatch), alone, rtol=1e-12)


def fought(truth, residual, n=200, seed=0):
    """The number of the sample at which drifting parameters are refuted, or None.

    truth: a function of k, the place (2,) and the bias (3,) of the plant; residual: of a place, the plant's and k.
    """
    rng = np.random.default_rng(seed)
    known, rival = known_of(), DriftRival.of_rows(rng.standard_normal((20, 3)), 0)
    for k in range(n):
        place, bias = truth(k, rng)
        noise = rng.standard_normal(3) + bias
        at = lambda z, place=place, noise=noise, k=k: residual(z, place, k) + noise  # noqa: E731
        known = known.drifted(at) or known.updated(at)
        rival = rival.updated(residual(np.array([0.5, 0.5]), place, k) + noise, known)
        rival, known = rival.judged(known)
        if known is None:
            return k
    return None


def of_motion(z, place, k):
    """Residual whose slope goes with the plant's motion."""
    swing = np.sin(0.3 * k + np.arange(3))[:, None]
    return 30.0 * swing * SLOPE @ (z - place)


@pytest.mark.parametrize("seed", range(5))
def test_parameters_that_drift_are_not_refuted(seed):
    assert fought(lambda k, rng: (np.array([0.5 + 0.001 * k, 0.5]), np.zeros(3)), of_motion, seed=seed) is None


@pytest.mark.parametrize("seed", range(5))
def test_coloured_noise_of_three_times_the_declared_size_refutes_them(seed):
    rng, bias = np.random.default_rng(100 + seed), np.zeros((200, 3))
    for k in range(1, 200):
        bias[k] = 0.9 * bias[k - 1] + 3.0 * np.sqrt(1.0 - 0.9**2) * rng.standard_normal(3)
    refuted = fought(lambda k, rng: (np.array([0.5, 0.5]), bias[k]), of_motion, seed=seed)
    assert refuted is not None
    assert refuted < 120


def test_one_sample_is_no_proof_however_unlikely():
    rival = DriftRival.of_rows(np.zeros((1, 3)) + 0.1, 0).updated(np.full(3, 0.1), known_of(1e9))
    assert 0.0 < rival.lead <= 2.0
    assert rival.judged(known_of())[1] is not None


def test_a_filter_that_is_too_slow_is_hastened_three_times_before_the_disturbance_refutes_it():
    rival, known, walks = DriftRival.of_rows(np.zeros((1, 3)), 0), known_of(), []
    while known is not None:
        walks.append(np.sqrt(known.walk) / known.rate)
        rival, known = replace(rival, lead=51.0).judged(known)
        assert rival.lead == (51.0 if known is None else 0.0)
    assert_allclose(walks[1:], np.array([[0.03, 0.03], [0.1, 0.1], [0.3, 0.3]]), rtol=1e-12)


def test_a_row_without_a_value_is_left_out():
    rows = np.random.default_rng(3).standard_normal((10, 2))
    rival = DriftRival.of_rows(rows, 0)
    for missing in (np.nan, 0.0):
        after = rival.updated(np.full(2, missing), known_of())
        for row in 3.0 + rows:
            after = after.updated(row, known_of(100.0))
        assert after.lead == pytest.approx(20.0)
        assert after.recent > 10.0


def test_a_walk_that_begins_is_as_likely_as_the_normal_vectors_that_are_mixed_say():
    """On each channel by itself; a missing value is left out of the vector."""
    rows = np.cumsum(np.random.default_rng(3).standard_normal((30, 2)), axis=0)
    rows[7, 1], i = 0.0, np.arange(1, 31)
    for channel, found in enumerate(walk_deviances(rows)):
        seen = rows[:, channel] != 0.0
        spreads = [w * np.minimum.outer(i, i) + np.eye(30) for w in (0.003, 0.03, 0.3, 3.0)]
        known = [multivariate_normal(cov=s[np.ix_(seen, seen)]).logpdf(rows[seen, channel]) for s in spreads]
        mixed = np.log(np.mean(np.exp(np.array(known) - max(known)))) + max(known)
        assert_allclose(found, -2.0 * mixed - seen.sum() * np.log(2.0 * np.pi), rtol=1e-9)
