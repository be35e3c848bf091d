"""Kalman filters, sample by sample and on episodes, and the moving horizon on episodes, against the ordinary filter."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares
from scipy.stats import chi2

from estimator import EpisodeWindow, Evaluation, Objective, Parameter, ParameterSpace, ResidualWindow, Sample
from estimator.baselines.kalman import EnsembleKalman, EnsembleSettings, UnscentedKalman, UnscentedSettings
from estimator.baselines.linearisation import ensemble
from estimator.baselines.moving_horizon import MovingHorizon, MovingHorizonSettings

LOWER, WIDTH, SIGMA = np.array([-3.0, -2.0, 0.0]), 8.0, 0.2
SPACE = ParameterSpace(tuple(Parameter(name, low, low + WIDTH) for name, low in zip("abc", LOWER, strict=True)))
START, TRUTH = np.array([1.0, 1.0, 3.0]), np.array([1.8, 0.4, 3.5])
RNG = np.random.default_rng
MADE = {
    "ukf": (UnscentedKalman, UnscentedSettings),
    "enkf": (EnsembleKalman, EnsembleSettings),
    "mhe": (MovingHorizon, MovingHorizonSettings),
}
WALL = {"ukf": 0.01, "enkf": 0.4, "mhe": 0.01}
EACH = pytest.mark.parametrize("name", MADE)


def made(name, start=START, space=SPACE, seed=0, **settings):
    cls, own = MADE[name]
    return cls(space, start, RNG(seed), own(**settings))


def samples(n, truth=TRUTH, n_rows=2, seed=0):
    rng = RNG(seed)
    H = rng.normal(size=(n, n_rows, 3))
    y = H @ truth + SIGMA * rng.standard_normal((n, n_rows))
    return [Sample(float(k), tuple(H[k].ravel()), (), tuple(y[k])) for k in range(n)]


def rows(theta, sample):
    """A model that is linear in the parameters: each sample carries its rows (c, 3) as its state."""
    return (np.array(sample.xdot) - np.reshape(sample.x, (-1, 3)) @ theta) / SIGMA


def rows_of_many(thetas, samples):
    return np.stack([(np.array(s.xdot) - thetas @ np.reshape(s.x, (-1, 3)).T) / SIGMA for s in samples], axis=1)


class RollOuts:
    """Residuals of whole episodes, a function of theta; counts how often candidates are evaluated together."""

    is_ready, is_of_outputs = True, False

    def __init__(self, function):
        self._function, self.batches = function, []

    def add_sample(self, sample):
        pass

    def snapshot(self, is_needed):
        return True

    def revert(self, theta): ...

    def move_inputs(self, moved, stretch): ...

    def accept(self, theta, stretch):
        pass

    def evaluate(self, thetas, stretch):
        self.batches.append(len(thetas))
        found = [self._function(theta, stretch.samples[1:]) for theta in thetas]
        return [Evaluation(np.array([np.nan]), "failed") if r is None else Evaluation(r) for r in found]


def solve(estimator, function, episode, budget=30):
    """Let the estimator solve one episode; returns its estimate and the sizes of the batches."""
    rollouts = RollOuts(function)
    window = EpisodeWindow(rollouts, len(episode))
    window.append(Sample(-1.0, (), (), ()))
    window.begin(START)
    for sample in episode:
        window.append(sample)
    estimator.solve(Objective(window, None, budget))
    return estimator.estimate(), rollouts.batches


def over_window(theta, episode):
    return np.concatenate([rows(theta, sample) for sample in episode])


def kalman(episode, spread, walk=0.0, n_walks=1):
    """The textbook's filter in the unit cube, sample by sample: mean and covariance after each."""
    z, P = (START - LOWER) / WIDTH, spread**2 * np.eye(3)
    for sample in episode:
        P = P + walk**2 * np.eye(3)
        H = np.reshape(sample.x, (-1, 3)) * WIDTH
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + SIGMA**2 * np.eye(len(H)))
        z = z + K @ (np.array(sample.xdot) - H @ (z + LOWER / WIDTH))
        P = (np.eye(3) - K @ H) @ P
        yield z, P


@EACH
@pytest.mark.parametrize("spread", [0.05, 0.2])
def test_on_an_episode_of_a_linear_plant_it_is_the_kalman_filter(name, spread):
    """To 1e-9, samples one after the other there and all at once here; wherever it linearises first."""
    episode = samples(12)
    estimate, batches = solve(made(name, jump=0.25, spread=spread), over_window, episode)
    *_, (z, P) = kalman(episode, 0.25)
    assert_allclose(estimate.theta, LOWER + WIDTH * z, rtol=0.0, atol=WIDTH * 1e-9)
    assert_allclose(estimate.std, WIDTH * np.sqrt(np.diag(P)), rtol=1e-8)
    assert estimate.is_identifiable == (True, True, True)
    assert estimate.n_evaluations == sum(batches) <= 30
    assert max(batches) == {"ukf": 7, "enkf": 9, "mhe": 3}[name]  # at the same time
    residual = over_window(estimate.theta, episode)
    assert estimate.cost == pytest.approx(residual @ residual, rel=1e-6)


@pytest.mark.parametrize("truth", [0.5, 0.65, 4.0])
@pytest.mark.parametrize("start", [0.5, 4.0])
def test_from_a_bound_sample_by_sample_it_gets_to_least_squares(start, truth):
    """Points outside the bounds, evaluated at them, looked like curvature and pushed the mean into the bound."""
    space, sigma, rng = ParameterSpace((Parameter("m", 0.5, 4.0),)), 0.01, np.random.default_rng(1)
    window = ResidualWindow(lambda theta, s: np.array([(s.xdot[0] - theta[0] * s.u[0]) / sigma]), 1)
    search = UnscentedKalman(space, np.array([start]), np.random.default_rng(0))
    u = 2.0 + np.cos(0.3 * np.arange(300))
    measured = truth * u + sigma * rng.standard_normal(300)
    for k, (held, value) in enumerate(zip(u.tolist(), measured.tolist(), strict=True)):
        window.append(Sample(0.01 * k, (), (held,), (value,)))
        search.solve(Objective(window))
    found = search.estimate()
    best = np.clip(measured[-50:] @ u[-50:] / (u[-50:] @ u[-50:]), 0.5, 4.0)  # it walks: the newest samples count
    assert abs(found.theta[0] - best) < 4.0 * found.std[0] < 0.05


def test_sample_by_sample_the_ensemble_is_the_kalman_filter_within_its_scatter():
    """20 000 members: mean and deviations to about 1/140 of a deviation, a sample; 4 % allowed after 20."""
    episode = samples(20)
    estimator = made("enkf", spread=0.1, walk=0.01, members=20_000)
    for sample, (z, P) in zip(episode, kalman(episode, 0.1, 0.01), strict=True):
        window = ResidualWindow(rows, 2, 1, rows_of_many)
        window.append(sample)
        estimator.solve(Objective(window))
        estimate, std = estimator.estimate(), np.sqrt(np.diag(P))
        assert np.abs((estimate.theta - LOWER) / WIDTH - z).max() < 0.04 * std.max()
        assert_allclose(estimate.std / WIDTH, std, rtol=0.04)


@pytest.mark.full
def test_errors_of_the_ensemble_are_as_large_as_it_says():
    """Normalised errors squared of 200 runs from drawn starts: chi-square of 600 degrees, within limits of 1e-4.

    A covariance of 50 members scatters: its inverse is 1 + (3 + 1) / 49 too large on the average.
    """
    squared = 0.0
    for seed in range(200):
        rng = RNG([seed, 1])
        z = (START - LOWER) / WIDTH + 0.05 * rng.standard_normal(3)
        estimator = made("enkf", seed=seed)
        for sample in samples(12, LOWER + WIDTH * z, seed=seed):
            window = ResidualWindow(rows, 2, 1)
            window.append(sample)
            estimator.solve(Objective(window))
        found = estimator.estimate()
        s, V = found.information.singular_values, found.information.directions
        squared += float(np.sum((s * (V @ ((found.theta - LOWER) / WIDTH - z))) ** 2))
    assert squared < chi2.ppf(1.0 - 1e-4, 600) * (1.0 + 4.0 / 49.0)


def curved(theta, episode):
    """Decays, whose rates are the parameters, as a roll-out of a plant gives them."""
    a, b, c = np.exp(0.3 * theta)
    t = np.array([s.t for s in episode]) / 10.0
    y = np.array([s.xdot[0] for s in episode])
    return (a * np.exp(-b * t) + np.cos(c * t) - y) / 0.02


def of_curved(truth, n=40, seed=0):
    blank = [Sample(float(k), (), (), (0.0,)) for k in range(n)]
    y = 0.02 * curved(truth, blank) + 0.02 * RNG(seed).standard_normal(n)
    return [Sample(s.t, (), (), (float(v),)) for s, v in zip(blank, y, strict=True)]


@EACH
def test_where_the_plant_is_curved_it_ends_at_the_most_likely_parameters(name):
    """Against SciPy's least squares on prior and residuals, to a tenth of a deviation, within 60 evaluations."""
    truth, start = np.array([1.6, 0.5, 2.6]), np.array([1.0, 1.0, 3.0])
    episode = of_curved(truth)
    estimate, _ = solve(made(name, start), curved, episode, budget=60)

    def costs(z):
        return np.concatenate([curved(LOWER + WIDTH * z, episode), (z - (start - LOWER) / WIDTH) / 0.3])

    best = LOWER + WIDTH * least_squares(costs, (start - LOWER) / WIDTH).x
    assert np.abs((estimate.theta - best) / estimate.std).max() < 0.2
    assert np.abs((estimate.theta - truth) / estimate.std).max() < 4.0


@EACH
def test_a_failing_candidate_costs_its_point_only_and_where_all_fail_nothing_is_written(name):
    episode = samples(12)

    def fails_beyond(theta, stretch):
        return over_window(theta, stretch) if theta[0] < START[0] + WALL[name] else None

    estimate, _ = solve(made(name), fails_beyond, samples(12, np.array([0.7, 0.4, 3.5])))
    assert_allclose(estimate.theta, [0.7, 0.4, 3.5], atol=0.5)
    if name == "mhe":  # differences have no other centre
        estimate, _ = solve(made(name), lambda z, e: None if z[0] == START[0] else over_window(z, e), episode)
        assert_array_equal(estimate.theta, START)
    estimate, _ = solve(made(name), lambda *_: None, episode)
    assert_array_equal(estimate.theta, START)
    assert (estimate.cost, estimate.is_identifiable) == (np.inf, (False, False, False))


@EACH
def test_it_stays_within_the_bounds_and_the_budget(name):
    for budget in (1, 4, 12, 30):
        estimate, batches = solve(made(name), over_window, samples(12, np.array([9.0, -7.0, 3.0])), budget)
        assert np.all(estimate.theta >= LOWER)
        assert np.all(estimate.theta <= LOWER + WIDTH)
        assert sum(batches) <= budget
    assert_allclose(estimate.theta[:2], [5.0, -2.0], atol=0.1)


@EACH
def test_what_the_model_lacks_widens_the_deviations(name):
    """Five times the noise in every residual: deviations five times as wide, and no wider than the start's."""
    episode = samples(30)
    plain, _ = solve(made(name), over_window, episode)
    wide, _ = solve(made(name), lambda theta, e: 5.0 * over_window(theta, e), episode)
    residual = over_window(plain.theta, episode)
    misfit = np.sqrt(residual @ residual / (len(residual) - 3))
    assert_allclose(wide.std, plain.std * misfit, rtol=0.02)  # the prior counts less


@EACH
def test_an_episode_knows_nothing_of_the_one_before(name):
    estimator = made(name)
    solve(estimator, over_window, samples(12))
    estimator.restart(START)
    blank = estimator.estimate()
    assert_allclose(blank.theta, START)
    assert (blank.n_evaluations, blank.cost) == (0, np.inf)
    again, _ = solve(estimator, over_window, samples(12))
    fresh, _ = solve(made(name), over_window, samples(12))
    assert_allclose(again.theta, fresh.theta, atol=1e-9)


def test_an_ensemble_has_its_mean_and_covariance_exactly():
    drawn = ensemble(9, 4, RNG(0))
    assert_allclose(drawn.mean(axis=0), np.zeros(4), atol=1e-15)
    assert_allclose(drawn.T @ drawn / 9, np.eye(4), atol=1e-14)


@pytest.mark.parametrize("name", ["members", "members_of_episode", "walk", "spread", "jump", "identifiable_below"])
def test_settings_are_positive(name):
    with pytest.raises(ValueError, match=f"{name} must be positive, got 0"):
        EnsembleSettings(**{name: 0})
