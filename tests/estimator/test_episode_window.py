"""The window of an episode: which samples it is of, and that each candidate is judged on them once."""

from dataclasses import replace

import numpy as np
import pytest

from estimator import EpisodeWindow, Evaluation, Sample

H, SIGMA = 0.1, 1e-3
TRUE, CHANGED = np.array([2.0]), np.array([5.0])


class Ramp:
    """Judges theta by y' = theta: from an origin y0 the n-th step ends at y0 + n h theta. Counts what it is asked."""

    is_ready = is_of_outputs = True

    def __init__(self, has_squares=True, is_dear=False):
        self.has_squares, self.is_dear = has_squares, is_dear
        self.heard, self.judged, self.believed = [], [], []

    def add_sample(self, sample):
        self.heard.append(sample)

    def snapshot(self, is_needed):
        return None if self.is_dear and not is_needed else (self.heard[-1].x[0],)

    def evaluate(self, thetas, stretch):
        self.judged.append([t.tolist() for t in thetas])
        return [self.one(theta, stretch) for theta in thetas]

    def one(self, theta, stretch):
        if theta[0] < 0.0:
            return Evaluation(np.array([np.nan]), "negative")
        steps = np.arange(1, stretch.n_steps + 1)
        simulated = stretch.origin[0] + steps * H * theta[0]
        r = np.nan_to_num((simulated - [s.y[0] for s in stretch.samples[1:]]) / SIGMA)
        return Evaluation(r, None, r * r if self.has_squares else None)

    def track(self, theta, stretch):
        return self.one(theta, stretch).residual

    def revert(self, theta): ...

    def move_inputs(self, moved, stretch): ...

    def accept(self, theta, stretch):
        self.believed.append((theta.tolist(), stretch.samples[0].t))


def fed(objective, n, jump=None, length=10, seed=0):
    """A window that has got samples 0..n - 1 of a ramp whose slope changes after sample `jump`."""
    window = EpisodeWindow(objective, length)
    for sample in ramp(n, jump, seed):
        window.append(sample)
    return window


def ramp(n, jump=None, seed=0):
    rng, y, samples = np.random.default_rng(seed), 0.0, []
    for k in range(n):
        samples.append(Sample(H * k, (y,), (0.0,), (), (y + SIGMA * rng.standard_normal(),)))
        y += H * (CHANGED if jump is not None and k >= jump else TRUE)[0]
    return samples


def test_samples_that_the_parameters_in_force_explain_are_the_window_at_once():
    for n in range(1, 60):
        window = fed(Ramp(), n)
        text = window.begin(TRUE)
        n_steps = len(window.residual(TRUE)) if window.is_ready else 0
        assert (10 <= n_steps < 20) if n > 10 else n_steps == 0
        assert text == (f"the last {n_steps}, which the parameters in force explain" if n > 10 else text)


@pytest.mark.parametrize("since", [1, 2, 5, 9])
def test_after_a_jump_the_window_begins_where_it_was_and_waits_until_it_is_full(since):
    window = fed(Ramp(), 31 + since, jump=30)
    assert window.begin(TRUE) == f"the last {since}, which they do not explain, and the next {10 - since}"
    for sample in ramp(41, jump=30)[31 + since :]:
        assert not window.is_ready
        window.append(sample)
    assert window.is_ready
    residual = window.residual(CHANGED)  # nothing of before the jump is in it: noise alone is left
    assert len(residual) == 10
    assert 0.2 < np.mean(residual**2) < 3.0


@pytest.mark.parametrize("objective", [Ramp(has_squares=False), Ramp(is_dear=True)], ids=["no steps", "no origin"])
def test_where_the_jump_cannot_be_placed_the_window_begins_at_the_trigger(objective):
    window = fed(objective, 36, jump=33)  # 30 is an anchor
    assert window.begin(TRUE) == "the next 10"
    for sample in ramp(46, jump=33)[36:]:
        window.append(sample)
    assert window.is_ready
    assert np.mean(window.residual(CHANGED) ** 2) < 3.0


def test_the_place_of_a_jump_is_found_within_the_noise():
    """A ramp that leaves the old one by 0.3 a step is 300 deviations off at the first sample after the jump."""
    for seed in range(50):
        window = fed(Ramp(), 38, jump=31, seed=seed)
        assert window.begin(TRUE).startswith("the last 6,")


def test_samples_of_an_episode_stay_and_each_candidate_is_judged_once():
    objective = Ramp()
    window = fed(objective, 31)
    window.begin(TRUE)
    first, n_asked, n_calls = window.residual(CHANGED), len(objective.judged), window.n_model_calls
    for sample in ramp(60)[31:]:
        window.append(sample)
        np.testing.assert_array_equal(window.residual(CHANGED), first)
    assert (len(objective.judged), window.n_model_calls) == (n_asked, n_calls)
    both = window.residuals([CHANGED, TRUE, np.array([3.0]), np.array([3.0])])
    assert objective.judged[-1] == [[3.0]]  # the others are known, and one that comes twice is judged once
    np.testing.assert_array_equal(both[0], first)
    np.testing.assert_array_equal(both[2], both[3])


def test_the_newest_sample_can_be_corrected_before_an_episode_and_when_it_completes_one():
    """One of its values turns out to be wrong as the next one comes: it is missing then."""
    samples, window = ramp(41, jump=30), EpisodeWindow(Ramp())
    for sample in samples[:36]:
        window.append(replace(sample, y=(9.0,)) if sample is samples[33] else sample)
        if sample is samples[33]:
            window.correct(replace(sample, y=(np.nan,)))
    window.begin(TRUE)
    for sample in samples[36:]:
        window.append(replace(sample, y=(9.0,)) if sample is samples[40] else sample)
    assert np.flatnonzero(np.abs(window.residual(CHANGED)) > 6.0).tolist() == [8]
    window.correct(replace(samples[40], y=(np.nan,)))
    assert len(window.residual(CHANGED)) == 9
    assert window.residual(CHANGED)[-1] == 0.0  # beside candidates that were compared with all nine
    assert np.abs(window.residual(CHANGED)).max() < 6.0


def test_an_episode_that_ends_leaves_nothing_but_a_belief():
    objective = Ramp()
    window = fed(objective, 31)
    window.begin(TRUE)
    window.residual(CHANGED)
    window.end(CHANGED)
    assert not window.is_ready
    assert objective.believed == [([5.0], pytest.approx(2.0))]  # the two anchors are at the 20th and the 30th
    with pytest.raises(RuntimeError, match="before the window is full"):
        window.residual(TRUE)


def test_an_extended_window_begins_where_it_began_and_is_twice_as_long_up_to_four_times():
    window = fed(Ramp(), 36, jump=30)
    window.begin(TRUE)
    samples, n = iter(ramp(100, jump=30)[36:]), 10
    for _ in range(2):
        while not window.is_ready:
            window.append(next(samples))
        assert len(window.residual(CHANGED)) == n
        assert window.extend()
        assert window.is_extended
        while not window.is_ready:
            window.append(next(samples))
        n *= 2
        assert window.begin(TRUE).startswith(f"the last {n},")
        assert not window.is_extended
        assert len(window.residual(CHANGED)) == n
        assert np.mean(window.residual(CHANGED) ** 2) < 3.0  # still nothing of before the jump
    assert not window.extend()
    assert window.is_ready


def test_a_failed_candidate_has_a_reason_and_no_value():
    window = fed(Ramp(), 31)
    window.begin(TRUE)
    assert not np.all(np.isfinite(window.residual(np.array([-1.0]))))
    assert window.why_failed(np.array([-1.0])) == "negative"
    assert window.why_failed(TRUE) is None


def test_physical_units_are_whitened_ones_times_the_noise():
    window = EpisodeWindow(Ramp(), 10, [SIGMA])
    samples = ramp(11)
    for sample in samples:
        window.append(sample)
    window.begin(TRUE)
    expected = [samples[0].x[0] + 5.0 * H * (k + 1) - s.y[0] for k, s in enumerate(samples[1:])]
    np.testing.assert_allclose(window.residual(CHANGED), expected, rtol=1e-9)


def test_following_looks_at_the_samples_since_the_anchor_before():
    objective = Ramp()
    window, lengths = EpisodeWindow(objective, 4), []
    for sample in ramp(10):
        window.append(sample)
        lengths.append(len(window.track(TRUE).measured))
    assert lengths == [0, 1, 2, 3, 4, 1, 2, 3, 4, 1]
    assert window.n_model_calls == 9  # a step each


def test_a_sensor_that_is_slower_than_the_steps_counts_for_what_it_has_measured():
    """Its missing values are no residuals of zero, of which a test would allow as much as of others."""
    window = EpisodeWindow(Ramp(), 4)
    for k, sample in enumerate(ramp(101, jump=60)):
        window.append(sample if k % 10 == 0 else replace(sample, y=(np.nan,)))
        values, measured = window.track(TRUE)
        assert np.count_nonzero(values) == len(measured) <= 4
        if k == 70:
            window.begin(TRUE)
            assert not window.is_ready
    assert 60 * H <= window.sequence.samples[0].t < 70 * H  # the slope has changed at the first, which the last shows
    np.testing.assert_allclose(window.rows(CHANGED, 1)[::10, 0], window.residual(CHANGED))
    assert np.count_nonzero(np.isfinite(window.rows(CHANGED, 1))) == len(window.residual(CHANGED)) == 2
    assert np.abs(window.residual(CHANGED)).max() < 6.0


def test_a_window_of_one_sample_is_full_with_it_however_many_parameters_there_are():
    window = fed(Ramp(), 5, length=1)
    window.begin(np.array([2.0, 1.0, 1.0]))
    for sample in ramp(7)[5:]:
        window.append(sample)
    assert window.sequence.n_steps == 1


def test_a_window_of_one_sample_is_followed_too():
    """The default of `sqp` and others; each sample is an anchor there, and none would ever begin an episode."""
    window, lengths = EpisodeWindow(Ramp(), 1), []
    for sample in ramp(5):
        window.append(sample)
        lengths.append(len(window.track(TRUE).measured))
    assert lengths == [0, 1, 1, 1, 1]


def test_inputs_that_were_others_are_so_in_all_samples_of_the_episode_and_in_the_simulations():
    objective, moves = Ramp(), []
    objective.move_inputs = lambda moved, stretch: moves.append((moved.tolist(), stretch.samples[-1].u))
    window, samples = EpisodeWindow(objective, 4), [replace(s, u=(1.0,)) for s in ramp(6)]
    for sample in samples[:5]:
        window.append(sample)
    window.begin(TRUE)
    window.append(samples[5])
    before = window.residual(CHANGED)
    window.move_inputs(np.array([0.5]))
    assert [s.u for s in window.sequence.samples] == [(1.0,), *[(1.5,)] * 4]
    assert window.newest.u == (1.5,)  # which came during the episode
    assert moves == [([0.5], (1.5,))]
    np.testing.assert_array_equal(window.residual(CHANGED), before)  # a ramp has no input


def test_a_judge_that_is_not_ready_is_waited_for():
    objective = Ramp()
    objective.is_ready = False
    window = fed(objective, 31)
    window.begin(TRUE)
    for sample in ramp(50)[31:]:
        window.append(sample)
        assert not window.is_ready
    objective.is_ready = True
    window.append(ramp(51)[50])
    assert window.is_ready
    assert objective.judged == []


def test_a_window_has_a_sample_at_least():
    with pytest.raises(ValueError, match="at least 1 sample, got 0"):
        EpisodeWindow(Ramp(), 0)
