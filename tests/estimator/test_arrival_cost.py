"""The arrival cost: a Kalman filter on the parameters, drifts that it follows, and those that it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from estimator.arrival_cost import ArrivalCost
from estimator.differences import OfMany
from estimator.identifiability import information
from estimator.significance import FALSE_ALARM, chi2_limit
from estimator.whiteness import Whiteness

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


def test_a_window_is_its_least_squares_with_a_wide_prior_about_the_estimate():
    """On a curved model, by SciPy; a direction that the window does not see stays where the estimate is."""
    rng, z = np.random.default_rng(2), np.array([0.42, 0.63, 0.5])
    A = 40.0 * rng.standard_normal((30, 3)) * [1.0, 1.0, 0.0]
    e = rng.standard_normal(30)
    residual = lambda place: A @ np.sin(place) - A @ np.sin(TRUTH) + e  # noqa: E731
    best = least_squares(lambda place: np.append(residual(place), (place - z) / 0.5), z, xtol=1e-14)
    known = ArrivalCost.of_window(z, residual, RATE)
    std = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
    assert np.all(np.abs(known.mean - best.x) < 0.05 * std)
    seen = known.covariance[:2, :2] / max(1.0, np.sum(residual(best.x) ** 2) / 27.0)
    assert_allclose(np.sqrt(seen.diagonal()), std[:2], rtol=1e-3)
    assert_allclose((known.mean[2], np.sqrt(known.covariance[2, 2])), (0.5, 0.5), rtol=1e-6)


def test_a_window_that_is_not_explained_is_believed_less():
    """Residuals of twice the declared noise: the variance is estimated from them, as in linear regression."""
    rng = np.random.default_rng(3)
    A, e = 40.0 * rng.standard_normal((400, 3)), 2.0 * rng.standard_normal(400)
    known = ArrivalCost.of_window(TRUTH, lambda z: A @ (z - TRUTH) + e, RATE)
    _, squares, _, _ = np.linalg.lstsq(A, e, rcond=None)
    assert_allclose(known.covariance, np.linalg.inv(A.T @ A) * squares / 397.0, rtol=1e-2, atol=1e-8)


def test_a_window_without_values_leaves_the_estimate_with_the_widest_spread():
    known = ArrivalCost.of_window(TRUTH, lambda z: np.full(4, np.nan), RATE)
    assert_allclose(known.mean, TRUTH)
    assert_allclose(known.covariance, np.eye(3) / 4.0)


def older(seed, truth, n_window=10, n_older=60):
    """Samples (n, 2, 3), (n, 2) of what truth(k) was k samples ago: slopes and noise; and the window's arrival cost."""
    rng = np.random.default_rng(seed)
    H, e = 60.0 * rng.standard_normal((n_window + n_older, 2, 3)), rng.standard_normal((n_window + n_older, 2))
    moved = np.array([truth(k) - TRUTH for k in range(n_window + n_older, 0, -1)])
    e -= np.einsum("ncd,nd->nc", H, moved)
    window = H[n_older:].reshape(-1, 3), e[n_older:].reshape(-1)
    known = ArrivalCost.of_window(TRUTH, lambda z: window[0] @ (z - TRUTH) + window[1], RATE)
    rows = OfMany(lambda z: np.einsum("ncd,...d->...nc", H[:n_older], z - TRUTH) + e[:n_older])
    return H, e, known, known.reaching_back(rows)


def fitted(H, e, known):
    """Least squares of samples in closed form, with what was known before as a prior: mean and covariance."""
    precision = np.linalg.inv(known.covariance)
    J, r = H.reshape(-1, 3), e.reshape(-1)
    covariance = np.linalg.inv(J.T @ J + precision)
    return covariance @ (precision @ known.mean + J.T @ (J @ TRUTH - r)), covariance


def test_older_samples_of_the_same_parameters_give_their_least_squares():
    H, e, known, longer = older(0, lambda k: TRUTH)
    mean, covariance = fitted(H[:60], e[:60], known)
    assert_allclose(longer.mean, mean, rtol=1e-6)
    assert_allclose(longer.covariance, covariance, rtol=1e-5, atol=1e-12)


def test_older_samples_from_before_a_jump_are_left_out():
    H, e, known, longer = older(1, lambda k: TRUTH + np.array([0.4, 0.3, 0.0]) * (k > 33))
    mean, covariance = fitted(H[60 - 23 : 60], e[60 - 23 : 60], known)
    assert_allclose(longer.mean, mean, rtol=1e-6)
    assert_allclose(longer.covariance, covariance, rtol=1e-5, atol=1e-12)


def test_older_samples_of_parameters_that_have_drifted_are_left_out():
    """Each of them is explained; all of them together move the estimate by many of its standard deviations."""
    off = []
    for seed in range(40):
        longer = older(seed, lambda k: TRUTH - np.array([0.0004 * k, 0.0, 0.0]))[3]
        off.append((longer.mean - TRUTH) / np.sqrt(longer.covariance.diagonal()))
    assert np.sqrt(np.mean(np.square(off))) < 2.0


def curved(seed, n=60, off=0.0):
    """Function of places that returns residuals (..., n, 2) of a model that is curved in them."""
    rng = np.random.default_rng(seed)
    A, e = 6.0 * rng.standard_normal((n, 2, 3)), rng.standard_normal((n, 2))
    e[n // 2] += off
    model = lambda z: np.exp(np.einsum("ncd,...d->...nc", A, z - TRUTH) / 3.0) * 8.0  # noqa: E731
    return OfMany(lambda z: model(z) - model(TRUTH) + e)


def one_by_one(rows, n, z):
    """What a filter knows of the first n samples, with a deviation of 0.1 about z before them."""
    known = begun(10.0 * np.eye(3), z)
    for k in range(n):
        known = known.updated(OfMany(lambda z, k=k: rows(z)[..., k, :]))
    return known


def test_samples_linearised_anew_are_closer_to_their_least_squares():
    """SciPy's, of the curved model: a filter has linearised the first ones far from it."""
    before, after = [], []
    for seed in range(20):
        rows = curved(seed)
        known = one_by_one(rows, 60, TRUTH + 0.1)
        best = least_squares(lambda z, rows=rows: rows(z).ravel(), TRUTH, xtol=1e-12)
        std = np.sqrt(np.diag(np.linalg.inv(best.jac.T @ best.jac)))
        anew = known.relinearised(rows)
        before.append((known.mean - best.x) / std)
        after.append((anew.mean - best.x) / std)
        assert_allclose(np.sqrt(anew.covariance.diagonal()), std, rtol=0.1)
    assert np.sqrt(np.mean(np.square(before))) > 0.3
    assert np.sqrt(np.mean(np.square(after))) < 0.03


def test_samples_that_the_parameters_do_not_explain_are_not_linearised_anew():
    known = one_by_one(curved(0), 60, TRUTH)
    assert known.relinearised(curved(0, off=20.0)) is known
    assert known.relinearised(OfMany(lambda z: np.full((*z.shape[:-1], 60, 2), np.nan))) is known


def test_samples_are_not_linearised_anew_where_that_leads_away_from_them():
    """As where the model's mode depends on the parameters: its slope says nothing of the other mode."""
    rows = curved(0)
    known = one_by_one(rows, 60, TRUTH)
    other = OfMany(lambda z: rows(z) + 5.0 * (np.abs(z - known.mean).max(axis=-1) > 2e-4)[..., None, None])
    assert known.relinearised(other) is known


def test_samples_without_noise_are_linearised_anew_though_their_residual_grows_by_a_rounding():
    """Else roundings would decide what is known of the parameters, and so when they are written."""
    A = np.random.default_rng(0).standard_normal((60, 2, 3))
    known = begun(10.0 * np.eye(3), TRUTH + 1e-14)
    rounding = lambda z: 1e-12 * (z != known.mean).any(axis=-1)[..., None, None]  # noqa: E731
    exact = OfMany(lambda z: np.einsum("ncd,...d->...nc", A, z - TRUTH) + rounding(z))
    anew = known.relinearised(exact)
    assert anew is not known
    assert_allclose(anew.covariance, np.linalg.inv(np.einsum("ncd,nce->de", A, A) + 4.0 * np.eye(3)), rtol=1e-6)


def test_it_is_time_to_linearise_anew_after_each_doubling_while_nothing_drifts():
    known, due = begun(10.0 * np.eye(3)), []
    rng = np.random.default_rng(4)
    for n in range(1, 170):
        known = known.updated(linear(rng, TRUTH)[2])
        assert known.n_known == n
        due += [n] if known.is_to_be_relinearised else []
    assert due == [20, 40, 80]
    drifting = replace(known, n_known=20, walk=np.array([0.0, 1e-6, 0.0]))
    assert not drifting.is_to_be_relinearised


def test_a_sample_that_no_parameter_changes_is_no_contradiction_where_it_is_explained():
    """As of a mass that sticks: it says nothing of the parameters, for or against."""
    known = begun(10.0 * np.eye(3))
    still = known.drifted(lambda z: np.array([0.5, -1.0]))
    assert still is not None
    assert_allclose(still.mean, known.mean)
    assert_allclose(still.covariance, known.covariance)
    assert known.drifted(lambda z: np.array([0.5, -30.0])) is None
    assert known.drifted(lambda z: np.array([0.5, np.nan])) is None


def test_older_samples_where_the_model_has_no_value_are_left_out():
    known = older(2, lambda k: TRUTH)[2]
    for shape, value in (((5, 2), np.nan), ((0, 2), 0.0)):
        longer = known.reaching_back(OfMany(lambda z, of=shape, value=value: np.full((*z.shape[:-1], *of), value)))
        assert_allclose(longer.mean, known.mean)
        assert_allclose(longer.covariance, known.covariance)


@pytest.mark.parametrize("seed", range(3))
def test_parameters_that_are_constant_since_a_jump_have_what_all_samples_since_then_say(seed):
    rng, J = np.random.default_rng(seed), 200.0 * np.eye(3)
    begin = begun(J)
    known = replace(begin, walk=np.full(3, RATE**2), constant=begin.belief)
    rows, targets = [J], [J @ START]
    for _ in range(40):
        H, noise, residual = linear(rng, START)
        known = known.updated(residual)
        rows.append(H)
        targets.append(H @ START - noise)
    A = np.vstack(rows)
    assert_allclose(known.mean, np.linalg.lstsq(A, np.concatenate(targets), rcond=None)[0], rtol=1e-6)
    assert_allclose(known.covariance, np.linalg.inv(A.T @ A), rtol=1e-5, atol=1e-14)


@pytest.mark.parametrize("seed", range(3))
def test_parameters_that_drift_since_a_jump_are_not_taken_for_constant(seed):
    rng = np.random.default_rng(seed)
    begin = begun(200.0 * np.eye(3), TRUTH)
    known = replace(begin, walk=np.full(3, RATE**2), constant=begin.belief)
    for i in range(10):
        known = known.updated(linear(rng, TRUTH + 3.0 * drift(i))[2])
    assert abs(known.mean[0] - TRUTH[0] - 0.027) < 0.01
    assert known.walk[0] > 0.0


@pytest.mark.parametrize("n_channels", [1, 3, 6])
def test_white_innovations_are_not_refuted_however_large_those_of_the_beginning(n_channels):
    """A filter that catches up with a drift has three large ones, all in one direction."""
    n_refuted = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        innovations = rng.standard_normal((60, n_channels))
        innovations[:3] = [[8.0], [6.0], [4.0]]
        whiteness = Whiteness(np.empty(0))
        refuted = [(whiteness := whiteness.updated(innovation)).is_refuted for innovation in innovations]
        n_refuted += any(refuted)
    assert n_refuted <= 4


def test_innovations_that_go_on_in_one_direction_are_refuted():
    whiteness, rng = Whiteness(np.empty(0)), np.random.default_rng(0)
    for k in range(40):
        whiteness = whiteness.updated(np.array([3.0, -2.0]) * np.cos(0.02 * k) + rng.standard_normal(2))
    assert whiteness.is_refuted


@pytest.mark.parametrize(("size", "is_refuted"), [(0.3, False), (3.0, True)])
def test_innovations_smaller_than_the_declared_noise_are_not_refuted_though_they_are_correlated(size, is_refuted):
    """As where the noise is declared ten times too large, and a filter follows a drift late."""
    whiteness, rng = Whiteness(np.empty(0)), np.random.default_rng(1)
    for _ in range(40):
        whiteness = whiteness.updated(size * np.array([0.8, -0.6]) + 0.1 * rng.standard_normal(2))
    assert whiteness.is_refuted == is_refuted


@pytest.mark.full
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
    for value in (0.0, np.nan):
        same = known.updated(lambda z, value=value: np.full(2, value))
        assert same.n_known == 1
        assert same.mean is known.mean
        assert same.covariance is known.covariance
    assert known.drifted(lambda z: np.full(2, np.nan)) is None


def test_it_expects_a_sample_within_its_own_uncertainty_and_the_noise():
    """The normalised innovation squared, by hand: a slope of 30 and a deviation of 0.1 make 3 beside the noise's 1."""
    known, limit = begun(10.0 * np.eye(3)), chi2_limit(FALSE_ALARM, 1) ** 0.5
    for share, is_expected in ((0.99, True), (1.01, False)):
        value = share * limit * 10.0**0.5
        assert known.expects(lambda z, v=value: v + 30.0 * (z[:1] - START[:1])) is is_expected
    assert known.expects(lambda z: np.array([0.99 * limit]))
    assert not known.expects(lambda z: np.array([1.01 * limit]))
    assert not known.expects(lambda z: np.array([np.nan]))
    assert not replace(known, walk=np.array([0.0, 1e-6, 0.0])).expects(lambda z: np.zeros(1))


def test_a_sample_that_no_parameter_changes_is_as_likely_as_its_residual_says():
    """Not as the sample before it was; one without a value says nothing."""
    rng = np.random.default_rng(0)
    known = begun(10.0 * np.eye(3)).updated(linear(rng, TRUTH)[2])
    assert known.deviance > 0.0
    alike = known.updated(lambda z: np.array([0.5, -1.0]))
    assert alike.deviance == alike.innovation_squared == alike.cost == pytest.approx(1.25)
    assert known.updated(lambda z: np.full(2, np.nan)).deviance == 0.0


def test_at_a_bound_that_holds_the_estimate_back_nothing_drifts():
    """The truth is 3 % outside, so that each sample would move the estimate out by as much again."""
    rng = np.random.default_rng(0)
    known = ArrivalCost.of_estimate(np.array([1.0]), information(np.array([[150.0]])), RATE)
    for _ in range(400):
        e = rng.standard_normal(1)
        known = known.updated(OfMany(lambda z, e=e: 50.0 * (z - 1.03) + e))
    assert known.mean == pytest.approx(1.0, abs=0.01)
    assert np.sqrt(known.walk[0]) <= RATE
    assert not known.is_refuted


@pytest.mark.parametrize("size", [1e-5, 1e-8, 0.0])
def test_older_samples_that_say_next_to_nothing_contradict_nothing(size):
    """A covariance that they leave as it is differs by roundings only."""
    reached = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        directions, _ = np.linalg.qr(rng.standard_normal((3, 3)))
        known = begun(np.diag([300.0, 100.0, 3.0]) @ directions, TRUTH)
        H, e = size * rng.standard_normal((10, 2, 3)), rng.standard_normal((10, 2))
        at = OfMany(lambda z, H=H, e=e: np.einsum("ncd,...d->...nc", H, z - TRUTH) + e)
        reached.append(known.reaching_back(at).n_known)
    assert sum(n == 10 for n in reached) >= 15  # one in five blocks seems to be of others


@pytest.mark.parametrize("size", [1e6, 1e9, 1e12, 1e100])
@pytest.mark.parametrize("n_channels", [1, 3])
def test_samples_whose_noise_is_declared_tiny_are_followed(n_channels, size):
    """A slope so large that its product with the covariance's roundings is more than one."""
    rng, known = np.random.default_rng(0), begun(10.0 * np.eye(3))
    for _ in range(60):
        H = size * rng.standard_normal((n_channels, 3))
        known = known.updated(lambda z, H=H: H @ (z - TRUTH))
        assert np.isfinite(known.covariance).all()
        assert known.drifted(lambda z, H=H: H @ (z - TRUTH)) is not None
    assert_allclose(known.mean, TRUTH, atol=1e-4)
    assert known.covariance.diagonal().max() < 1e-6
