"""The size of the residuals that is learnt while nothing happens, against noise whose size is known."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize_scalar
from scipy.stats import norm

from estimator.diagnosis import residual_scale
from estimator.diagnosis.residual_scale import ResidualScale, coloured_noise, larger_noise
from estimator.hypotheses import NEVER


def noise(seed, n, sigma=1.0, n_channels=1):
    return sigma * np.random.default_rng(seed).standard_normal((n, n_channels))


def learnt(rows, scale=None):
    """The scale after these residuals, and whether it changed at any of them."""
    scale = scale or ResidualScale(rows.shape[1])
    changes = [scale.learn(row) for row in rows]
    return scale, any(changes)


def autoregressive(seed, n, rho, sigma=1.0):
    """Rows (n, 1) with correlation rho from one to the next, stationary from the first."""
    draws = noise(seed, n)[:, 0]
    rows = [sigma * draws[0]]
    for draw in draws[1:]:
        rows.append(rho * rows[-1] + sigma * np.sqrt(1.0 - rho * rho) * draw)
    return np.array(rows)[:, None]


@pytest.mark.parametrize("sigma", [2.0, 5.0, 10.0])
def test_noise_larger_than_declared_is_learnt_to_a_fifth(sigma):
    """A median of 200 differences is good to 7 % of the deviation, its hysteresis adds up to 20 %: over many seeds
    the mean is right, and single ones are off by more than a third nowhere."""
    found = np.array([learnt(noise(seed, 600, sigma))[0].values[0] for seed in range(60)])
    assert_allclose(found.mean(), sigma, rtol=0.1)
    assert np.mean(np.abs(found / sigma - 1.0) < 0.2) >= 0.85
    assert np.all(np.abs(found / sigma - 1.0) < 0.4)


def test_the_first_estimate_needs_no_more_than_100_samples():
    scale = ResidualScale(1)
    changed = [scale.learn(row) for row in noise(0, 100, 10.0)]
    assert changed == [False] * 99 + [True]
    assert_allclose(scale.values, 10.0, rtol=0.3)


def test_the_declared_noise_stands_where_it_is_right():
    """200 samples give a median good to 7 %, the first 100 one to 10 %: a dead band of 50 % holds nearly always."""
    ever = [learnt(noise(seed, 1000, n_channels=2))[1] for seed in range(100)]
    assert np.mean(ever) <= 0.02


def test_the_declared_noise_stands_for_ever_once_the_memory_is_full():
    scale, _ = learnt(noise(1, 20_000))
    assert_array_equal(scale.values, [1.0])


@pytest.mark.parametrize("sigma", [0.01, 0.1, 0.5])
def test_noise_smaller_than_declared_changes_nothing(sigma):
    scale, has_changed = learnt(noise(2, 1000, sigma))
    assert not has_changed
    assert_array_equal(scale.effective, [1.0])


def test_channels_are_learnt_each_by_itself():
    rows = noise(3, 600, n_channels=3) * [1.0, 4.0, 9.0]
    scale, _ = learnt(rows)
    assert scale.values[0] == 1.0
    assert_allclose(scale.values[1:], [4.0, 9.0], rtol=0.25)


def test_the_declared_noise_stands_from_the_first_samples_on():
    ever = [learnt(noise(seed, 200))[1] for seed in range(100)]
    assert np.mean(ever) <= 0.05


def moved(seed, n, mean):
    """Noise of the declared size about a mean that a slow change has moved away after the first 200 samples."""
    shift = {"drift": 0.02 * np.arange(n), "offset": np.full(n, 2.5)}[mean]
    return noise(seed, 200 + n) + np.concatenate([np.zeros(200), shift])[:, None]


@pytest.mark.parametrize("mean", ["drift", "offset"])
def test_a_slow_drift_and_a_constant_offset_are_not_taken_for_noise(mean):
    """200 samples of a drift of 0.02 deviations a sample spread over 4 deviations."""
    kept = [np.all(learnt(moved(seed, 1000, mean))[0].values == 1.0) for seed in range(100)]
    assert np.mean(kept) >= 0.98


@pytest.mark.parametrize("mean", ["drift", "offset"])
def test_a_mean_that_moves_at_once_is_not_taken_for_noise(mean):
    kept = [np.all(learnt(moved(seed, 1000, mean)[200:])[0].values == 1.0) for seed in range(100)]
    assert np.mean(kept) >= 0.98


def test_rare_spikes_do_not_move_the_scale():
    rows = noise(6, 1000)
    rows[::20] += 1000.0
    assert_array_equal(learnt(rows)[0].values, [1.0])
    rows = noise(6, 1000, 5.0)
    rows[::20] += 1000.0
    assert_allclose(learnt(rows)[0].values, 5.0, rtol=0.3)


def test_noise_that_has_gone_is_forgotten_when_the_memory_is():
    scale, _ = learnt(noise(7, 400, 5.0))
    assert scale.values[0] > 4.0
    learnt(noise(8, 400), scale)
    assert_array_equal(scale.values, [1.0])


def test_noise_that_has_gone_is_not_kept_for_what_the_model_lacks():
    """Only what was admitted is: an offset of that size does not take the place of the noise that was learnt."""
    scale, _ = learnt(noise(7, 400, 5.0))
    assert scale.values[0] > 4.0
    learnt(noise(8, 400) + 20.0, scale)
    assert_array_equal(scale.values, [1.0])


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_correlation_of_a_lacking_models_residuals_is_found(rho):
    """Bartlett (1946): a correlation of n samples is good to sqrt((1 - rho^2) / n)."""
    n = 1000
    found = []
    for seed in range(20):
        scale = ResidualScale(1)
        assert scale.admit(autoregressive(seed, n, rho, 6.0))
        found.append(scale.correlations[0])
    deviation = np.sqrt((1.0 - rho * rho) / n)
    assert_allclose(found, rho, rtol=0.0, atol=5.0 * deviation)
    if rho > 0.0:
        assert_allclose(np.mean(found), rho, rtol=0.0, atol=1.5 * deviation)


def test_means_of_correlated_residuals_are_as_wide_as_the_effective_scale_says():
    """Monte Carlo: a mean of n correlated samples has the variance effective^2 / n, for n much beyond 1/(1 - rho)."""
    rho, n = 0.8, 400
    scale = ResidualScale(1)
    scale.admit(autoregressive(0, 20_000, rho, 3.0))
    means = [autoregressive(seed, n, rho, 3.0).mean() for seed in range(1, 801)]
    assert_allclose(np.std(means) * np.sqrt(n), scale.effective[0], rtol=0.12)  # 800 draws: 2.5 %; the correlation 4 %


def test_the_formulas_are_those_of_the_oracles(oracles):
    oracles.check_spread_is_that_of_white_noise_about_a_slow_mean(residual_scale)
    oracles.check_effective_scale_is_that_of_means_of_correlated_samples(residual_scale)


def test_admitted_residuals_never_lower_the_scale():
    scale = ResidualScale(1)
    scale.admit(np.full((100, 1), 7.0))
    assert_allclose(scale.values, 7.0)
    assert not scale.admit(noise(9, 100, 2.0))
    assert_allclose(scale.values, 7.0)


def test_a_rest_shows_the_noise_whatever_the_mean_does():
    """30 differences give a median good to a fifth."""
    smooth = (20.0 * np.sin(0.05 * np.arange(60)))[:, None]
    found = []
    for seed in range(60):
        scale = ResidualScale(1)
        assert scale.wake(noise(seed, 60, 8.0) + smooth)
        found.append(scale.values[0])
    assert_allclose(np.mean(found), 8.0, rtol=0.1)
    assert not ResidualScale(1).wake(smooth)


def test_a_rest_never_lowers_the_scale_and_is_believed_from_30_samples_on():
    scale = ResidualScale(1)
    assert not scale.wake(noise(0, 29, 10.0))
    assert_array_equal(scale.values, [1.0])
    assert scale.wake(noise(0, 30, 10.0))
    before = scale.values
    assert not scale.wake(noise(1, 500))
    assert_array_equal(scale.values, before)


def test_a_channel_without_rows_keeps_its_correlation():
    """Columns of zeros are channels that did not rest."""
    scale = ResidualScale(2)
    rows = autoregressive(0, 1000, 0.8, 6.0)
    scale.admit(np.hstack([rows, np.zeros_like(rows)]))
    effective = scale.effective[0]
    scale.admit(np.hstack([np.zeros_like(rows), rows]))
    assert_allclose(scale.effective, effective)


def test_one_row_says_nothing():
    scale = ResidualScale(2)
    assert not scale.admit(np.full((1, 2), 99.0))
    assert not scale.admit(np.empty((0, 2)))
    assert_array_equal(scale.values, [1.0, 1.0])


def test_what_was_admitted_is_kept_while_the_residuals_are_of_that_size():
    """A lacking model's residuals are smooth: their differences are small, they themselves are not."""
    t = np.arange(2000)
    rows = (8.0 * np.sin(0.05 * t))[:, None] + noise(10, 2000)
    scale = ResidualScale(1)
    scale.admit(rows[:500])
    admitted = scale.values[0]
    assert_allclose(admitted, np.sqrt(np.mean(rows[:500] ** 2)))
    learnt(rows[500:], scale)
    assert scale.values[0] > 0.7 * admitted


def test_a_copy_and_its_origin_do_not_know_of_each_other():
    (scale, _), (twin, _) = learnt(noise(11, 100, 5.0)), learnt(noise(11, 100, 5.0))
    copy = scale.copy()
    learnt(noise(12, 310, 50.0), copy)
    assert_allclose(copy.values, 50.0, rtol=0.3)
    other = scale.copy()
    for row in noise(13, 500, 9.0):
        assert scale.learn(row) == twin.learn(row) == other.learn(row)
        assert_array_equal(scale.effective, twin.effective)
        assert_array_equal(other.effective, twin.effective)


def test_a_channel_without_values_keeps_its_scale_and_hinders_no_other():
    rows = noise(0, 400, 4.0, n_channels=2)
    rows[:, 1] = np.nan
    scale = ResidualScale(2)
    scale.enlarge(np.array([1.0, 1.4]))
    learnt(rows, scale)
    assert_allclose(scale.values, [4.0, 1.4], rtol=0.2)
    assert_allclose(scale.observed, [4.0, 1.4], rtol=0.2)


def test_values_that_are_missing_now_and_then_are_left_out():
    """Half of them: the differences are those of the values that there are."""
    rows = noise(1, 800, 4.0, n_channels=2)
    rows[::2, 1] = np.nan
    scale, _ = learnt(rows)
    assert_allclose(scale.values, 4.0, rtol=0.25)


@pytest.mark.parametrize("take", ["admit", "wake"])
def test_missing_values_of_a_rest_are_left_out(take):
    rows = noise(3, 400, 4.0, n_channels=3)
    rows[::2, 1], rows[:, 2] = np.nan, np.nan
    scale = ResidualScale(3)
    assert getattr(scale, take)(rows)
    assert_allclose(scale.values, [4.0, 4.0, 1.0], rtol=0.25)


def test_nothing_is_learnt_without_any_values():
    scale, has_changed = learnt(np.full((400, 1), np.nan))
    assert not has_changed
    assert scale.observed is None


@pytest.mark.parametrize("take", ["admit", "wake"])
def test_what_another_channel_has_learnt_stays_where_one_is_admitted(take):
    """A scale in the dead band, as a search has adopted it: it is only raised."""
    scale = ResidualScale(2)
    scale.enlarge(np.array([1.4, 1.0]))
    rows = np.hstack([np.zeros((40, 1)), noise(2, 40, 5.0)])
    assert getattr(scale, take)(rows)
    assert scale.values[0] == pytest.approx(1.4)
    assert scale.values[1] > 3.0


@pytest.mark.parametrize("sizes", [(1.0, 5.0), (0.5, 40.0), (10.0, 2.0)])
def test_a_larger_noise_is_as_likely_as_the_best_normal_distributions_of_the_channels(sizes):
    """The standard deviations are one to ten times the known ones; missing values are left out."""
    rows = np.array(sizes) * noise(3, 12, n_channels=2)
    rows[4, 1] = 0.0
    likeliest = 0.0
    for of_channel in rows.T:
        seen = of_channel[of_channel != 0.0]
        found = minimize_scalar(
            lambda s, r=seen: -2.0 * norm.logpdf(r, scale=s).sum(), bounds=(1.0, 10.0), method="bounded"
        )
        likeliest += found.fun - len(seen) * np.log(2.0 * np.pi)
    fit = larger_noise(rows)
    assert_allclose(fit.squares, likeliest, rtol=1e-4)
    assert (fit.n_free, fit.n_values) == (2, 23)


def test_coloured_noise_is_as_likely_as_the_best_of_some_normal_distributions(oracles):
    oracles.check_coloured_noise_against_normal_distributions(residual_scale)


@pytest.mark.parametrize("noise_of", [larger_noise, coloured_noise])
def test_residuals_that_are_no_numbers_are_no_noise(noise_of):
    assert noise_of(np.array([[np.nan], [1.0]])) is NEVER


def test_a_channel_without_values_has_no_coloured_noise():
    rows = autoregressive(4, 12, 0.9, 3.0)
    assert coloured_noise(np.hstack([rows, np.zeros_like(rows)])).squares == coloured_noise(rows).squares


@pytest.mark.parametrize(("period", "is_smooth"), [(6, False), (10, False), (14, True), (30, True)])
def test_a_sine_is_smooth_from_twelve_rows_a_period_on(period, is_smooth):
    """Its differences are 2 sin(pi / period) times as large, each time: 0.52 times at twelve rows."""
    rows = 500.0 * np.sin(2.0 * np.pi * np.arange(20 * period) / period)[:, None]
    assert residual_scale.is_smooth(rows) == is_smooth
    assert residual_scale.is_smooth(np.hstack([noise(0, len(rows)), rows])) == is_smooth


@pytest.mark.parametrize("size", [0.1, 1.0, 500.0])
@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_noise_of_any_size_is_not_smooth(size, rho):
    assert not any(residual_scale.is_smooth(autoregressive(seed, 20, rho, size)) for seed in range(200))


def test_a_smooth_residual_that_is_smaller_than_the_declared_noise_counts_as_none():
    assert not residual_scale.is_smooth(0.5 * np.sin(0.1 * np.arange(40))[:, None])
