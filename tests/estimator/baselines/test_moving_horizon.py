"""Moving-horizon estimator: filterpy's Kalman filter where the model is linear, a closer fit where it is not."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.stats import chi2

from estimator import Objective, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.baselines.kalman import UnscentedKalman, UnscentedSettings
from estimator.baselines.moving_horizon import MovingHorizon, MovingHorizonSettings

PLANE = ParameterSpace((Parameter("a", -3.0, 5.0), Parameter("b", -2.0, 6.0)))
LOWER, WIDTH = np.array([-3.0, -2.0]), 8.0
START, SIGMA = np.array([1.0, 1.0]), 0.2
POSITIVE = ParameterSpace((Parameter("m", 0.1, 10.0, "kg", "log"),))


def rows(theta, sample):
    """A model that is linear in the parameters: each sample carries its rows (c, 2) as its state."""
    return (np.array(sample.xdot) - np.reshape(sample.x, (-1, 2)) @ theta) / SIGMA


def square(theta, sample):
    return np.array([(sample.xdot[0] - np.log(theta[0]) ** 2) / 0.1])


def take(estimator, sample, residual=rows):
    window = ResidualWindow(residual, len(sample.xdot), 1)
    window.append(sample)
    estimator.solve(Objective(window))
    return estimator.estimate()


def samples(n, truth, n_rows=2, seed=0):
    rng = np.random.default_rng(seed)
    made = []
    for k in range(n):
        H = rng.normal(size=(n_rows, 2))
        y = H @ (truth(k) if callable(truth) else truth) + SIGMA * rng.standard_normal(n_rows)
        made.append(Sample(float(k), tuple(H.ravel()), (), tuple(y)))
    return made


def made(space=PLANE, start=START, **settings):
    return MovingHorizon(space, start, np.random.default_rng(0), MovingHorizonSettings(**settings))


@pytest.mark.parametrize("horizon", [1, 4, 50])
@pytest.mark.parametrize("n_rows", [1, 3])
def test_on_a_linear_plant_it_is_the_kalman_filter(horizon, n_rows):
    """To 1e-9, with parameters that walk, whatever the horizon."""
    estimator = made(horizon=horizon, walk=0.01, spread=0.1)
    kalman = KalmanFilter(2, n_rows)
    kalman.x, kalman.P, kalman.Q = (START - LOWER) / WIDTH, 0.1**2 * np.eye(2), 0.01**2 * np.eye(2)
    kalman.F, kalman.R = np.eye(2), np.eye(n_rows)
    for k, sample in enumerate(samples(30, lambda k: np.array([1.2 + 0.02 * k, 0.7]), n_rows)):
        estimate = take(estimator, sample)
        H = np.reshape(sample.x, (-1, 2))
        if k:
            kalman.predict()
        kalman.update((np.array(sample.xdot) - H @ LOWER) / SIGMA, H=H * WIDTH / SIGMA)
        assert_allclose(estimate.theta, LOWER + WIDTH * kalman.x, rtol=0.0, atol=WIDTH * 1e-9)
        assert_allclose(estimate.std, WIDTH * np.sqrt(kalman.P.diagonal()), rtol=1e-6)


@pytest.mark.full
def test_errors_are_as_large_as_it_says_where_the_model_is_curved():
    """Normalised errors squared of 300 runs from drawn starts: chi-square of 300 degrees, within its limits of 1e-4."""
    squared = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        z = 0.75 + 0.03 * rng.standard_normal()
        estimator = made(POSITIVE, POSITIVE.from_unit(np.array([0.75])), horizon=8, walk=0.004, spread=0.03)
        for k in range(15):
            y = np.log(POSITIVE.from_unit(np.array([z]))[0]) ** 2 + 0.1 * rng.standard_normal()
            estimate = take(estimator, Sample(float(k), (), (), (float(y),)), square)
            off = (z - POSITIVE.to_unit(estimate.theta)[0]) * np.log(100.0) / (estimate.std[0] / estimate.theta[0])
            z += 0.004 * rng.standard_normal()
        squared.append(off**2)
    assert chi2.ppf(1e-4, 300) < np.sum(squared) < chi2.ppf(1.0 - 1e-4, 300)


def test_it_minimises_what_it_says():
    """The whole path of the parameter, against SciPy's least squares on start, walk and residuals."""
    rng, n, walk, spread = np.random.default_rng(3), 12, 0.02, 0.2
    path = 0.75 + np.cumsum(walk * rng.standard_normal(n))
    measured = [np.log(POSITIVE.from_unit(np.array([z]))[0]) ** 2 + 0.1 * rng.standard_normal() for z in path]
    estimator = made(POSITIVE, POSITIVE.from_unit(np.array([0.65])), horizon=n, walk=walk, spread=spread, iterations=50)
    for k, y in enumerate(measured):
        estimate = take(estimator, Sample(float(k), (), (), (float(y),)), square)

    def costs(z):
        modelled = (np.log(100.0) * (z - 0.5)) ** 2
        return np.concatenate([[(z[0] - 0.65) / spread], np.diff(z) / walk, (measured - modelled) / 0.1])

    best = least_squares(costs, np.full(n, 0.7), xtol=1e-12).x[-1]
    assert POSITIVE.to_unit(estimate.theta)[0] == pytest.approx(best, abs=5e-6)


def test_from_a_wrong_start_it_is_nearer_than_the_unscented_filter():
    """It evaluates older samples anew at what it has learnt since: the filter's old linearisations stay."""
    off = {}
    for name, estimator in {
        "mhe": made(POSITIVE, np.array([1.3]), horizon=20, walk=1e-4, spread=0.5, iterations=20),
        "ukf": UnscentedKalman(
            POSITIVE, np.array([1.3]), np.random.default_rng(0), UnscentedSettings(walk=1e-4, spread=0.5)
        ),
    }.items():
        rng = np.random.default_rng(1)
        for k in range(20):
            y = np.log(5.0) ** 2 + 0.1 * rng.standard_normal()
            estimate = take(estimator, Sample(float(k), (), (), (float(y),)), square)
        off[name] = abs(np.log(estimate.theta[0] / 5.0)) / (0.1 / (2.0 * np.log(5.0)) / np.sqrt(20.0))
    assert off["mhe"] < 3.0
    assert off["mhe"] < off["ukf"]


@pytest.mark.parametrize("seed", range(2))
def test_what_one_parameter_follows_of_the_noise_does_not_move_another(seed):
    """A mass that two large forces push, one of them by a factor: their difference, of which a walk of the factor makes
    a standard deviation a sample, is divided by the mass. Nothing changes."""
    space = ParameterSpace((Parameter("m", 0.25, 4.0, "kg", "log"), Parameter("k", 0.5, 2.0, "", "log")))

    def pushed(theta, sample):
        (force,), (m, k) = sample.x, np.moveaxis(np.asarray(theta), -1, 0)
        return np.array([(sample.xdot[0] - (16.0 * (k - 1.0) + force) / m) / 0.05])

    rng, estimator = np.random.default_rng(seed), made(space, np.ones(2), horizon=5)
    for k in range(200):
        force = 1.5 * np.sin(0.04 * k)
        estimate = take(estimator, Sample(float(k), (force,), (), (force + 0.05 * rng.standard_normal(),)), pushed)
    assert abs(np.log(estimate.theta[0])) < 0.1


def test_a_sample_without_a_value_is_left_out():
    def lacking(theta, sample):
        return np.full(2, np.nan) if sample.t < 0.0 else rows(theta, sample)

    estimator = made()
    for sample in samples(10, (1.2, 0.7)):
        before = take(estimator, sample, lacking)
    for sample in samples(3, (1.2, 0.7), seed=1):
        after = take(estimator, replace(sample, t=-1.0), lacking)
    assert_allclose(after.theta, before.theta, atol=1e-9)
    assert np.all(after.std > before.std)
    for sample in samples(30, (1.2, 0.7), seed=2):
        after = take(estimator, sample, lacking)
    assert_allclose(after.theta, [1.2, 0.7], atol=0.3)


def test_it_stays_inside_the_bounds():
    estimator = made(spread=0.5)
    for sample in samples(20, (9.0, -7.0)):
        estimate = take(estimator, sample)
        assert PLANE.parameters[0].contains(estimate.theta[0])
        assert PLANE.parameters[1].contains(estimate.theta[1])
    assert_allclose(estimate.theta, [5.0, -2.0], atol=0.1)


def test_a_restart_forgets():
    estimator = made()
    first = [take(estimator, sample).theta for sample in samples(5, (1.2, 0.7))]
    estimator.restart(START)
    assert_allclose(estimator.estimate().theta, START, rtol=1e-12)
    assert_array_equal([take(estimator, sample).theta for sample in samples(5, (1.2, 0.7))], first)


@pytest.mark.parametrize("name", ["horizon", "walk", "spread", "iterations", "identifiable_below"])
def test_settings_are_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        MovingHorizonSettings(**{name: 0})
