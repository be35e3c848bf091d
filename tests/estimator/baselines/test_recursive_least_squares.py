"""Recursive estimators against batch least squares and the ordinary Kalman filter."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2, qmc

from estimator import LinearForm, Objective, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.baselines.kalman import UnscentedKalman, UnscentedSettings
from estimator.baselines.recursive_least_squares import RecursiveLeastSquares, RecursiveSettings
from fmu_models import pendulum

PLANE = ParameterSpace((Parameter("a", -3.0, 5.0), Parameter("b", -2.0, 6.0)))
START = np.array([0.8, 1.5])
RNG = np.random.default_rng


def plane_rows(x, u, xdot):
    """Each sample carries its rows (2, 2) as its state."""
    return np.reshape(x, (-1, 2)).tolist(), list(xdot)


FORM = LinearForm(PLANE, plane_rows, lambda a, b: (a, b))


def take(estimator, sample, form=FORM, residual=None):
    """Let it take one sample; returns the estimate."""
    residual = residual or (lambda theta, s: np.array(s.xdot) - np.reshape(s.x, (-1, 2)) @ theta)
    window = ResidualWindow(residual, len(sample.xdot), 1)
    window.append(sample)
    made = Objective(window, form)
    estimator.solve(made)
    return estimator.estimate()


def plane_samples(n, truth=(1.2, 0.7), noise=0.05, n_rows=1, seed=0):
    rng = RNG(seed)
    samples = []
    for k in range(n):
        H = rng.normal(size=(n_rows, 2))
        y = H @ truth + noise * rng.standard_normal(n_rows)
        samples.append(Sample(float(k), tuple(H.ravel()), (), tuple(y)))
    return samples


# --- recursive least squares -----------------------------------------------------------------------------------------


# Of a over its bounds, and of b, at 64 places that fill the cube; 8/sqrt(12) = 2.309 of infinitely many.
START_STD = np.std(PLANE.from_unit(qmc.Halton(2, scramble=False).random(64)), axis=0)


def test_the_start_is_as_sure_as_the_bounds():
    assert_allclose(START_STD, 8.0 / np.sqrt(12.0), rtol=0.03)


@pytest.mark.parametrize(("n_rows", "forgetting"), [(1, 1.0), (2, 1.0), (2, 0.9), (2, 0.6)])
def test_it_is_batch_least_squares_with_a_prior_and_exponential_weights(n_rows, forgetting):
    """The k-th of n samples weighs lambda^(n-k), the start lambda^(n-1): at the first it is as sure as it may be.

    Two rows a sample excite both directions each time, so that no direction comes back to where it started.
    """
    settings = RecursiveSettings(forgetting, noise=0.05, spread=0.5)
    estimator = RecursiveLeastSquares(PLANE, START, RNG(0), settings)
    A, y, w = [], [], []
    for n, sample in enumerate(plane_samples(25, n_rows=n_rows), 1):
        estimate = take(estimator, sample)
        A.extend(np.reshape(sample.x, (-1, 2)))
        y.extend(sample.xdot)
        w = [forgetting * weight for weight in w] + [1.0 / 0.05**2] * n_rows
        prior = forgetting ** (n - 1) / (0.5 * START_STD) ** 2
        # Least squares of the weighted rows and of the start, which counts as two rows more.
        root = np.sqrt([*w, *prior])
        stacked = np.vstack([A, np.eye(2)]) * root[:, None]
        batch, *_ = np.linalg.lstsq(stacked, np.array([*y, *START]) * root)
        assert_allclose(estimate.theta, batch, rtol=1e-6)  # of the projection, an iteration
        # In the cube: the information of coefficients, and the bounds count as a deviation of one.
        in_cube = 8.0 * stacked.T @ stacked * 8.0 + np.eye(2)
        assert_allclose(estimate.std, 8.0 * np.sqrt(np.diag(np.linalg.inv(in_cube))), rtol=1e-6)
        assert estimate.n_evaluations == n
        assert_allclose(estimate.cost, np.sum((sample.xdot - np.reshape(sample.x, (-1, 2)) @ batch) ** 2), rtol=1e-4)


PENDULUM = ParameterSpace((Parameter("m", 0.5, 5.0, "kg", "log"), Parameter("l", 0.2, 2.0, "m", "log")))
PENDULUM_FORM = LinearForm(PENDULUM, pendulum.regression, pendulum.coefficients)


def swing(n, truth, noise=0.0, seed=0):
    rng = RNG(seed)
    for k in range(n):
        t = 0.1 * k
        x, u = (1.2 * np.sin(1.3 * t), 1.6 * np.cos(1.3 * t)), (6.0 * np.cos(3.1 * t + 0.5),)
        xdot = pendulum.derivative(x, u, *truth)[1] + noise * rng.standard_normal()
        yield Sample(t, x, u, (xdot,))


def pendulum_residual(theta, sample):
    return np.array([sample.xdot[0] - pendulum.derivative(sample.x, sample.u, *theta)[1]])


@pytest.mark.parametrize("truth", [(2.4, 0.6), (0.9, 1.4), (1.75, 0.75)], ids=str)
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_three_coefficients_of_the_pendulum_give_its_mass_and_length(truth, noise):
    """Weights of ten samples: 0.01 m/s^2 in some 10 m/s^2 a sample; 2 % allowed, the starts are 7 to 95 % off."""
    estimator = RecursiveLeastSquares(PENDULUM, np.array([1.75, 0.75]), RNG(0))
    for sample in swing(60, truth, noise):
        estimate = take(estimator, sample, PENDULUM_FORM, pendulum_residual)
    assert_allclose(estimate.theta, truth, rtol=0.02 if noise else 2e-3)
    assert np.all(estimate.std < 0.2)


def test_a_jump_is_forgotten():
    """0.8^60 = 1e-6 of the weight is from before it."""
    estimator = RecursiveLeastSquares(PENDULUM, np.array([1.75, 0.75]), RNG(0))
    for truth in ((2.4, 0.6), (1.2, 0.9)):
        for sample in swing(60, truth):
            estimate = take(estimator, sample, PENDULUM_FORM, pendulum_residual)
        assert_allclose(estimate.theta, truth, rtol=0.01)


def test_a_direction_without_excitation_does_not_keep_another_from_being_forgotten():
    """a jumps while b is not excited: one sample's weight is a quarter of the past's, 1/(1 - 0.8) = 5 samples."""
    estimator = RecursiveLeastSquares(PLANE, START, RNG(0), RecursiveSettings(noise=0.05))
    for truth, n in ((1.0, 200), (3.0, 20)):
        for k in range(n):
            estimate = take(estimator, Sample(float(k), (1.0, 0.0), (), (truth,)))
    assert_allclose(estimate.theta, [3.0, START[1]], atol=0.03)  # 2 * 0.8^20 = 0.02 of the past is left


def test_a_coefficient_that_starts_at_zero_is_found():
    estimator = RecursiveLeastSquares(PLANE, np.array([1.0, 0.0]), RNG(0))
    for sample in plane_samples(50, truth=(2.0, 3.0), noise=0.01):
        estimate = take(estimator, sample)
    assert_allclose(estimate.theta, [2.0, 3.0], atol=0.05)


def test_a_coefficient_that_is_constant_over_the_bounds_is_known():
    """y + 3 h1 = a h1 + 3 h1 + b h2 with the coefficients (a, 3, b) tells what y does with (a, b)."""
    with_constant = LinearForm(
        PLANE, lambda x, u, xdot: (np.reshape(x, (-1, 2))[:, [0, 0, 1]].tolist(), [y + 3.0 * x[0] for y in xdot]),
        lambda a, b: (a, 3.0, b),
    )  # fmt: skip
    whole, reduced = (RecursiveLeastSquares(PLANE, START, RNG(0)) for _ in range(2))
    for sample in plane_samples(25):
        mine, its = take(whole, sample, with_constant), take(reduced, sample)
        assert_allclose(mine.theta, its.theta, rtol=1e-5)  # of the projection, an iteration
        assert_allclose(mine.std, its.std, rtol=1e-5)


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e9])
def test_samples_that_are_far_too_large_are_no_end(factor):
    """As where a sensor is wrong by its unit: the covariance then has no Cholesky factor any more."""
    estimator = RecursiveLeastSquares(PLANE, START, RNG(0))
    for k, sample in enumerate(plane_samples(40)):
        x = tuple(factor * value for value in sample.x) if k >= 20 else sample.x
        estimate = take(estimator, replace(sample, x=x, xdot=(factor * sample.xdot[0],) if k >= 20 else sample.xdot))
    assert np.all(np.isfinite(estimate.theta))
    assert np.all(np.isfinite(estimate.std))


def test_a_parameter_that_is_not_excited_is_not_identifiable():
    """b's rows are nil: it is as sure as the start, 0.29 of the bounds, or the cube's 1 with it, 0.28; a is 0.001."""
    for below, expected in ((0.05, (True, False)), (0.5, (True, True)), (1e-6, (False, False))):
        estimator = RecursiveLeastSquares(PLANE, START, RNG(0), RecursiveSettings(identifiable_below=below))
        for k in range(20):
            estimate = take(estimator, Sample(float(k), (1.0, 0.0), (), (1.2,)))
        assert estimate.is_identifiable == expected
    assert_allclose(estimate.std[1], 1.0 / np.hypot(1.0 / START_STD[1], 1.0 / 8.0), rtol=1e-6)


def test_the_estimate_stays_inside_the_bounds():
    estimator = RecursiveLeastSquares(PLANE, START, RNG(0))
    for sample in plane_samples(30, truth=(9.0, 0.7), noise=0.01):
        estimate = take(estimator, sample)
        assert -3.0 <= estimate.theta[0] <= 5.0
        assert -2.0 <= estimate.theta[1] <= 6.0
    assert_allclose(estimate.theta[0], 5.0, atol=1e-3)


@pytest.mark.full
def test_it_does_not_wind_up_where_nothing_is_excited():
    """After 2000 empty samples a small one, of residual 0.01 at a row of 1e-3.

    The covariance is at most the start's, 2.31^2 = 5.3 in each direction, so its gain is at most 5.3 * 1e-3 / 0.01^2,
    and the estimate moves by 0.53 at most. One that forgets on has no memory left: it would move by 0.01/1e-3 = 10,
    into the bounds.
    """
    estimator = RecursiveLeastSquares(PLANE, START, RNG(0))
    for sample in plane_samples(20):
        known = take(estimator, sample)
    for k in range(2000):
        quiet = take(estimator, Sample(float(k), (0.0, 0.0), (), (0.0,)))
    assert_allclose(quiet.theta, known.theta, rtol=1e-6)
    assert np.all(np.isfinite(quiet.std))
    assert np.all(quiet.std < 8.0)
    row = np.array([1e-3, 0.0])
    after = take(estimator, Sample(0.0, tuple(row), (), (float(row @ known.theta) + 0.01,)))
    assert np.max(np.abs(after.theta - known.theta)) < 0.53
    assert np.max(np.abs(after.theta - known.theta)) > 1e-4  # it was heard


def test_a_restart_forgets_all_samples():
    used, fresh = (RecursiveLeastSquares(PLANE, START, RNG(0)) for _ in range(2))
    for sample in plane_samples(10, truth=(4.0, -1.0)):
        take(used, sample)
    assert used.estimate().is_identifiable == (True, True)
    used.restart(START)
    blank = used.estimate()
    assert (blank.n_evaluations, blank.theta.tolist()) == (0, fresh.estimate().theta.tolist())
    assert (blank.std.tolist(), blank.is_identifiable, blank.cost) == ([8.0, 8.0], (False, False), np.inf)
    for sample in plane_samples(10):
        np.testing.assert_array_equal(take(used, sample).theta, take(fresh, sample).theta)


def test_without_the_models_linear_form_it_refuses():
    with pytest.raises(ValueError, match="recursive least squares needs the model's linear form"):
        take(RecursiveLeastSquares(PLANE, START, RNG(0)), plane_samples(1)[0], None)


@pytest.mark.parametrize(
    "settings",
    [{"forgetting": 0.0}, {"forgetting": 1.1}, {"noise": 0.0}, {"spread": -1.0}, {"identifiable_below": 0.0}],
)
def test_settings_of_recursive_least_squares_are_checked(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        RecursiveSettings(**settings)


# --- the unscented Kalman filter -------------------------------------------------------------------------------------


def whitened(theta, sample):
    return (np.array(sample.xdot) - np.reshape(sample.x, (-1, 2)) @ theta) / 0.2


@pytest.mark.parametrize("alpha", [0.1, 1.0])
@pytest.mark.parametrize("n_rows", [1, 3])
def test_on_a_model_linear_in_z_it_is_the_ordinary_kalman_filter(alpha, n_rows):
    """Random walk of deviation 0.01 a sample, from 0.1, in the cube, whose sides are 8."""
    estimator = UnscentedKalman(PLANE, START, RNG(0), UnscentedSettings(walk=0.01, spread=0.1, alpha=alpha))
    z, P = (START - [-3.0, -2.0]) / 8.0, 0.1**2 * np.eye(2)
    for n, sample in enumerate(plane_samples(30, noise=0.2, n_rows=n_rows), 1):
        estimate = take(estimator, sample, None, whitened)
        H = np.reshape(sample.x, (-1, 2)) * 8.0 / 0.2
        P = P + 0.01**2 * np.eye(2)
        S = H @ P @ H.T + np.eye(n_rows)
        innovation = np.array(sample.xdot) / 0.2 - H @ (z + np.array([-3.0, -2.0]) / 8.0)
        K = P @ H.T @ np.linalg.inv(S)
        z, P = z + K @ innovation, P - K @ S @ K.T
        assert_allclose(estimate.theta, np.array([-3.0, -2.0]) + 8.0 * z, rtol=0.0, atol=1e-9)
        assert_allclose(estimate.std, 8.0 * np.sqrt(np.diag(P)), rtol=1e-9)
        assert_allclose(estimate.cost, innovation @ innovation, rtol=1e-6)
        assert estimate.n_evaluations == 5 * n


@pytest.mark.full
def test_errors_are_as_large_as_it_says():
    """Normalised error squared of a parameter that walks as the filter believes, on a log scale, from a drawn start.

    400 independent runs, one value each: their sum is chi-square of 400 degrees, within its limits of 1e-4.
    """
    space = ParameterSpace((Parameter("m", 0.1, 10.0, "kg", "log"),))
    width, start = np.log(100.0), np.array([1.0])
    squared = []
    for seed in range(400):
        rng = RNG(seed)
        z = 0.5 + 0.03 * rng.standard_normal()
        estimator = UnscentedKalman(space, start, rng, UnscentedSettings(walk=0.004, spread=0.03))
        for k in range(15):
            z += 0.004 * rng.standard_normal()
            y = 2.0 * np.log(space.from_unit([z])[0]) + 0.1 * rng.standard_normal()
            estimate = take(
                estimator, Sample(float(k), (), (), (float(y),)), None,
                lambda theta, s: np.array([(s.xdot[0] - 2.0 * np.log(theta[0])) / 0.1]),
            )  # fmt: skip
        off = (z - 0.5) * width - np.log(estimate.theta[0])
        squared.append((off / (estimate.std[0] / estimate.theta[0])) ** 2)
    assert chi2.ppf(1e-4, 400) < np.sum(squared) < chi2.ppf(1.0 - 1e-4, 400)


def test_a_sample_without_a_value_leaves_the_belief_and_it_goes_on():
    """NaN at each sigma point: theta stays, and the variance grows by the walk's, which passes all the same."""
    estimator = UnscentedKalman(PLANE, START, RNG(0))
    samples = plane_samples(40, noise=0.2)
    for sample in samples[:10]:
        before = take(estimator, sample, None, whitened)
    for _ in range(3):
        after = take(estimator, samples[10], None, lambda theta, s: np.array([np.nan]))
    assert_allclose(after.theta, before.theta, rtol=1e-10)
    assert_allclose(after.std**2, before.std**2 + 3 * (0.003 * 8.0) ** 2, rtol=1e-6)
    for sample in samples[10:]:
        last = take(estimator, sample, None, whitened)
    assert_allclose(last.theta, [1.2, 0.7], atol=0.2)
    assert np.all(np.isfinite(last.std))
    assert np.isfinite(last.cost)


def test_a_sigma_point_without_a_value_is_enough_to_leave_the_sample_out():
    estimator = UnscentedKalman(PLANE, START, RNG(0))
    estimate = take(
        estimator, plane_samples(1)[0], None,
        lambda theta, s: whitened(theta, s) * (np.nan if theta[0] > START[0] + 0.01 else 1.0),
    )  # fmt: skip
    assert_allclose(estimate.theta, START, rtol=1e-10)
    assert np.all(np.isfinite(estimate.std))


def test_the_filter_stays_inside_the_bounds():
    estimator = UnscentedKalman(PLANE, START, RNG(0))
    for sample in plane_samples(30, truth=(9.0, -7.0), noise=0.01):
        estimate = take(estimator, sample, None, whitened)
        assert np.all(estimate.theta >= [-3.0, -2.0])
        assert np.all(estimate.theta <= [5.0, 6.0])
        assert np.all(np.isfinite(estimate.std))
    assert_allclose(estimate.theta, [5.0, -2.0], atol=0.1)


def test_before_the_first_sample_it_knows_nothing_and_a_restart_forgets():
    estimator = UnscentedKalman(PLANE, START, RNG(0))
    first = [take(estimator, s, None, whitened).theta for s in plane_samples(5)]
    estimator.restart(START)
    blank = estimator.estimate()
    assert_allclose(blank.theta, START, rtol=1e-12)
    assert_allclose(blank.std, [8.0, 8.0], rtol=1e-12)
    assert (blank.is_identifiable, blank.n_evaluations, blank.cost) == ((False, False), 0, np.inf)
    np.testing.assert_array_equal([take(estimator, s, None, whitened).theta for s in plane_samples(5)], first)


def test_the_filter_tells_what_is_identifiable_by_its_standard_deviations():
    """b is not excited: from 0.04 of the cube, assumed, it walks 20 times by 0.003, to 0.042; a is below 0.004."""
    for below, expected in ((0.02, (True, False)), (0.05, (True, False)), (1e-4, (False, False))):
        estimator = UnscentedKalman(PLANE, START, RNG(0), UnscentedSettings(spread=0.04, identifiable_below=below))
        for k in range(20):
            estimate = take(estimator, Sample(float(k), (100.0, 0.0), (), (120.0,)), None, whitened)
        assert estimate.is_identifiable == expected
    assert_allclose(estimate.std[1] / 8.0, np.sqrt(0.04**2 + 20 * 0.003**2), rtol=1e-6)


@pytest.mark.parametrize("name", ["walk", "spread", "alpha", "identifiable_below"])
def test_settings_of_the_filter_are_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        UnscentedSettings(**{name: 0.0})
