"""Least squares against the closed form, and gradient methods on the paper's noisy norm."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import optimize
from scipy.spatial.transform import Rotation
from scipy.stats import kstest

from estimator import DerivativeResidual, Objective, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.baselines.moving_horizon import MovingHorizon
from estimator.baselines.solvers import LeastSquares, LeastSquaresSettings, NoisyNorm, NormSettings
from fmu_models import quadrotor

PLANE = ParameterSpace((Parameter("a", 0.0, 2.0), Parameter("b", -5.0, 5.0)))
MIXED = ParameterSpace((Parameter("a", 0.0, 2.0), Parameter("b", 0.1, 10.0, "kg", "log")))
LINE = ParameterSpace((Parameter("x", -2.0, 2.0),))
SIGMA = 0.05
X = np.random.default_rng(7).normal(size=(12, 2))


def objective(residual, d=2):
    """The objective of a function of theta, on one sample."""
    size = len(residual(np.full(d, 0.7)))
    window = ResidualWindow(lambda theta, sample: residual(theta), size, 1)
    window.append(Sample(0.0, (), (), ()))
    return Objective(window)


def recorded(residual, d=2):
    """The objective, and the list of what it is asked, one by one or several at once."""
    made, asked = objective(residual, d), []
    evaluate, evaluate_all = made.residual, made.residuals

    def record(theta):
        asked.append(np.array(theta))
        return evaluate(theta)

    def record_all(thetas):
        asked.extend(map(np.array, thetas if len(thetas) > 1 else ()))
        return evaluate_all(thetas)

    made.residual, made.residuals = record, record_all
    return made, asked


def least_squares(space, start, residual, seed=0, **settings):
    estimator = LeastSquares(space, np.array(start), np.random.default_rng(seed), LeastSquaresSettings(**settings))
    estimator.solve(objective(residual, len(space)))
    return estimator.estimate()


def noisy_norm(space, start, residual, seed=0, **settings):
    estimator = NoisyNorm(space, np.array(start), np.random.default_rng(seed), NormSettings(**settings))
    asked_of, asked = recorded(residual, len(space))
    estimator.solve(asked_of)
    return estimator.estimate(), np.array(asked)


# --- least squares ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("space", [PLANE, MIXED], ids=["linear", "log"])
@pytest.mark.parametrize("excess", [0.3, 1.0, 4.0])
def test_estimate_and_std_are_those_of_linear_regression(space, excess):
    """cov = sigma^2 (X^T X)^-1, sigma the stated one, or what the misfit says where that is larger."""
    y = X @ [0.9, 1.3] + excess * SIGMA * np.random.default_rng(1).standard_normal(12)
    estimate = least_squares(space, (0.3, 4.0), lambda theta: (y - X @ theta) / SIGMA)
    truth, squares, *_ = np.linalg.lstsq(X, y)
    scale = max(SIGMA, np.sqrt(squares[0] / 10))
    std = scale * np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    assert (scale > SIGMA) == (excess > 1.0)
    assert_allclose(estimate.theta, truth, atol=1e-4 * SIGMA)  # its own tolerance: 1e-8 of the cost
    assert_allclose(estimate.std, std, rtol=1e-4)  # the Jacobian is of differences, and at the scale's slope
    assert_allclose(estimate.cost, squares[0] / SIGMA**2, rtol=1e-8)
    assert estimate.is_identifiable == (True, True)


def test_std_is_the_scatter_of_estimates_from_noisy_data():
    """Monte Carlo of 300 data sets: the scatter of a standard deviation is 1/sqrt(600) = 4 %; 17 % allowed."""
    rng, errors, known = np.random.default_rng(0), [], []
    for _ in range(300):
        y = X @ [0.9, 1.3] + SIGMA * rng.standard_normal(12)
        estimate = least_squares(MIXED, (0.8, 1.2), lambda theta, y=y: (y - X @ theta) / SIGMA)
        errors.append(estimate.theta - [0.9, 1.3])
        known.append(estimate.std)
    assert_allclose(np.std(errors, axis=0), np.median(known, axis=0), rtol=0.17)


def test_a_parameter_that_no_residual_sees_is_as_wide_as_its_bounds_and_stays():
    estimate = least_squares(PLANE, (0.3, 4.0), lambda theta: np.array([theta[0] - 1.1, theta[0] - 1.1, 0.0]) / 0.01)
    assert_allclose(estimate.theta, [1.1, 4.0], atol=1e-6)
    assert_allclose(estimate.std, [0.01 / np.sqrt(2.0), 10.0], rtol=1e-4)
    assert estimate.is_identifiable == (True, False)


@pytest.mark.parametrize(("beyond", "bound"), [(3.0, 2.0), (-1.0, 0.0)], ids=["upper", "lower"])
def test_beyond_a_bound_it_is_regression_with_that_parameter_at_the_bound(beyond, bound):
    y = X @ [beyond, 1.3]
    asked_of, asked = recorded(lambda theta: (y - X @ theta) / SIGMA)
    estimator = LeastSquares(PLANE, np.ones(2), np.random.default_rng(0))
    estimator.solve(asked_of)
    free = np.linalg.lstsq(X[:, 1:], y - X[:, 0] * bound)[0][0]
    assert_allclose(estimator.estimate().theta, [bound, free], atol=1e-4)  # it keeps a hair inside
    assert np.all(np.array(asked) >= [0.0, -5.0])
    assert np.all(np.array(asked) <= [2.0, 5.0])


def valley(theta):
    """Rosenbrock's, of minimum (1, 1): some twenty iterations."""
    return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0], 0.0])


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 17])
def test_evaluations_end_exactly_at_the_limit_those_of_the_jacobian_included(n):
    asked_of, asked = recorded(valley)
    settings = LeastSquaresSettings(max_evaluations=n, n_starts=5)
    estimator = LeastSquares(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0), settings)
    estimator.solve(asked_of)
    estimate = estimator.estimate()
    assert (asked_of.n_evaluations, len(asked), estimate.n_evaluations) == (n, n, n)
    # What it has is the best that it saw.
    costs = [np.sum(valley(theta) ** 2) for theta in asked]
    assert_allclose(estimate.cost, min(costs), rtol=1e-12)
    np.testing.assert_array_equal(estimate.theta, asked[int(np.argmin(costs))])


def test_evaluations_add_up_over_solves_until_a_restart():
    estimator = LeastSquares(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0), LeastSquaresSettings(7))
    for k in (1, 2):
        estimator.solve(objective(valley))
        assert estimator.estimate().n_evaluations == 7 * k
    estimator.restart(np.array([0.5, 0.5]))
    assert estimator.estimate().n_evaluations == 0
    assert_allclose(estimator.estimate().theta, [0.5, 0.5], rtol=1e-12)


def test_the_next_solve_begins_at_the_last_estimate():
    estimator = LeastSquares(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0), LeastSquaresSettings(20))
    estimator.solve(objective(valley))
    last = estimator.estimate().theta
    asked_of, asked = recorded(valley)
    estimator.solve(asked_of)
    assert_allclose(asked[0], last, rtol=1e-12)


def two_wells(theta):
    """(x^2 - 1)^2 + (x - 1)^2 / 4: zero at 1, a local minimum near -0.8."""
    return np.array([theta[0] ** 2 - 1.0, 0.5 * (theta[0] - 1.0)])


def test_multi_start_leaves_a_local_minimum_in_which_one_start_ends():
    slope = [4.0, 0.0, -4.0 + 0.5, -0.5]
    local = min(np.roots(slope).real)
    assert -0.9 < local < -0.7
    assert_allclose(least_squares(LINE, [-1.5], two_wells).theta, local, atol=1e-4)  # its tolerance, 1e-8 of the cost
    for seed in range(5):
        assert_allclose(least_squares(LINE, [-1.5], two_wells, seed, n_starts=8).theta, 1.0, atol=1e-6)


def test_multi_start_tells_the_std_of_the_minimum_that_it_took():
    """At 1 the slopes are 2 and 1/2; the 7 other starts end in either well, in any order."""
    for seed in range(5):
        estimate = least_squares(LINE, [-1.5], two_wells, seed, n_starts=8)
        assert_allclose(estimate.std, 1.0 / np.hypot(2.0, 0.5), rtol=1e-5)


def test_a_start_without_a_value_is_kept_where_no_other_is_tried():
    estimate = least_squares(LINE, [-1.5], lambda theta: np.full(2, np.nan))
    assert_allclose(estimate.theta, -1.5, rtol=1e-12)
    assert_allclose(estimate.std, 4.0, rtol=1e-12)
    assert estimate.is_identifiable == (False,)


def cliff(theta):
    """No value below -1; zero at 0.3."""
    return np.array([theta[0] - 0.3, 0.0]) * (np.nan if theta[0] < -1.0 else 10.0)


def test_multi_start_leaves_a_start_without_a_value():
    assert_allclose(least_squares(LINE, [-1.5], cliff).theta, -1.5, rtol=1e-12)
    assert_allclose(least_squares(LINE, [-1.5], cliff, n_starts=8).theta, 0.3, atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_steps_to_where_the_model_has_no_value_are_taken_back(bad):
    """Newton's first step on a logarithm, from 1.8, goes past its pole at 0; the root is at 0.1."""

    def pole(theta):
        return np.array([np.log(theta[0] / 0.1) if theta[0] > 0.0 else bad, 0.0])

    asked_of, asked = recorded(pole)
    estimator = LeastSquares(LINE, np.array([1.8]), np.random.default_rng(0))
    estimator.solve(asked_of)
    assert min(asked)[0] <= 0.0
    assert_allclose(estimator.estimate().theta, 0.1, rtol=1e-6)


TIMES = np.linspace(0.0, 1.0, 30)
UNIT = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))
SLOPES = np.column_stack([TIMES, TIMES**2]) / 0.05
TRUTH = np.array([0.3, 0.6])


class Failing:
    """A window of which a candidate that fails is one number, as of roll-outs and of objectives of the user's."""

    n_model_calls = 0
    is_rescoring_cheap, is_ready = False, True

    def __init__(self, fails):
        self._fails = fails

    def residual(self, theta):
        return np.array([np.nan]) if self._fails(theta) else SLOPES @ (theta - TRUTH)

    def residuals(self, thetas):
        return [self.residual(theta) for theta in thetas]


def at_half(theta):
    return bool(np.abs(theta - 0.5).max() < 5e-4)


@pytest.mark.parametrize("n_starts", [1, 4])
def test_where_only_the_start_fails_it_begins_beside_it(n_starts):
    estimator = LeastSquares(
        UNIT, np.array([0.5, 0.5]), np.random.default_rng(0), LeastSquaresSettings(n_starts=n_starts)
    )
    estimator.solve(Objective(Failing(at_half), None, 200))
    assert_allclose(estimator.estimate().theta, TRUTH, atol=1e-6)
    assert_allclose(estimator.estimate().std, np.sqrt(np.diag(np.linalg.inv(SLOPES.T @ SLOPES))), rtol=1e-3)


@pytest.mark.parametrize("make", [LeastSquares, MovingHorizon])
def test_a_neighbour_without_a_value_says_nothing_of_the_slope(make):
    """It fails beyond 0.4, of which the start is within a step; the other side has a value."""
    estimator = make(UNIT, np.array([0.4 - 5e-9, 0.5]), np.random.default_rng(0))
    estimator.solve(Objective(Failing(lambda theta: theta[0] > 0.4), None, 200))
    estimate = estimator.estimate()
    assert np.all(np.abs(estimate.theta - TRUTH) < 0.5 * estimate.std)
    assert np.all(estimate.std > 0.9 * np.sqrt(np.diag(np.linalg.inv(SLOPES.T @ SLOPES))) * (make is LeastSquares))
    assert np.all(estimate.std > 0.05)


@pytest.mark.parametrize("name", ["max_evaluations", "n_starts", "identifiable_below"])
def test_settings_of_least_squares_are_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        LeastSquaresSettings(**{name: 0})


# --- the noisy norm --------------------------------------------------------------------------------------------------

MINIMIZERS = ["SLSQP", "trust-constr", "ipopt"]
FLAT = pytest.mark.filterwarnings("ignore:delta_grad == 0.0:UserWarning")
"""SciPy's trust-constr warns where two slopes are equal to the last bit, and goes on."""


@pytest.fixture(params=MINIMIZERS)
def minimizer(request):
    if request.param == "ipopt":
        pytest.importorskip("cyipopt")
    return request.param


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_what_is_minimised_is_the_norm_with_fresh_noise_at_each_evaluation(monkeypatch, noise):
    """3-4-0 has norm 5. Kolmogorov and Smirnov against that normal distribution."""
    values = []

    def take(function, x0, **_):
        values.extend(function(x0) for _ in range(2000))
        return type("Result", (), {"x": x0, "fun": values[-1]})

    monkeypatch.setattr(optimize, "minimize", take)
    estimate, asked = noisy_norm(LINE, [0.5], lambda theta: np.array([3.0, -4.0, 0.0]), noise=noise)
    assert (len(asked), estimate.n_evaluations, estimate.cost) == (2000, 2000, values[-1])
    if noise:
        assert kstest(values, "norm", args=(5.0, noise)).pvalue > 0.01
    else:
        assert set(values) == {5.0}


def test_where_the_model_has_no_value_the_norm_is_a_large_number(monkeypatch):
    """Optimisers need one; NaN would compare as no worse than anything."""

    def take(function, x0, **_):
        return type("Result", (), {"x": x0, "fun": function(x0)})

    monkeypatch.setattr(optimize, "minimize", take)
    estimate, _ = noisy_norm(LINE, [0.5], lambda theta: np.array([np.nan, 1.0]), noise=0.0)
    assert estimate.cost == 1e12


def bowl(theta):
    """Norm hypot(x - 0.6, 1/2): smooth, symmetric about its minimum."""
    return np.array([theta[0] - 0.6, 0.5])


@FLAT
def test_without_noise_the_minimum_of_one_parameter_is_found(minimizer):
    """To some 1e-4: the methods stop at slopes of 1e-6 to 1e-8, taken by differences."""
    estimate, asked = noisy_norm(LINE, [-1.2], bowl, minimizer=minimizer, noise=0.0)
    assert_allclose(estimate.theta, 0.6, atol=1e-3)
    assert_allclose(estimate.cost, 0.5, rtol=1e-5)
    assert estimate.n_evaluations == len(asked) > 2
    assert_allclose(asked[0], -1.2, rtol=1e-12)
    assert (estimate.reason, estimate.std.tolist()) == (minimizer, [4.0])


def test_a_wide_step_takes_its_slopes_over_that_share_of_the_bounds():
    """Each slope pairs a place with the one 0.05 of the bounds, 0.2, above it."""
    _, asked = noisy_norm(LINE, [-1.2], bowl, noise=0.0, difference_step=0.05)
    steps = np.diff(np.unique(asked))
    assert np.sum(np.isclose(steps, 0.2, rtol=1e-9)) >= 2
    assert np.min(steps) > 1e-6  # and none of the minimizer's own


@pytest.mark.parametrize("noise", [0.0, 3.2e-3])
@pytest.mark.parametrize("difference_step", [0.05, 0.5])
@pytest.mark.parametrize("corner", [-1.0, 0.0, 1.0])
@FLAT
def test_a_wide_step_stays_inside_the_bounds(minimizer, noise, difference_step, corner):
    """Ipopt itself relaxes bounds by 1e-8."""
    centre, half = np.array([1.0, 0.0]), np.array([1.0, 5.0])
    _, asked = noisy_norm(
        PLANE, centre + corner * half, lambda theta: np.array([*(theta - [1.4, 2.0]), 0.5]), minimizer=minimizer,
        noise=noise, difference_step=difference_step, max_iterations=10,
    )  # fmt: skip
    assert np.all(np.abs(asked - centre) <= half * (1.0 + 2e-8))


def test_the_deviation_is_as_wide_as_the_bounds_in_the_parameter_s_scale():
    space = ParameterSpace((Parameter("J", 0.1, 12.0, "kg.m2", "log"), Parameter("c", -1.0, 4.0)))
    estimate = NoisyNorm(space, np.array([6.0, 0.5]), np.random.default_rng(0)).estimate()
    assert_allclose(estimate.std, [6.0 * np.log(12.0 / 0.1), 5.0])


@FLAT
def test_each_solve_starts_from_the_nominal_parameters(minimizer):
    """Not from the last result, nor from where an episode begins."""
    settings = NormSettings(minimizer, noise=0.0)
    estimator = NoisyNorm(LINE, np.array([-1.2]), np.random.default_rng(0), settings)
    results = []
    for _ in range(3):
        asked_of, asked = recorded(bowl)
        estimator.solve(asked_of)
        assert_allclose(asked[0], -1.2, rtol=1e-12)
        results.append(float(estimator.estimate().theta[0]))
        estimator.restart(np.array([1.7]))
        assert estimator.estimate().n_evaluations == 0
    assert abs(results[0] - 0.6) < 1e-3
    assert len(set(results)) == 1


@FLAT
def test_a_model_without_a_value_does_not_break_it(minimizer):
    nowhere, _ = noisy_norm(LINE, [-1.2], lambda theta: np.full(2, np.nan), minimizer=minimizer, max_iterations=5)
    assert -2.0 <= nowhere.theta[0] <= 2.0
    # A cliff 0.3 beside the minimum, at -1: from the other side of it no method passes into it.
    beside, _ = noisy_norm(
        LINE, [1.5], lambda theta: np.array([theta[0] + 0.7, 0.5]) * (np.nan if theta[0] < -1.0 else 1.0),
        minimizer=minimizer, noise=0.0,
    )  # fmt: skip
    assert -1.0 <= beside.theta[0] <= 1.5


TRUE = {"m": 1.365, "J_x": 3.464, "J_y": 3.464, "J_z": 6.764}
NOMINAL = np.array([1.25, 1.1, 1.1, 2.2])
BODY = ParameterSpace((
    Parameter("m", 0.5, 4.0, "kg", "log"),
    *(Parameter(f"J_{axis}", 0.1, 12.0, "kg.m2", "log") for axis in "xyz"),
))  # fmt: skip
CHANNELS = (3, 4, 5, 15, 16, 17)


def quadrotor_results(n_seeds, **settings):
    """Results (n, 4) on one exact sample of a quadrotor that turns, as at the paper's t = 1.5 s."""
    R = Rotation.from_euler("xyz", [0.15, -0.2, 0.1]).as_matrix().ravel()
    x, u = (0.0, 0.0, 0.0, 1.0, 1.0, 0.3, *R, 0.4, -0.5, 0.6), (13.0, 0.5, -0.8, 0.4)
    xdot = quadrotor.derivative(x, u, **TRUE)
    residual = DerivativeResidual(quadrotor.derivative, BODY, CHANNELS, (1.0,) * 6)
    seen = Sample(1.5, x, u, tuple(xdot[i] for i in CHANNELS))
    return np.array([
        noisy_norm(BODY, NOMINAL, lambda theta: residual(theta, seen), seed, **settings)[0].theta
        for seed in range(n_seeds)
    ])  # fmt: skip


def errors(thetas):
    """Errors of the mass [kg] and, in norm, of the inertia [kg m^2]."""
    off = thetas - np.array(list(TRUE.values()))
    return np.abs(off[:, 0]), np.linalg.norm(off[:, 1:], axis=1)


def test_sqp_stays_at_the_nominal_parameters_as_in_the_papers_table():
    """Noise of 3.2e-3 over a step of 1.5e-8: slopes of 3e5 of either sign, where the true ones are of order one.

    The table prints an inertia error of 5.662 and an unmoved theta; |J - J_nominal| = 5.657, |m - m_nominal| = 0.115.
    Over 60 seeds, measured: 5.57 to 5.67, and 0.096 to 0.117.
    """
    results = quadrotor_results(60)
    mass, inertia = errors(results)
    moved = np.linalg.norm(BODY.to_unit(results) - BODY.to_unit(NOMINAL), axis=1)
    assert np.quantile(moved, 0.9) < 0.02
    assert abs(np.median(inertia) - 5.66) < 0.05
    assert abs(np.median(mass) - 0.115) < 0.01
    # Without noise the same method on the same norm goes far: it is the noise that holds it.
    free = quadrotor_results(1, noise=0.0)
    assert np.linalg.norm(BODY.to_unit(free[0]) - BODY.to_unit(NOMINAL)) > 0.3
    assert errors(free)[0][0] < 0.01


def test_a_wide_step_sees_the_mass_through_the_noise():
    """Half the seeds are within 0.02 kg; the slope of the norm in the mass is of order ten."""
    mass, _ = errors(quadrotor_results(60, difference_step=0.05))
    assert np.median(mass) < 0.04


def test_settings_of_the_noisy_norm_are_checked():
    with pytest.raises(ValueError, match="noise must not be negative, got -1"):
        NormSettings(noise=-1.0)
    with pytest.raises(ValueError, match=r"difference_step must be in \[0, 0\.5\], got -0\.1"):
        NormSettings(difference_step=-0.1)
    with pytest.raises(ValueError, match="max_iterations must be positive, got 0"):
        NormSettings(max_iterations=0)


class Costly:
    """A window whose residuals cost much: what least squares and the norms do within a budget. Keeps the batches."""

    is_rescoring_cheap = False

    def __init__(self, residual):
        self._residual, self.batches = residual, []

    def residual(self, theta):
        return self.residuals([theta])[0]

    def residuals(self, thetas):
        self.batches.append(len(thetas))
        return [self._residual(theta) for theta in thetas]


def test_differences_of_costly_residuals_are_taken_at_a_time_and_lead_to_the_regression():
    y = X @ [0.9, 1.3]
    window = Costly(lambda theta: (y - X @ theta) / SIGMA)
    estimator = LeastSquares(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0))
    estimator.solve(Objective(window, None, 30))
    assert_allclose(estimator.estimate().theta, [0.9, 1.3], atol=1e-6)
    assert set(window.batches) == {1, 2}
    assert sum(window.batches) <= 30
    std = SIGMA * np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    assert_allclose(estimator.estimate().std, std, rtol=1e-4)


@pytest.mark.parametrize("n", [1, 2, 4, 7, 30])
def test_no_more_costly_residuals_are_taken_than_the_budget_has(n):
    for make in (
        lambda: LeastSquares(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0), LeastSquaresSettings(n_starts=5)),
        *(
            lambda m=m: NoisyNorm(PLANE, np.array([0.1, 4.0]), np.random.default_rng(0), NormSettings(m, 0.0))
            for m in ("SLSQP", "trust-constr")
        ),
    ):
        asked = []
        window = Costly(lambda theta, asked=asked: asked.append(theta) or valley(theta))
        objective, estimator = Objective(window, None, n), make()
        estimator.solve(objective)
        assert objective.n_evaluations == len(asked) <= n
        best = min(float(np.sum(valley(theta) ** 2)) for theta in asked)
        if objective.is_spent:
            cost = estimator.estimate().cost
            assert_allclose(cost if estimator.is_whitened else cost**2, best, rtol=1e-9)
