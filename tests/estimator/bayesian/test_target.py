"""Target-vector Bayesian optimisation finds what least squares finds, and says how well it is known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.stats import binom

from estimator import NoEstimateError, Parameter, ParameterSpace, ResidualWindow, TargetSettings, TargetVector
from estimator.bayesian.search import best_that_differ


def run(space, start, residual, n, seed=0, estimator=None):
    """The estimator after n evaluations, and what it asked for."""
    estimator = estimator or TargetVector(space, np.asarray(start, dtype=float), np.random.default_rng(seed))
    asked = []
    for _ in range(n):
        asked.append(estimator.ask())
        estimator.tell(asked[-1], residual(asked[-1]))
    return estimator, np.array(asked)


def logarithmic(*names):
    return ParameterSpace(tuple(Parameter(name, 0.1, 10.0, "1", "log") for name in names))


BODY = logarithmic("m", "J")
ROWS = np.random.default_rng(0).normal(size=(8, 2))
NOISE = 1e-3
DATA = ROWS @ [1.0 / 1.7, 3.0] + NOISE * np.random.default_rng(1).standard_normal(8)


def body(theta):
    """Linear in 1/m and J, as the equations of a rigid body."""
    return (DATA - ROWS @ [1.0 / theta[0], theta[1]]) / NOISE


@pytest.mark.parametrize("seed", range(3))
def test_a_model_linear_in_the_inverse_mass_gives_the_least_squares_solution(seed):
    """Least squares in (1/m, J) by QR; standard deviations of the textbook, carried over to m by m^2."""
    estimator, _ = run(BODY, (1.0, 1.0), body, 30, seed)
    estimate = estimator.estimate()
    solution = np.linalg.lstsq(ROWS, DATA, rcond=None)[0]
    theta = np.array([1.0 / solution[0], solution[1]])
    std = NOISE * np.sqrt(np.diag(np.linalg.inv(ROWS.T @ ROWS))) * [theta[0] ** 2, 1.0]
    # A tenth of what the data leave open; measured 0.002 to 0.02.
    assert np.all(np.abs(estimate.theta - theta) < 0.1 * std)
    # The slopes are those of a GP on thirty points: measured within 3 %.
    assert_allclose(estimate.std, std, rtol=0.2)
    assert_allclose(estimate.cost, np.sum(body(theta) ** 2), atol=0.02)
    assert estimate.is_identifiable == (True, True)
    assert (estimate.n_evaluations, estimate.reason) == (30, "incumbent")


@pytest.mark.parametrize("seed", range(3))
def test_rosenbrocks_valley_is_followed_to_its_end(seed):
    """Minimum at (1, 1), with residuals in units of 0.1."""
    space = ParameterSpace((Parameter("a", -2.0, 2.0), Parameter("b", -1.0, 3.0)))

    def rosenbrock(theta):
        return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]]) / 0.1

    estimator, _ = run(space, (-1.2, 1.0), rosenbrock, 40, seed)
    estimate = estimator.estimate()
    # A hundredth of the standard deviations 0.1 and 0.2; measured 1e-6.
    assert_allclose(estimate.theta, [1.0, 1.0], atol=1e-3)
    # J = [[-200, 100], [-10, 0]]: (J^T J)^-1 has 0.01 and 0.0401 on its diagonal.
    assert_allclose(estimate.std, [0.1, 0.2002], rtol=0.2)


TIMES = np.linspace(0.0, 3.0, 25)
WAVE = logarithmic("a", "b", "c", "d")
WAVE_TRUTH = np.array([2.0, 0.5, 1.0, 5.0])


def wave(theta, noise=0.0):
    """A decay and an oscillation sampled with noise of 0.01."""

    def signal(p):
        return p[0] * np.exp(-p[1] * TIMES) + p[2] * np.cos(p[3] * TIMES / 3.0)

    return (signal(WAVE_TRUTH) - signal(theta)) / 0.01 + noise


@pytest.mark.parametrize("seed", range(2))
def test_a_nonlinear_problem_of_four_dimensions_is_solved(seed):
    """Truth by Levenberg and Marquardt from the true parameters, on noisy data."""
    noise = np.random.default_rng(50 + seed).standard_normal(25)
    truth = least_squares(lambda p: wave(p, noise), WAVE_TRUTH, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    std = np.sqrt(np.diag(np.linalg.inv(truth.jac.T @ truth.jac)))
    estimator, _ = run(WAVE, np.ones(4), lambda p: wave(p, noise), 60, seed)
    estimate = estimator.estimate()
    assert np.all(np.abs(estimate.theta - truth.x) < 0.3 * std)
    assert_allclose(estimate.std, std, rtol=0.35)


def test_the_same_seed_gives_the_same_run_bit_for_bit():
    runs = [run(BODY, (1.0, 1.0), body, 20, seed=7) for _ in range(2)]
    assert runs[0][1].tobytes() == runs[1][1].tobytes()
    first, second = (estimator.estimate() for estimator, _ in runs)
    assert (first.theta.tobytes(), first.std.tobytes()) == (second.theta.tobytes(), second.std.tobytes())
    assert run(BODY, (1.0, 1.0), body, 20, seed=8)[1].tobytes() != runs[0][1].tobytes()


def test_numpys_global_random_state_is_left_alone():
    before = np.random.get_state()  # noqa: NPY002
    run(BODY, (1.0, 1.0), body, 15)
    after = np.random.get_state()  # noqa: NPY002
    np.testing.assert_array_equal(before[1], after[1])
    assert before[2:] == after[2:]


def test_candidates_are_inside_the_bounds_and_the_start_comes_first():
    _, asked = run(BODY, (0.7, 4.0), body, 25)
    assert_allclose(asked[0], [0.7, 4.0], rtol=1e-14)
    assert np.all((asked >= 0.1) & (asked <= 10.0))


def test_an_optimum_just_outside_the_bounds_gives_a_value_on_them():
    """50 standard deviations outside: the misfit raises the threshold to 150, and 200 are asked for."""
    space = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))
    estimator, _ = run(space, (0.5, 0.5), lambda t: (np.array([1.05, 0.3]) - t) / 1e-3, 25)
    assert_allclose(estimator.estimate().theta, [1.0, 0.3], atol=1e-3)


def test_there_is_no_estimate_before_a_candidate_has_succeeded():
    estimator = TargetVector(BODY, np.ones(2), np.random.default_rng(0))
    with pytest.raises(NoEstimateError, match="no candidate has succeeded yet: tell the residual of one first"):
        estimator.estimate()
    estimator.tell(estimator.ask(), np.full(8, np.nan))
    with pytest.raises(NoEstimateError, match="no candidate has succeeded yet"):
        estimator.estimate()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf], ids=str)
def test_a_candidate_that_failed_counts_and_is_left_out(bad):
    """The best place is 0.02 from where one row of eight fails; the optimum is found all the same."""

    def brittle(theta):
        return np.where(np.arange(8) == 3, bad, 0.0) + body(theta) if theta.max() > 3.02 else body(theta)

    estimator, asked = run(BODY, (1.0, 1.0), brittle, 32)
    failed = asked.max(axis=1) > 3.02
    assert 1 <= failed.sum() <= 4  # of 32; 27 where failures are forgotten
    np.testing.assert_array_equal(estimator.candidates, asked[~failed])
    estimate = estimator.estimate()
    assert estimate.n_evaluations == 32
    assert_allclose(estimate.theta, [1.7, 3.0], atol=5e-3)  # five standard deviations of the data


def test_where_the_start_fails_the_slopes_are_learnt_around_the_first_success():
    def brittle(theta):
        return np.full(8, np.nan) if theta[0] < 0.5 else body(theta)

    estimator, asked = run(BODY, (0.2, 1.0), brittle, 40)
    first = int(np.argmax(asked[:, 0] >= 0.5))
    step = np.exp(0.1 * np.log(100.0))
    assert first >= 1
    assert_allclose(np.abs(np.log(asked[first + 1] / asked[first])), [np.log(step), 0.0], rtol=1e-9, atol=1e-9)
    assert_allclose(estimator.estimate().theta, [1.7, 3.0], atol=5e-3)


def test_an_episode_that_all_failed_leaves_no_trace_in_the_next_answer():
    """What a failed candidate was told is not what the model sees: same candidates, same estimate."""
    one, _ = run(BODY, (1.0, 1.0), body, 12)
    other, _ = run(BODY, (1.0, 1.0), body, 12)
    other.tell(np.array([5.0, 5.0]), np.full(8, np.nan))
    a, b = one.estimate(), other.estimate()
    assert (a.theta.tobytes(), a.std.tobytes(), a.cost) == (b.theta.tobytes(), b.std.tobytes(), b.cost)
    assert (a.n_evaluations, b.n_evaluations) == (12, 13)


def test_rescoring_replaces_what_was_told():
    estimator, asked = run(BODY, (1.0, 1.0), body, 20)
    np.testing.assert_array_equal(estimator.candidates, asked)

    def moved(theta):
        return (np.array([0.4, 6.0, 1.0]) - [theta[0], theta[1], theta[0] * theta[1] / 2.4]) / 1e-3

    def same(theta):
        return (np.array([1.7, 3.0, 2.125]) - [theta[0], theta[1], theta[0] * theta[1] / 2.4]) / 1e-3

    # The same optimum, three rows now, eight before: nothing is held, and the estimate is the best candidate.
    costs = np.array([np.sum(same(theta) ** 2) for theta in asked])
    estimator.rescore(np.array([same(theta) for theta in asked]))
    np.testing.assert_array_equal(estimator.candidates, asked)
    estimate = estimator.estimate()
    assert estimate.reason == "incumbent"
    assert_allclose(estimate.theta, asked[np.argmin(costs)], rtol=1e-12)
    assert_allclose(estimate.cost, costs.min(), rtol=1e-14)
    assert estimate.n_evaluations == 20
    # Another optimum, far from every candidate: the cost is of the theta returned, three misfits at most from the best.
    costs = np.array([np.sum(moved(theta) ** 2) for theta in asked])
    estimator.rescore(np.array([moved(theta) for theta in asked]))
    assert estimator.estimate().cost <= costs.min() * (1.0 + 3.0**2 / (3 - 2)) * (1.0 + 1e-12)
    # And goes on from there.
    estimator, _ = run(None, None, moved, 20, estimator=estimator)
    estimate = estimator.estimate()
    assert np.sum(moved(estimate.theta) ** 2) < 1.0
    assert_allclose(estimate.cost, np.sum(moved(estimate.theta) ** 2), atol=0.02)


def test_rescoring_drops_the_candidates_that_fail_now():
    estimator, asked = run(BODY, (1.0, 1.0), body, 12)
    residuals = np.array([body(theta) for theta in asked])
    residuals[::3, 2] = np.nan
    estimator.rescore(residuals)
    np.testing.assert_array_equal(estimator.candidates, np.delete(asked, np.s_[::3], axis=0))
    assert np.isfinite(estimator.estimate().cost)


def test_a_restart_keeps_the_first_candidates_the_best_that_differ_and_the_newest():
    estimator = TargetVector(BODY, np.ones(2), np.random.default_rng(0), TargetSettings(n_modelled=3))
    _, asked = run(None, None, body, 30, estimator=estimator)
    residuals = np.array([body(theta) for theta in asked])
    best: list[int] = []
    for i in 3 + np.argsort(np.sum(residuals[3:] ** 2, axis=1)):
        if len(best) < 3 and all(np.linalg.norm(residuals[i] - residuals[j]) >= 1.0 for j in best):
            best.append(int(i))
    estimator.restart(np.array([2.0, 2.0]))
    np.testing.assert_array_equal(estimator.candidates, asked[sorted({0, 1, 2, *best, 28, 29})])
    assert estimator.estimate().n_evaluations == 0
    assert_allclose(estimator.ask(), [2.0, 2.0], rtol=1e-14)


@pytest.mark.parametrize("n", range(1, 5))
def test_a_restart_after_a_few_candidates_keeps_them_all(n):
    estimator, asked = run(BODY, (1.2, 1.2), body, n)
    estimator.restart(np.array([2.0, 2.0]))
    np.testing.assert_array_equal(estimator.candidates, asked)


@pytest.mark.parametrize("is_rescored", [True, False])
def test_an_endless_episode_keeps_a_bounded_number_of_candidates(is_rescored):
    estimator, _ = run(BODY, (1.2, 1.2), body, 4)
    for _ in range(200):
        theta = estimator.ask()
        estimator.tell(theta, body(theta))
        if is_rescored:
            estimator.rescore(np.array([body(theta) for theta in estimator.candidates]))
        assert len(estimator.candidates) <= 128
    assert_allclose(estimator.estimate().theta, [1.7, 3.0], atol=5e-3)


def test_slopes_are_learnt_one_parameter_at_a_time_towards_the_middle():
    """0.2 of the cube shared by two parameters: 0.1 of ln 100."""
    _, asked = run(BODY, (0.5, 4.0), body, 3)
    step = np.exp(0.1 * np.log(100.0))
    assert_allclose(asked, [[0.5, 4.0], [0.5 * step, 4.0], [0.5, 4.0 / step]], rtol=1e-12)


def jumped(theta):
    return (ROWS @ [1.0 / 4.0, 0.8] - ROWS @ [1.0 / theta[0], theta[1]]) / NOISE


def test_a_jump_within_an_episode_makes_it_learn_the_slopes_anew_around_the_best():
    estimator, asked = run(BODY, (1.2, 1.2), body, 25)
    residuals = np.array([jumped(theta) for theta in asked])
    estimator.rescore(residuals)
    best = asked[np.argmin(np.sum(residuals**2, axis=1))]
    step = np.exp(0.1 * np.log(100.0))
    first, second = estimator.ask(), estimator.ask()
    assert_allclose(first / best, [step if best[0] < 1.0 else 1.0 / step, 1.0], rtol=1e-9)
    assert_allclose(second / best, [1.0, step if best[1] < 1.0 else 1.0 / step], rtol=1e-9)
    for theta in (first, second):
        estimator.tell(theta, jumped(theta))
    estimator.rescore(np.array([jumped(theta) for theta in estimator.candidates]))  # no jump: no slopes again
    estimator, _ = run(None, None, jumped, 12, estimator=estimator)
    assert_allclose(estimator.estimate().theta, [4.0, 0.8], rtol=0.01)


def test_a_start_that_explains_the_data_is_not_probed_again():
    estimator, _ = run(BODY, (1.0, 1.0), body, 25)
    start = estimator.estimate().theta
    estimator.restart(start)
    _, asked = run(None, None, body, 3, estimator=estimator)
    assert np.all(np.abs(np.log(asked[1:] / start)) < 0.1 * np.log(100.0) / 2.0)


def test_of_candidates_that_differ_by_less_than_a_standard_deviation_the_best_is_taken():
    residuals = np.array([[3.0, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, 1.1], [3.5, 0.0], [9.0, 9.0]])
    assert best_that_differ(residuals, 9) == [2, 3, 0, 5]
    assert best_that_differ(residuals, 2) == [2, 3]


def test_a_jump_is_followed_after_a_restart_and_a_rescore():
    estimator, asked = run(BODY, (1.0, 1.0), body, 25)
    start = estimator.estimate().theta
    estimator.restart(start)
    estimator.rescore(np.array([jumped(theta) for theta in estimator.candidates]))
    estimator, asked = run(None, None, jumped, 15, estimator=estimator)
    assert_allclose(asked[0], start, rtol=1e-12)
    estimate = estimator.estimate()
    # Two standard deviations of the data, from half the evaluations.
    assert np.sum(jumped(estimate.theta) ** 2) < 4.0
    assert_allclose(estimate.theta, [4.0, 0.8], rtol=0.01)
    assert estimate.n_evaluations == 15


def test_data_that_say_nothing_hold_the_start_exactly():
    """A residual that no parameter moves: every direction is held, whatever the candidates."""
    estimator, _ = run(BODY, (0.7, 4.0), lambda theta: np.array([1.0, -0.5, 0.3]), 20)
    estimate = estimator.estimate()
    assert_allclose(estimate.theta, [0.7, 4.0], rtol=1e-14)
    assert estimate.is_identifiable == (False, False)
    assert estimate.reason == "incumbent, 2 of 2 directions held"
    # As wide as the bounds: ln(100) theta on the scale of the parameter.
    assert_allclose(estimate.std, np.log(100.0) * np.array([0.7, 4.0]), rtol=1e-6)


def test_changes_inside_the_noise_are_held_exactly():
    """The optimum is half a standard deviation from the start."""
    start = np.array([1.0, 1.0])
    estimator, _ = run(BODY, start, lambda t: (np.array([1.05, 0.95]) - t) / 0.1, 25)
    estimate = estimator.estimate()
    assert_allclose(estimate.theta, start, rtol=1e-14)
    assert "2 of 2 directions held" in estimate.reason


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_parameter_that_the_data_do_not_see_stays_at_its_start(seed):
    """Held along the directions of a fitted GP: they lean by 1e-3, and so does the held parameter, of 4.6 e-folds."""
    estimator, _ = run(BODY, (1.0, 2.0), lambda t: np.full(5, (3.0 - t[0]) / 0.01), 30, seed)
    estimate = estimator.estimate()
    assert_allclose(estimate.theta[0], 3.0, atol=0.02)
    assert_allclose(estimate.theta[1], 2.0, rtol=5e-3)
    assert not estimate.is_identifiable[1]
    assert estimate.reason == "incumbent, 1 of 2 directions held"


def test_where_only_the_product_is_seen_the_product_is_right():
    """a b = 6 to 0.1 %; the estimate holds the ratio, and must explain the data as the incumbent does."""
    products = []
    for seed in range(3):
        estimator, _ = run(BODY, (1.0, 2.0), lambda t: np.full(5, (6.0 - t[0] * t[1]) / 0.01), 30, seed)
        products.append(np.prod(estimator.estimate().theta))
    assert_allclose(products, 6.0, atol=0.05)  # five standard deviations


def test_where_only_the_product_is_seen_neither_factor_is_identifiable():
    estimator, _ = run(BODY, (1.0, 2.0), lambda t: np.full(5, (6.0 - t[0] * t[1]) / 0.01), 30)
    estimate = estimator.estimate()
    assert estimate.is_identifiable == (False, False)
    assert "1 of 2 directions held" in estimate.reason
    assert np.all(estimate.std > estimate.theta)


@pytest.mark.full
def test_intervals_of_95_percent_cover_as_often():
    """A linear problem with Gaussian noise and changes of more than ten standard deviations in every direction.

    (Changes near the threshold of three are held at the start, and their intervals cover less.)
    """
    space = ParameterSpace((Parameter("a", -2.0, 2.0), Parameter("b", -2.0, 2.0)))
    X = np.random.default_rng(0).normal(size=(12, 2))
    truth, sigma, n = np.array([0.9, 0.8]), 0.05, 120
    change = np.linalg.svd(X)[2] @ truth * np.linalg.svd(X)[1] / sigma
    assert np.all(np.abs(change) > 10.0)
    covered, scatter = np.zeros(2), []
    for seed in range(n):
        data = X @ truth + sigma * np.random.default_rng(1000 + seed).standard_normal(12)
        estimator, _ = run(space, (0.0, 0.0), lambda t, data=data: (data - X @ t) / sigma, 18, seed)
        estimate = estimator.estimate()
        covered += np.abs(estimate.theta - truth) < 1.96 * estimate.std
        scatter.append((estimate.theta - truth) / estimate.std)
    # Misfits above one widen the intervals and never narrow them: some 96 %. Binomial limits of 1e-4 on either side.
    assert np.all(covered >= binom.ppf(1e-4, n, 0.95))
    assert np.all(covered <= binom.ppf(1.0 - 1e-4, n, 0.97))
    # The error in standard deviations: one, less what a misfit widens; 1/sqrt(240) = 6.5 % is its own error.
    assert np.all((np.std(scatter, axis=0) > 0.7) & (np.std(scatter, axis=0) < 1.2))


def test_where_the_whole_initial_design_failed_it_asks_on():
    estimator, asked = run(BODY, (1.0, 1.0), lambda theta: np.full(3, np.nan), 12)
    assert len(np.unique(asked, axis=0)) == 12
    assert np.all((asked >= 0.1) & (asked <= 10.0))
    assert len(estimator.candidates) == 0


def test_where_no_candidate_outlives_a_rescore_it_asks_on():
    estimator, _ = run(BODY, (1.0, 1.0), body, 12)
    estimator.rescore(np.full((12, 8), np.nan))
    assert len(estimator.candidates) == 0
    run(None, None, body, 12, estimator=estimator)


def test_rescoring_no_candidates_changes_nothing():
    estimator = TargetVector(BODY, np.ones(2), np.random.default_rng(0))
    window = ResidualWindow(lambda theta, sample: theta, 2)
    estimator.rescore(window.residuals(estimator.candidates))
    assert estimator.candidates.shape == (0, 2)
    _, asked = run(None, None, body, 12, estimator=estimator)
    np.testing.assert_array_equal(asked, run(BODY, (1.0, 1.0), body, 12)[1])


def test_residuals_that_are_all_nil_leave_finite_scores():
    estimator, asked = run(BODY, (1.0, 1.0), lambda theta: np.zeros(3), 12)
    assert np.all((asked >= 0.1) & (asked <= 10.0))
    estimate = estimator.estimate()
    assert estimate.theta.tolist() == [1.0, 1.0]  # where nothing is seen, nothing changes
    # As wide as the cube, whose sides are ln 100, at a value of 1.
    assert_allclose(estimate.std, np.log(100.0), rtol=1e-12)
    assert 0.0 <= estimate.cost < 1e-12


def in_batches(space, start, residual, n, each, seed=0):
    """The estimator after n evaluations, asked for several at a time, and the sizes of the batches."""
    estimator, sizes = TargetVector(space, np.asarray(start, dtype=float), np.random.default_rng(seed)), []
    while n:
        batch = estimator.ask_many(min(each, n))
        sizes.append(len(batch))
        for theta in batch:
            estimator.tell(theta, residual(theta))
        n -= len(batch)
    return estimator, sizes


def test_asked_for_one_at_a_time_it_asks_the_same_as_ever():
    one_by_one, asked = run(BODY, (1.0, 1.0), body, 20)
    batched, sizes = in_batches(BODY, (1.0, 1.0), body, 20, 1)
    np.testing.assert_array_equal(batched.candidates, one_by_one.candidates)
    assert sizes == [1] * 20
    assert len(asked) == 20


@pytest.mark.parametrize("each", [2, 3, 5])
def test_asked_for_several_at_a_time_it_finds_the_same(each):
    """The start alone comes first, since the others of the initial design are made from it."""
    estimator, sizes = in_batches(BODY, (1.0, 1.0), body, 30, each)
    solution = np.linalg.lstsq(ROWS, DATA, rcond=None)[0]
    theta = np.array([1.0 / solution[0], solution[1]])
    std = NOISE * np.sqrt(np.diag(np.linalg.inv(ROWS.T @ ROWS))) * [theta[0] ** 2, 1.0]
    assert np.all(np.abs(estimator.estimate().theta - theta) < 0.1 * std)
    assert sizes[:2] == [1, 2]
    assert max(sizes) == each


def test_candidates_asked_for_at_once_differ():
    estimator, _ = in_batches(BODY, (1.0, 1.0), body, 4, 1)
    batch = np.log(estimator.ask_many(4)) / np.log(100.0)  # the cube, but for its origin
    distances = np.linalg.norm(batch[:, None] - batch, axis=2)[np.triu_indices(4, 1)]
    assert np.all(distances > 2e-4)


def test_where_every_candidate_failed_another_is_asked_for():
    estimator, _ = in_batches(BODY, (1.0, 1.0), lambda theta: np.array([np.nan]), 6, 3)
    assert len(estimator.ask_many(3)) == 1


UNIT_TIMES = np.linspace(0.0, 1.0, 30)
LINE = np.column_stack([UNIT_TIMES, UNIT_TIMES**2]) / 0.05
TRUTH = np.array([0.3, 0.6])
UNIT = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))


@pytest.mark.parametrize("size", [1e6, 1e20, 1e200])
@pytest.mark.parametrize("start", [0.46, 0.44, 0.36])
def test_candidates_at_which_the_model_diverged_leave_the_rest_as_it_was(size, start):
    """Linear, so that the least squares are the truth; beyond a = 0.45 the model has diverged, and is finite yet."""

    def residual(theta):
        return np.full(30, size) if theta[0] > 0.45 else LINE @ (theta - TRUTH)

    for seed in range(3):
        estimate = run(UNIT, [start, 0.5], residual, 40, seed)[0].estimate()
        assert np.all(np.abs(estimate.theta - TRUTH) < 2.0 * estimate.std)
        assert np.all(estimate.std > 0.8 * np.sqrt(np.diag(np.linalg.inv(LINE.T @ LINE))))


@pytest.mark.parametrize("d", [9, 10, 11, 14])
def test_the_cost_of_an_estimate_is_that_of_its_place_however_many_parameters(d):
    """Linear: d slopes and what no parameter explains make d + 1 principal components."""
    space = ParameterSpace(tuple(Parameter(f"p{k}", 0.0, 1.0) for k in range(d)))
    for seed in range(3):
        rng = np.random.default_rng(seed)
        rows, start = rng.normal(size=(10 * d, d)) * 10.0, np.full(d, 0.5)
        truth = start + np.where(np.arange(d) < 2, 0.2, 0.0)
        data = rows @ truth + rng.standard_normal(10 * d)
        target = run(space, start, lambda theta, rows=rows, data=data: data - rows @ theta, 5 * d, seed)[0]
        estimate = target.estimate()
        told = np.array([np.sum((data - rows @ theta) ** 2) for theta in target.candidates])
        assert np.sum((data - rows @ estimate.theta) ** 2) < told.min() + 1.3 * 9.0 * max(1.0, told.min() / (9 * d))
        told_there = np.sum((data - rows @ estimate.theta) ** 2)
        assert estimate.cost == pytest.approx(told_there, rel=0.15 if d == 10 else 0.05)  # ten of eleven components
