"""The arrival cost: a Kalman filter on the parameters, drifts that it follows, and those that it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from estimator.arrival_cost import ArrivalCost
from estimator.identifiability import information
from estimator.significance import chi2_limit

START, TRUTH = np.array([0.45, 0.6, 0.5]), np.array([0.5, 0.55, 0.52])
RATE = 0.0025


def linear(rng, truth, n_channels=4, error=0.0):
    """A sample whose residual is linear in z, with unit noise: a hundredth of the bounds is two deviations of it."""
    H = 200.0 * rng.standard_normal((n_channels, len(truth)))
    noise = rng.standard_normal(n_channels) + error
    return H, noise, lambda z: H @ (z - truth) + noise


def begun(J, z=START):
    return ArrivalCost.of_estimate(z, information(J), RATE)


def test_it_is_the_kalman_filter_on_a_linear_model():
    rng = np.random.default_rng(0)
    known = replace(begun(50.0 * np.eye(3)), walk=np.array([0.0, 1e-5, 1e-6]))
    kalman = KalmanFilter(3, 4)
    kalman.x, kalman.P, kalman.Q, kalman.R = START.copy(), np.eye(3) / 50.0**2, np.diag(known.walk), np.eye(4)
    for _ in range(9):  # before the walk is learnt
        H, noise, residual = linear(rng, TRUTH)
        known = known.updated(residual)
        kalman.predict()
        kalman.update(H @ TRUTH - noise, H=H)
        assert_allclose(known.mean, kalman.x, rtol=1e-9)
        assert_allclose(known.covariance, kalman.P, rtol=1e-6, atol=1e-15)


def test_without_a_drift_it_is_the_least_squares_of_all_samples():
    rng = np.random.default_rng(1)
    known, rows, targets = begun(10.0 * np.eye(3)), [10.0 * np.eye(3)], [10.0 * START]
    for _ in range(300):
        H, noise, residual = linear(rng, TRUTH)
        known = known.updated(residual)
        rows.append(H)
        targets.append(H @ TRUTH - noise)
    J = np.vstack(rows)
    assert not np.any(known.walk)
    assert_allclose(known.mean, np.linalg.lstsq(J, np.concatenate(targets), rcond=None)[0], rtol=1e-9)
    assert_allclose(known.covariance, np.linalg.inv(J.T @ J), rtol=1e-6, atol=1e-14)


def test_errors_are_as_large_as_it_says():
    """Normalised errors squared over 300 seeds: chi-square of 3 each, constant parameters."""
    total = 0.0
    for seed in range(300):
        rng = np.random.default_rng(seed)
        J = 50.0 * np.eye(3)
        known = begun(J, TRUTH + rng.standard_normal(3) / 50.0)
        for _ in range(40):
            known = known.updated(linear(rng, TRUTH)[2])
        total += known.distance(TRUTH)
    assert chi2_limit(0.9995, 900) < total < chi2_limit(0.0005, 900)


def followed(seed, n, moves, errors, n_channels=4):
    """Arrival cost after n samples whose truth moves(i) and unmodelled error errors(i) change; None after a jump."""
    rng = np.random.default_rng(seed)
    known = begun(300.0 * np.eye(3), TRUTH)
    for i in range(n):
        residual = linear(rng, TRUTH + moves(i), n_channels, errors(i))[2]
        r = residual(known.mean)
        is_triggered = float(r @ r) > chi2_limit(1e-6, n_channels)
        known = known.drifted(residual) if is_triggered else known.updated(residual)
        if known is None:
            return None
    return known


def nothing(i):
    return 0.0


def drift(i):
    return np.array([0.001, 0.0, 0.0]) * i


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_of_one_parameter_is_followed_and_widens_no_other(seed):
    known = followed(seed, 150, drift, nothing)
    assert abs(known.mean[0] - TRUTH[0] - 0.149) < 0.005
    assert not known.is_refuted
    assert known.walk[0] > 0.0
    still = followed(seed, 150, lambda i: np.zeros(3), nothing)
    assert_allclose(known.covariance[1:, 1:].diagonal(), still.covariance[1:, 1:].diagonal(), rtol=0.5)
    assert not still.walk.any()


@pytest.mark.parametrize("seed", range(3))
def test_the_walk_fades_when_the_drift_has_ended(seed):
    known = followed(seed, 400, lambda i: drift(min(i, 100)), nothing)
    assert known.walk.max() < 1e-4 * RATE**2
    assert np.sqrt(known.distance(TRUTH + drift(100))) < 5.0


def test_a_jump_is_no_drift():
    assert followed(0, 60, lambda i: np.array([0.2, 0.0, 0.0]) * (i > 50), nothing) is None


@pytest.mark.parametrize("seed", range(3))
def test_what_no_parameter_explains_is_no_drift(seed):
    """A slow sine in every channel, in which parameters enter by factors that change from sample to sample."""
    rng = np.random.default_rng(seed)
    known, refuted = replace(begun(300.0 * np.eye(3), TRUTH), walk=np.full(3, RATE**2)), []
    for i in range(60):
        H = rng.standard_normal((4, 3))
        known = known.updated(lambda z, H=H, i=i: H @ (z - TRUTH) + 3.0 * np.sin(0.05 * i))
        refuted.append(known.is_refuted)
    assert any(refuted)


def test_a_sample_that_depends_on_no_parameter_says_nothing():
    known = replace(begun(np.eye(3)), walk=np.full(3, 1e-4))
    assert known.updated(lambda z: np.zeros(2)) is known
    assert known.updated(lambda z: np.full(2, np.nan)) is known
    assert known.drifted(lambda z: np.full(2, np.nan)) is None
