"""The paper's estimator: one noisy norm, nothing kept between episodes."""

import numpy as np
import pytest
from scipy.stats import kstest

from estimator import NoEstimateError, PaperBO, PaperSettings, Parameter, ParameterSpace

LINE = ParameterSpace((Parameter("x", -1.0, 3.0),))
SQUARE = ParameterSpace((Parameter("a", 0.0, 2.0), Parameter("b", 0.01, 100.0, "kg", "log")))


def run(estimator, residual, n):
    asked = []
    for _ in range(n):
        asked.append(estimator.ask())
        estimator.tell(asked[-1], residual(asked[-1]))
    return np.array(asked)


def test_each_candidate_is_told_the_norm_plus_noise_of_the_stated_deviation():
    """3-4-0 has norm 5. The cost of a single candidate is what was told of it."""
    estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0), PaperSettings(noise=0.02))
    told = []
    for _ in range(2000):
        estimator.restart(np.zeros(1))
        estimator.tell(np.array([1.0]), np.array([3.0, -4.0, 0.0]))
        told.append(estimator.estimate().cost)
    # Kolmogorov and Smirnov against the normal with these two moments; a wrong deviation by 10 % has p < 1e-4.
    assert kstest(told, "norm", args=(5.0, 0.02)).pvalue > 0.01


def test_noise_is_added_at_each_evaluation_of_the_same_candidate():
    estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0))
    costs = []
    for _ in range(20):
        estimator.tell(np.array([1.0]), np.array([5.0]))
        costs.append(estimator.estimate().cost)
    assert costs == sorted(costs, reverse=True)
    assert 3 <= len(set(costs)) < 20
    assert all(abs(c - 5.0) < 5 * 3.2e-3 for c in costs)


def test_the_design_that_begins_an_episode_is_random_in_the_cube():
    asked = []
    for seed in range(200):
        estimator = PaperBO(SQUARE, np.array([1.0, 1.0]), np.random.default_rng(seed))
        asked.append(run(estimator, lambda theta: theta, 5))
    z = SQUARE.to_unit(np.array(asked))
    assert len(np.unique(z)) == z.size
    for values in z.reshape(-1, 2).T:
        assert kstest(values, "uniform").pvalue > 0.01


def test_an_episode_starts_from_nothing():
    estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0))
    before = run(estimator, lambda theta: theta - 1.3, 9)
    assert estimator.estimate().n_evaluations == 9
    estimator.restart(np.array([0.5]))
    with pytest.raises(NoEstimateError, match="no candidate has succeeded yet"):
        estimator.estimate()
    after = run(estimator, lambda theta: theta + 100.0, 5)
    assert not np.any(np.isin(after, before))
    estimate = estimator.estimate()
    assert estimate.n_evaluations == 5
    assert estimate.cost > 50.0  # the small norms of the first episode are forgotten


@pytest.mark.parametrize("acquisition", ["ei", "pi", "lcb"])
def test_the_optimum_of_an_easy_line_is_found(acquisition):
    """|x - 1.3| in [-1, 3]: 20 random candidates would be 0.1 away on average; measured 0.01 to 0.06."""
    for seed in range(3):
        settings = PaperSettings(acquisition=acquisition)
        estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(seed), settings)
        asked = run(estimator, lambda theta: theta - 1.3, 20)
        estimate = estimator.estimate()
        assert abs(estimate.theta[0] - 1.3) < 0.1
        assert estimate.theta[0] in asked
        assert abs(estimate.cost - abs(estimate.theta[0] - 1.3)) < 4 * 3.2e-3
        assert np.all((asked >= -1.0) & (asked <= 3.0))
        assert np.median(np.abs(asked[10:] - 1.3)) < np.median(np.abs(asked[:5] - 1.3))


def test_acquisitions_differ_in_what_they_ask():
    asked = {}
    for acquisition in ("ei", "pi", "lcb"):
        estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0), PaperSettings(acquisition=acquisition))
        asked[acquisition] = run(estimator, lambda theta: theta - 1.3, 9)[:, 0]
    for a, b in (("ei", "pi"), ("ei", "lcb"), ("pi", "lcb")):
        np.testing.assert_array_equal(asked[a][:5], asked[b][:5])
        assert np.any(asked[a][5:] != asked[b][5:])


def test_the_same_seed_gives_the_same_run_bit_for_bit():
    runs = [
        run(PaperBO(SQUARE, np.array([1.0, 1.0]), np.random.default_rng(3)), lambda t: t - [1.2, 3.0], 10).tobytes()
        for _ in range(2)
    ]
    assert runs[0] == runs[1]
    other = run(PaperBO(SQUARE, np.array([1.0, 1.0]), np.random.default_rng(4)), lambda t: t - [1.2, 3.0], 10)
    assert other.tobytes() != runs[0]


def test_numpys_global_random_state_is_left_alone():
    before = np.random.get_state()  # noqa: NPY002
    run(PaperBO(LINE, np.zeros(1), np.random.default_rng(0)), lambda theta: theta - 1.3, 8)
    after = np.random.get_state()  # noqa: NPY002
    assert before[0] == after[0]
    np.testing.assert_array_equal(before[1], after[1])
    assert before[2:] == after[2:]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_candidate_that_failed_counts_and_is_left_out(bad):
    estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0))
    estimator.tell(np.array([0.0]), np.array([bad]))
    with pytest.raises(NoEstimateError, match="no candidate has succeeded yet"):
        estimator.estimate()
    estimator.tell(np.array([1.0]), np.array([2.0]))
    estimate = estimator.estimate()
    assert estimate.n_evaluations == 2
    assert estimate.theta[0] == 1.0


def test_where_every_candidate_failed_it_asks_on():
    estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(0))
    asked = run(estimator, lambda theta: theta * np.nan, 12)
    assert len(np.unique(asked)) == 12


def test_spread_is_as_wide_as_the_cube_before_any_model_and_shrinks_with_it():
    spreads = []
    for seed in range(9):
        estimator = PaperBO(LINE, np.zeros(1), np.random.default_rng(seed))
        run(estimator, lambda theta: theta - 1.3, 5)
        assert estimator.estimate().std[0] == 4.0
        run(estimator, lambda theta: theta - 1.3, 15)
        spreads.append(estimator.estimate().std[0])
    assert np.median(spreads) < 0.5
