"""Fits of the hypotheses, and their comparison, against NumPy's and SciPy's least squares and Monte Carlo."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.stats import chi2

from estimator import hypotheses
from estimator.differences import OfMany
from estimator.hypotheses import (
    FALSE_ALARM,
    MARGIN,
    NEVER,
    Fit,
    Weighing,
    changed_parameters,
    cubic_disturbance,
    disturbance_of,
    plain_fit,
)

MIDDLE = np.array([0.5, 0.5])


def line_design(n):
    """Explicit regressors (n, 2) of a straight line in time."""
    return np.column_stack([np.ones(n), np.arange(n)])


def least_squares_of(design, rows):
    """(coefficients, sum of squares) of NumPy's least squares, channel by channel."""
    coefficients = np.linalg.lstsq(design, rows, rcond=None)[0]
    return coefficients, float(np.sum((rows - design @ coefficients) ** 2))


@pytest.mark.parametrize("n_channels", [1, 3])
def test_a_cubic_disturbance_is_numpys_least_squares(n_channels):
    rows = np.random.default_rng(n_channels).standard_normal((9, n_channels)) + np.arange(9.0)[:, None] ** 2
    missing = rows.copy()
    missing[4, 0] = 0.0
    powers = np.vander(np.arange(9.0), 4)
    whole = [least_squares_of(powers, rows[:, [c]])[1] for c in range(n_channels)]
    without = least_squares_of(np.delete(powers, 4, axis=0), np.delete(rows[:, [0]], 4, axis=0))[1]
    for found, squares, n in ((rows, whole, rows.size), (missing, [without, *whole[1:]], rows.size - 1)):
        fit = cubic_disturbance(found)
        assert_allclose((fit.squares, fit.n_free, fit.n_values), (sum(squares), 4 * n_channels, n), rtol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 8, 20])
@pytest.mark.parametrize("n_channels", [1, 3])
def test_a_constant_disturbance_is_numpys_least_squares(n, n_channels):
    rows = np.random.default_rng(n).standard_normal((n, n_channels)) + np.array([7.0, -2.0, 3.0][:n_channels])
    found = disturbance_of(rows, may_drift=False)
    coefficients, squares = least_squares_of(np.ones((n, 1)), rows)
    assert found.is_constant
    assert_allclose(found.newest, coefficients[0], rtol=1e-12)
    assert_allclose(found.fit.squares, squares, rtol=1e-10, atol=1e-12)
    assert (found.fit.n_free, found.fit.n_values) == (n_channels, n * n_channels)


@pytest.mark.parametrize("n", [3, 8, 20])
@pytest.mark.parametrize("n_channels", [1, 3])
def test_a_drifting_disturbance_is_numpys_least_squares(n, n_channels):
    rng = np.random.default_rng(n)
    rows = rng.standard_normal((n, n_channels)) + np.outer(np.arange(n), [30.0, -20.0, 40.0][:n_channels])
    found = disturbance_of(rows)
    coefficients, squares = least_squares_of(line_design(n), rows)
    assert not found.is_constant
    assert_allclose(found.newest, coefficients[0] + (n - 1) * coefficients[1], rtol=1e-10)
    assert_allclose(found.fit.squares, squares, rtol=1e-8)
    assert (found.fit.n_free, found.fit.n_values) == (2 * n_channels, n * n_channels)


def test_a_line_is_preferred_only_where_its_score_is_less():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        rows = rng.standard_normal((12, 2)) + np.outer(np.arange(12), [0.0, rng.uniform(0.0, 2.0)])
        constant = least_squares_of(np.ones((12, 1)), rows)[1]
        line = least_squares_of(line_design(12), rows)[1]
        is_line = constant > chi2.isf(FALSE_ALARM, 22) and line + 4 * np.log(24) < constant + 2 * np.log(24)
        assert disturbance_of(rows).is_constant != is_line


@pytest.mark.parametrize("n", [5, 8, 20])
@pytest.mark.parametrize("n_channels", [1, 3])
def test_a_curved_disturbance_is_numpys_least_squares(n, n_channels):
    rng = np.random.default_rng(n)
    t = np.arange(n)
    rows = rng.standard_normal((n, n_channels)) + np.outer(t**2 - 2.0 * t, [30.0, -20.0, 40.0][:n_channels])
    found = disturbance_of(rows)
    design = np.column_stack([line_design(n), t**2])
    coefficients, squares = least_squares_of(design, rows)
    assert not found.is_constant
    assert_allclose(found.newest, design[-1] @ coefficients, rtol=1e-10)
    assert_allclose(found.fit.squares, squares, rtol=1e-8)
    assert (found.fit.n_free, found.fit.n_values) == (3 * n_channels, n * n_channels)


def test_a_line_through_two_rows_is_not_tried_nor_a_parabola_through_four():
    assert disturbance_of(np.array([[0.0], [1e3]])).is_constant
    assert disturbance_of(1e3 * np.arange(4.0)[:, None] ** 2).fit.n_free < 3


def test_the_formulas_are_those_of_the_oracles(oracles):
    oracles.check_score_is_the_evidence_of_a_linear_model(hypotheses)
    oracles.check_margins_are_very_strong_evidence(hypotheses)
    oracles.check_disturbance_against_least_squares(hypotheses)


def test_missing_channels_are_neither_free_nor_values():
    rows = np.column_stack([np.zeros(9), np.random.default_rng(0).standard_normal(9) + 5.0, np.zeros(9)])
    found = disturbance_of(rows)
    assert (found.fit.n_free, found.fit.n_values) == (1, 9)
    assert_array_equal(found.newest[[0, 2]], 0.0)
    assert plain_fit(rows, 2).n_values == 9


def test_a_score_is_squares_and_the_logarithm_for_each_free_value():
    assert_allclose(Fit(12.5, 3, 40).score, 12.5 + 3.0 * np.log(40.0))
    assert_allclose(Fit(12.5, 0, 40).score, 12.5)
    assert_allclose(Fit(1.0, 1, 1).score, 1.0 + np.log(2.0))  # one value has no more evidence than two


def test_the_score_is_that_of_the_evidence_of_a_linear_model():
    """Schwarz (1978): twice the negative log evidence, but for what does not grow with n, which a difference drops.

    Marginal likelihood of n values y = m + e with m ~ N(0, 1): y ~ N(0, I + 1 1^T).
    """
    differences = []
    for n in (50, 400):
        y = np.random.default_rng(n).standard_normal(n)
        C = np.eye(n) + np.ones((n, n))
        evidence = y @ np.linalg.solve(C, y) + np.linalg.slogdet(C)[1]
        fit = disturbance_of(y[:, None], may_drift=False).fit
        differences.append(evidence - fit.score)
    assert_allclose(differences, 0.0, atol=0.1)  # m^2, the prior at the estimate


@pytest.mark.parametrize(("n", "n_free"), [(5, 0), (12, 3), (20, 10)])
def test_true_hypotheses_fail_as_often_as_declared(n, n_free):
    rng = np.random.default_rng(n)
    design = rng.standard_normal((n, n_free))
    left = np.eye(n) - (design @ np.linalg.pinv(design) if n_free else 0.0)
    n_draws = 400_000
    draws = rng.standard_normal((n_draws, n)) @ left
    squares = np.sum(draws**2, axis=1)
    limit = squares.min()
    low, high = 0.0, 1e3  # the largest sum of squares that is explained
    while high - low > 1e-9:
        limit = 0.5 * (low + high)
        low, high = (limit, high) if Fit(limit, n_free, n).is_explained else (low, limit)
    expected = FALSE_ALARM * n_draws
    assert abs(np.count_nonzero(squares > limit) - expected) < 4.0 * np.sqrt(expected)


def test_without_degrees_of_freedom_nothing_is_explained_yet_all_is_possible():
    for n_free in (3, 4):
        fit = Fit(0.0, n_free, 3)
        assert not fit.is_explained
        assert fit.is_possible
    assert not Fit(1e3, 2, 3).is_possible


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rows_without_a_value_are_never_explained(bad):
    fit = plain_fit(np.array([[0.0], [bad], [0.0]]), 1)
    assert not fit.is_explained
    assert fit.score == np.inf


def test_proof_needs_the_margin_and_possibility_does_not():
    good, n = 20.0, 20
    parameters = Fit(good, 2, n)
    rival = lambda above: Fit(parameters.score + above, 0, n)  # noqa: E731
    for above, is_proven, is_possible in (
        (MARGIN + 0.01, True, True), (MARGIN - 0.01, False, True), (-MARGIN + 0.01, False, True),
        (-MARGIN - 0.01, False, False),
    ):  # fmt: skip
        for pair in ((rival(above), rival(1e6)), (rival(1e6), rival(above))):
            weighing = Weighing(parameters, *pair)
            assert (weighing.are_parameters_proven, weighing.are_parameters_possible) == (is_proven, is_possible)
    wrong = Weighing(Fit(1e3, 2, n), Fit(1e6, 0, n), Fit(1e6, 0, n))
    assert not wrong.are_parameters_certain
    assert not wrong.are_parameters_proven
    assert not wrong.are_parameters_possible


# --- changed parameters --------------------------------------------------------------------------------------------


class Linear:
    """Rows A (z - truth) + noise, with the truth moving by `rate` from row to row; it ends at `truth`."""

    def __init__(self, n, truth, seed=0, rate=0.0, n_channels=2, noise=1.0):
        rng = np.random.default_rng(seed)
        self.A = 100.0 * rng.standard_normal((n, n_channels, 2))
        self.truth = np.asarray(truth) + np.outer(np.arange(n) - (n - 1), [rate, 0.0])
        self.e = noise * rng.standard_normal((n, n_channels))

    def __call__(self, z):
        return np.einsum("nci,ni->nc", self.A, z - self.truth) + self.e

    def flat(self, z):
        return self(z).reshape(-1)


class Curved(Linear):
    """The same of a mildly nonlinear function of z."""

    def __call__(self, z):
        there = np.broadcast_to(z, self.truth.shape)
        return np.einsum("nci,ni->nc", self.A, self.bent(there) - self.bent(self.truth)) + self.e

    @staticmethod
    def bent(z):
        return z + 0.4 * z**2 + 0.2 * np.sin(3.0 * z)


def spinning_body(z):
    """Angular accelerations of a free rigid body by Euler's equations (2, 3); its inertias are 1.2 and 3."""
    a, b = 0.1 * 100.0 ** np.asarray(z)[..., 0], 0.1 * 100.0 ** np.asarray(z)[..., 1]
    p, q, r = np.array([[3.0, -2.0, 4.0], [1.0, 5.0, -2.0]]).T
    a, b, c = a[..., None], b[..., None], 2.0
    return np.stack([(b - c) / a * q * r, (c - a) / b * r * p, (a - b) / c * p * q], axis=-1)


@pytest.mark.parametrize("start", [(0.05, 0.05), (0.95, 0.05), (0.05, 0.95), (0.95, 0.95)])
def test_changed_parameters_are_found_from_every_corner(start):
    """Undamped steps, halved where they gain nothing, end elsewhere from each of them, thousands of deviations away."""
    truth = np.log10(np.array([1.2, 3.0]) / 0.1) / 2.0
    noise = np.random.default_rng(1).standard_normal((2, 3))
    rows_at = OfMany(lambda z: (spinning_body(z) - spinning_body(truth)) / 1e-3 + noise)
    found = changed_parameters(rows_at, np.array(start))
    assert found.fit.is_explained
    assert_allclose(found.z, truth, atol=1e-3)


@pytest.mark.parametrize("problem", [Linear, Curved])
@pytest.mark.parametrize("seed", range(4))
def test_changed_parameters_are_scipys_least_squares(problem, seed):
    rows_at = problem(15, [0.8, 0.3], seed)
    truth = least_squares(rows_at.flat, MIDDLE, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = changed_parameters(rows_at, MIDDLE)
    deviations = np.sqrt(np.diag(np.linalg.inv(truth.jac.T @ truth.jac)))
    # It stops where the sum of squares gains less than 0.1: a third of a deviation; Gauss-Newton is far nearer.
    assert np.all(np.abs(found.z - truth.x) < 0.1 * deviations)
    assert_allclose(found.fit.squares, 2.0 * truth.cost, atol=0.1)
    assert_allclose(found.rows, rows_at(found.z))
    assert (found.fit.n_free, found.fit.n_values, found.rate) == (2, 30, 0.0)
    assert found.fit.is_explained


def test_parameters_that_explain_already_are_left_alone():
    rows_at = Linear(15, MIDDLE, 1)
    found = changed_parameters(rows_at, MIDDLE)
    assert_array_equal(found.z, MIDDLE)
    assert found.fit.is_explained


@pytest.mark.parametrize("rate", [0.006, -0.004])
def test_the_rate_of_a_drifting_parameter_is_found(rate):
    rows_at = Linear(20, [0.6, 0.4], 2, rate)
    found = changed_parameters(rows_at, MIDDLE)
    tau = np.repeat(np.arange(20) - 19, 2)[:, None]
    A = rows_at.A.reshape(-1, 2)
    design, target = np.hstack([A, tau * A]), -rows_at(np.zeros(2)).reshape(-1)
    usual = np.hstack([np.zeros((2, 2)), np.eye(2) / 0.0025])  # a rate is normal with this standard deviation
    best, _ = least_squares_of(np.vstack([design, usual]), np.append(target, [0.0, 0.0]))
    assert_allclose(found.fit.squares, np.sum((design @ best - target) ** 2), rtol=1e-5)
    assert_allclose(found.rate, np.abs(best[2:]).max(), rtol=1e-5)
    assert_allclose(found.rate, abs(rate), rtol=0.1)
    assert (found.fit.n_free, found.fit.is_explained) == (4, True)
    held = changed_parameters(rows_at, MIDDLE, may_drift=False)
    assert (held.rate, held.fit.n_free, held.fit.is_explained) == (0.0, 2, False)


@pytest.mark.parametrize("rate", [0.006, -0.004])
def test_the_rate_is_by_the_times_of_the_rows_where_older_ones_are_missing(rate):
    all_rows, times = Linear(30, [0.6, 0.4], 2, rate), np.array([*range(0, 16, 4), *range(16, 30)])
    found = changed_parameters(lambda z: all_rows(z)[times], MIDDLE, times.astype(float))
    assert_allclose(found.rate, abs(rate), rtol=0.1)
    assert found.fit.is_explained


@pytest.mark.parametrize(("truth", "reached"), [((1.3, 0.5), (1.3, 0.5)), ((3.0, 0.5), (1.5, None))])
def test_parameters_beyond_the_bounds_are_found_up_to_half_of_their_width(truth, reached):
    found = changed_parameters(Linear(15, truth, 3), MIDDLE, iterations=8, may_drift=False)
    assert_allclose(found.z[0], reached[0], atol=0.02)
    if reached[1] is not None:
        assert_allclose(found.z[1], reached[1], atol=0.02)
    assert found.fit.is_explained == (truth == reached)


def test_where_the_model_has_no_value_a_shorter_step_is_tried():
    """The first step, from 0.3, goes to -0.2, where the logarithm has no value; half of it goes to 0.05."""
    e = np.random.default_rng(4).standard_normal((15, 1))
    tried = []

    def rows_at(z):
        tried.append(z[0])
        return 100.0 * np.log((z + 0.01) / 0.06) + e if z[0] > 0.0 else np.full((15, 1), np.nan)

    found = changed_parameters(rows_at, np.array([0.3]), iterations=8)
    assert min(tried) < 0.0
    assert_allclose(found.z, 0.05, atol=0.001)
    assert found.fit.is_explained


@pytest.mark.parametrize("where", ["at the start", "beside it", "everywhere but there"])
def test_a_model_without_values_is_no_error(where):
    linear = Linear(15, [0.8, 0.5], 5)

    def rows_at(z):
        is_start = np.array_equal(z, MIDDLE)
        if where == "at the start" or (where == "beside it" and not is_start and np.abs(z - MIDDLE).max() < 1e-3):
            return np.full((15, 2), np.nan)
        return np.full((15, 2), np.nan) if where == "everywhere but there" and not is_start else linear(z)

    found = changed_parameters(rows_at, MIDDLE)
    assert_array_equal(found.z, MIDDLE)
    assert not found.fit.is_explained


def test_a_parameter_without_influence_stays():
    linear = Linear(15, [0.8, 0.5], 6)
    linear.A[:, :, 1] = 0.0
    found = changed_parameters(linear, np.array([0.5, 0.37]))
    assert_allclose(found.z, [0.8, 0.37], atol=0.01)
    assert found.fit.is_explained


@pytest.mark.parametrize("hypothesis", ["parameters", "disturbance", "nothing"])
def test_the_hypothesis_that_made_the_samples_wins_and_no_write_is_proven_by_another(hypothesis):
    """200 windows of 15 samples, each made by one hypothesis; the others must not win with the margin."""
    n_won = 0
    for seed in range(200):
        linear = Linear(15, [0.6, 0.45] if hypothesis == "parameters" else MIDDLE, seed)
        if hypothesis == "disturbance":
            linear.e += [12.0, -8.0]
        rows = linear(MIDDLE)
        found = changed_parameters(linear, MIDDLE)
        weighing = Weighing(found.fit, disturbance_of(rows).fit, plain_fit(rows, 0))
        n_won += weighing.are_parameters_proven
    assert n_won >= 198 if hypothesis == "parameters" else n_won == 0


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("seed", range(5))
def test_a_disturbance_is_fitted_to_the_values_that_there_are(order, seed):
    """Those that are missing are zeros: NumPy's polynomial through the others, and its sum of squares."""
    rng, t = np.random.default_rng(seed), np.linspace(-1.0, 1.0, 20)
    rows = np.outer((30.0, 30.0 * t, 40.0 * t**2)[order], (1.0, -0.5)) + rng.standard_normal((20, 2))
    rows[2::4, 0] = rows[-1, 1] = 0.0
    found = disturbance_of(rows)
    seen = [np.flatnonzero(column) for column in rows.T]
    made = [np.polynomial.Polynomial.fit(t[k], column[k], order) for k, column in zip(seen, rows.T, strict=True)]
    left = [column[k] - p(t[k]) for p, k, column in zip(made, seen, rows.T, strict=True)]
    assert found.fit.is_explained
    assert (found.fit.n_values, found.fit.n_free) == (34, 2 * (order + 1))
    assert_allclose(found.fit.squares, sum(r @ r for r in left), rtol=1e-9)
    assert_allclose(found.newest, [p(1.0) for p in made], rtol=1e-9)


def test_a_channel_that_rests_takes_no_disturbance_and_rows_that_are_not_finite_fit_none():
    rows = np.random.default_rng(0).normal(0.0, 50.0, (12, 3))
    rows[:, 1] = rows[3, 0] = 0.0
    found = disturbance_of(rows)
    assert (found.fit.n_values, found.newest[1]) == (23, 0.0)
    rows[5, 2] = np.nan
    assert not disturbance_of(rows).fit.is_possible


def test_what_cannot_be_told_is_recorded_and_what_was_not_compared_is_not():
    """A disturbance of residuals that are no numbers is compared, as far as that goes."""
    known = Fit(1.0, 2, 8)
    compared = {"parameters", "disturbance", "nothing"}
    assert Weighing(known, NEVER, known).fits.keys() == compared
    assert Weighing(known, NEVER, known, coloured=known).fits.keys() == compared | {"coloured"}
