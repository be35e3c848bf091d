"""Jumps to the parameters that explain the samples, against the normal equations and the ordinary Kalman filter."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import Objective, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.baselines.kalman import EnsembleKalman, EnsembleSettings, UnscentedKalman, UnscentedSettings
from estimator.baselines.moving_horizon import MovingHorizon, MovingHorizonSettings
from estimator.diagnosis.jump import followed_jump, jump_to
from estimator.differences import OfMany

LOWER, WIDTH, SIGMA = np.array([-3.0, -2.0, 0.0]), 8.0, 0.2
SPACE = ParameterSpace(tuple(Parameter(name, low, low + WIDTH) for name, low in zip("abc", LOWER, strict=True)))
TRUTH, START = np.array([1.8, 0.4, 3.5]), np.array([0.5, 0.5, 0.5])
SPREAD, WALK = 0.05, 0.003


def measured(n, c=2, seed=0, truth=TRUTH, more=0.0):
    """Rows H (n, c, 3) of a model that is linear in the parameters, and what was measured (n, c)."""
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(n, c, 3))
    return H, H @ truth + SIGMA * rng.standard_normal((n, c)) + more


def rows_at(H, y):
    """The residuals (..., n, c) of the newest n samples, in standard deviations, as a function of places."""

    def newest(n):
        return OfMany(lambda z: (y[-n:] - np.einsum("ncd,...d->...nc", H[-n:], LOWER + WIDTH * z)) / SIGMA)

    return newest


def normal_equations(H, y, n):
    """Parameters (d,) and their covariance (d, d) in the unit cube, by NumPy on the newest n samples."""
    A = H[-n:].reshape(-1, 3) * WIDTH / SIGMA
    b = (y[-n:] - H[-n:] @ LOWER).reshape(-1) / SIGMA
    return np.linalg.lstsq(A, b, rcond=None)[0], np.linalg.inv(A.T @ A)


@pytest.mark.parametrize("seed", range(5))
def test_a_jump_is_to_the_least_squares_of_the_samples_with_its_deviations(seed):
    H, y = measured(8, seed=seed)
    found = jump_to(rows_at(H, y), (8,), START, SPACE)
    z, covariance = normal_equations(H, y, 8)
    assert_allclose(SPACE.to_unit(found.theta), z, atol=1e-6)
    assert_allclose(found.std, WIDTH * np.sqrt(covariance.diagonal()), rtol=1e-4)
    assert found.is_identifiable == tuple(np.sqrt(covariance.diagonal()) <= 0.05)
    residuals = rows_at(H, y)(8)(z)
    assert_allclose(found.cost, np.sum(residuals**2), rtol=1e-6)


def with_prior(H, y):
    """Parameters (d,) and their covariance (d, d) in the unit cube, where each is START to half the bounds at first."""
    A = np.vstack([H.reshape(-1, 3) * WIDTH / SIGMA, np.eye(3) / 0.5])
    b = np.append((y - H @ LOWER).reshape(-1) / SIGMA, START / 0.5)
    return np.linalg.lstsq(A, b, rcond=None)[0], np.linalg.inv(A.T @ A)


@pytest.mark.parametrize("seed", range(5))
def test_a_followed_jump_has_what_all_samples_since_then_say(seed):
    H, y = measured(4, c=6, seed=seed)
    known, fit = followed_jump(rows_at(H, y)(4), 4, START, 1e-9)  # they do not drift
    z, covariance = with_prior(H, y)
    assert_allclose(known.mean, z, atol=1e-6)
    assert_allclose(known.covariance, covariance, rtol=1e-4, atol=1e-12)
    assert (fit.n_free, fit.n_values) == (3, 24)
    # what the samples together leave unexplained; the prior is so wide that it takes no part
    assert_allclose(fit.squares, np.sum(rows_at(H, y)(4)(z) ** 2), atol=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_of_parameters_that_do_not_drift_after_a_jump_all_samples_since_then_are_known(seed):
    """Though the filter lets them drift until that is known: a rate of 0.1 is wide beside what one sample says."""
    H, y = measured(20, c=6, seed=seed)
    known, _ = followed_jump(rows_at(H[:3], y[:3])(3), 3, START, 0.1)
    for h, measured_now in zip(H[3:], y[3:], strict=True):
        known = known.updated(OfMany(lambda z, h=h, v=measured_now: (v - (LOWER + WIDTH * z) @ h.T) / SIGMA))
    z, covariance = with_prior(H, y)
    assert_allclose(known.mean, z, atol=1e-6)
    assert_allclose(known.covariance, covariance, rtol=1e-4, atol=1e-12)


def test_a_jump_is_followed_while_the_parameters_drift():
    """A second sample that the first one's parameters miss by many standard deviations, within the usual rate."""
    H, y = measured(3, c=6)
    moving = TRUTH + np.array([0.0, 0.015, 0.03])[:, None] * np.array([1.0, 0.0, 0.0])
    y = np.einsum("ncd,nd->nc", H, moving) + 1e-3 / SIGMA * (y - H @ TRUTH)
    sharp = OfMany(lambda z: (y - np.einsum("ncd,...d->...nc", H, LOWER + WIDTH * z)) / 1e-3)
    assert jump_to(lambda n: sharp, (3,), START, SPACE) is None
    known, fit = followed_jump(sharp, 3, START, 0.0025)
    assert_allclose(LOWER + WIDTH * known.mean, moving[-1], atol=3e-3)
    assert fit.is_explained


@pytest.mark.parametrize(
    ("c", "more"),
    [(3, 0.0), (6, np.linspace(-2.0, 2.0, 6)), (6, np.array([0.0, 2.0, 0.0])[:, None] * np.linspace(-1.0, 1.0, 6))],
    ids=["as many values as parameters", "a disturbance from the first on", "a disturbance from the second on"],
)
def test_samples_that_prove_no_parameters_are_not_followed(c, more):
    H, y = measured(3, c=c, more=more)
    assert followed_jump(rows_at(H, y)(3), 3, START, 0.0025) is None


@pytest.mark.parametrize(("n", "c"), [(1, 2), (1, 3), (3, 1)])
def test_as_many_values_as_parameters_explain_nothing(n, c):
    H, y = measured(n, c)
    assert jump_to(rows_at(H, y), (n,), START, SPACE) is None
    H, y = measured(n + 1, c)
    assert jump_to(rows_at(H, y), (n + 1,), START, SPACE) is not None


def test_as_many_values_of_several_samples_are_enough_where_the_next_one_will_prove_them():
    H, y = measured(3, 1)
    found = jump_to(rows_at(H, y), (3,), START, SPACE, may_be_exact=True)
    assert_allclose(SPACE.to_unit(found.theta), normal_equations(H, y, 3)[0], atol=1e-6)
    H, y = measured(3, 1, truth=np.array([1.8, 0.4, 30.0]))
    assert jump_to(rows_at(H, y), (3,), START, SPACE, may_be_exact=True) is None  # beyond the bounds


@pytest.mark.parametrize("seed", range(5))
def test_of_all_that_explain_two_samples_those_nearest_to_the_start_are_taken(seed):
    H, y = measured(2, 1, seed=seed, truth=LOWER + WIDTH * (START + np.array([0.1, -0.1, 0.05])))
    found = jump_to(rows_at(H, y), (2,), START, SPACE, may_be_exact=True)
    A, b = H.reshape(2, 3) * WIDTH, (y - H @ (LOWER + WIDTH * START)).reshape(2)
    assert_allclose(SPACE.to_unit(found.theta), START + np.linalg.pinv(A) @ b, atol=1e-4)
    assert jump_to(rows_at(H, y), (2,), START, SPACE) is None


def test_samples_that_no_parameters_explain_lead_nowhere():
    H, y = measured(8, more=20.0 * SIGMA * np.sin(np.arange(8.0))[:, None])
    assert jump_to(rows_at(H, y), (8,), START, SPACE) is None


def test_parameters_beyond_their_bounds_are_none():
    H, y = measured(8, truth=np.array([1.8, 0.4, 9.0]))
    assert jump_to(rows_at(H, y), (8,), START, SPACE) is None


def test_where_the_model_fails_close_by_nothing_is_known_of_the_parameters():
    H, y = measured(8)
    z, _ = normal_equations(H, y, 8)
    only_there = lambda n: OfMany(  # noqa: E731
        lambda place: np.where(np.all(place == z, axis=-1)[..., None, None], rows_at(H, y)(n)(place), np.nan)
    )
    assert jump_to(only_there, (8,), z, SPACE) is None


def test_the_first_length_that_is_explained_counts():
    H, y = measured(12)
    y[:6] += 50.0 * SIGMA
    found = jump_to(rows_at(H, y), (12, 5, 4), START, SPACE)
    assert_allclose(SPACE.to_unit(found.theta), normal_equations(H, y, 5)[0], atol=1e-6)
    assert "5 samples" in found.reason


@pytest.mark.parametrize("name", ["ukf", "mhe", "enkf"])
def test_after_a_jump_a_filter_is_the_kalman_filter_that_begins_with_what_is_known(name):
    H, y = measured(8)
    found = jump_to(rows_at(H, y), (8,), START, SPACE)
    z, covariance = normal_equations(H, y, 8)
    P = np.linalg.inv(np.linalg.inv(covariance) + np.eye(3) / SPREAD**2)
    rng = np.random.default_rng(7)
    made = {
        "ukf": lambda: UnscentedKalman(SPACE, TRUTH, rng, UnscentedSettings(walk=WALK, spread=SPREAD)),
        "mhe": lambda: MovingHorizon(SPACE, TRUTH, rng, MovingHorizonSettings(walk=WALK, spread=SPREAD)),
        "enkf": lambda: EnsembleKalman(SPACE, TRUTH, rng, EnsembleSettings(walk=WALK, spread=SPREAD, members=4000)),
    }
    kalman = made[name]()
    kalman.jump(found)
    assert_allclose(SPACE.to_unit(kalman.estimate().theta), z, atol=1e-2 if name == "enkf" else 1e-6)
    assert_allclose(kalman.estimate().std, WIDTH * np.sqrt(P.diagonal()), rtol=0.05 if name == "enkf" else 1e-4)
    h, more = measured(1, seed=3)
    sample = Sample(0.0, tuple(h.ravel()), (), tuple(more[0]))
    window = ResidualWindow(
        lambda theta, s: (np.array(s.xdot) - np.reshape(s.x, (-1, 3)) @ theta) / SIGMA, 1, 1, of_many
    )
    window.append(sample)
    kalman.solve(Objective(window))
    prior = P + (0.0 if name == "mhe" else WALK**2) * np.eye(3)
    A, b = h[0] * WIDTH / SIGMA, (more[0] - h[0] @ LOWER) / SIGMA
    gain = prior @ A.T @ np.linalg.inv(A @ prior @ A.T + np.eye(2))
    assert_allclose(
        SPACE.to_unit(kalman.estimate().theta), z + gain @ (b - A @ z), atol=1e-2 if name == "enkf" else 1e-6
    )


def of_many(thetas, samples):
    return np.stack([(np.array(s.xdot) - thetas @ np.reshape(s.x, (-1, 3)).T) / SIGMA for s in samples], axis=-2)
