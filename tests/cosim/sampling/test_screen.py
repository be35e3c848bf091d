"""The screen by itself, on a plant x' = theta u whose derivative and state are sampled exactly, or as it is said."""

from dataclasses import replace
from math import exp, inf, nan, sqrt

import numpy as np
import pytest
from scipy.signal import lfilter

from cosim.sampling.consistency import Consistency
from cosim.sampling.derivative_gain import DerivativeGain
from cosim.sampling.outliers import Outliers
from cosim.sampling.screen import FilteredScreen, OutputScreen, SampleScreen, Sensors
from cosim.sampling.sensor_checks import SUMMED
from cosim.scenarios.schema.sampling import ObservationSettings
from estimator import Sample

H, SIGMA = 0.1, 0.01
THETA = np.array([1.0])
NAMES = ("der(x)", "x")


def residual(theta, sample):
    return (np.array(sample.xdot) - theta[0] * sample.u[0]) / SIGMA


def slope(theta, x, u):
    return [theta[0] * u[0]]


SENSORS = Sensors(NAMES, (True, False), (SIGMA,), (0,), (0.0,), residual, slope)


def moving(n, first=0):
    """n samples, from number `first` on, of x' = 1, the derivative with a noise too small for anything but its bits."""
    noise = np.random.default_rng(0).normal(0.0, 1e-3 * SIGMA, n + first)
    return [Sample(k * H, (k * H,), (1.0,), (1.0 + noise[k],)) for k in range(first, first + n)]


def screen(sensors=SENSORS, **settings):
    return SampleScreen(ObservationSettings(**settings), sensors, H)


def found(watched, sample, t=None, theta=THETA):
    """What is told of a sample, and whether the estimator gets it."""
    before = watched.summary()["found"]
    seen = watched.step(sample.t if t is None else t, sample, theta)
    return {key for key, n in watched.summary()["found"].items() if n > before.get(key, 0)}, seen.sample is not None


def steps(watched, samples):
    return [watched.step(s.t, s, THETA) for s in samples]


def told(seen, kind="observation"):
    return [(e.detail.get("fault"), e.detail["sensor"]) for e in seen.events if e.kind == kind]


# A sample by itself, and beside the one before.


@pytest.mark.parametrize(
    ("value", "kind"), [(nan, "missing"), (inf, "infinite"), (-inf, "infinite"), (1e200, "infinite")]
)
@pytest.mark.parametrize(("key", "name"), [("xdot", "der(x)"), ("x", "x"), ("u", "input")])
def test_what_is_no_finite_number_is_kept_out(key, name, value, kind):
    watched = screen()
    one, other, third = moving(3)
    assert found(watched, one) == (set(), True)
    assert found(watched, replace(other, **{key: (value,)})) == ({f"{kind} {name}"}, False)
    assert found(watched, third) == (set(), True)
    assert watched.summary() == {"kept_out": 1, "found": {f"{kind} {name}": 1}, "failed": []}


@pytest.mark.parametrize(("steps", "is_late"), [(0.4, False), (0.6, True), (1.0, True), (-0.4, False)])
def test_a_sample_is_late_by_half_a_step(steps, is_late):
    sample = replace(moving(1)[0], t=1.0 - steps * H)
    assert found(screen(), sample, t=1.0) == (({"late sample"}, False) if is_late else (set(), True))


def test_a_time_stamp_that_was_there_already_is_late_whatever_came_between():
    watched, (sample,) = screen(), moving(1)
    assert found(watched, replace(sample, t=1.05), t=1.0) == (set(), True)
    assert found(watched, replace(sample, t=1.05), t=1.09) == ({"late sample"}, False)
    assert found(watched, replace(sample, t=0.5), t=1.09) == ({"late sample"}, False)
    assert found(watched, replace(sample, t=1.05), t=1.09) == ({"late sample"}, False)
    assert found(watched, replace(sample, t=1.06), t=1.09) == (set(), True)


def test_of_a_late_sample_nothing_else_is_told():
    watched, (sample,) = screen(), moving(1)
    assert found(watched, replace(sample, xdot=(nan,), t=0.0), t=1.0) == ({"late sample"}, False)


def test_the_first_of_a_series_is_told():
    watched, seen = screen(patience=10), []
    for k, sample in enumerate(moving(30)):
        broken = {1: {"xdot": (nan,)}, 3: {"xdot": (nan,)}, 4: {"x": (nan,)}, 20: {"xdot": (nan,)}}.get(k, {})
        seen.append(told(watched.step(sample.t, replace(sample, **broken), THETA)))
    rate, state = ("missing", "der(x)"), ("missing", "x")
    assert {k: events for k, events in enumerate(seen) if events} == {1: [rate], 4: [state], 20: [rate]}


# Stuck.

TWO = Sensors(
    ("der(v)", "x", "v"), (True, False, False), (SIGMA,), (1,), (0.0, 0.0), residual,
    lambda theta, x, u: [x[1], theta[0] * u[0]],
)  # fmt: skip


def standing(n, x, v, u, rate=0.0):
    noise = np.random.default_rng(0).normal(0.0, 1e-3 * SIGMA, n)
    return [Sample(k * H, (x, v), (u,), (rate + noise[k],)) for k in range(n)]


def stuck_at(watched, samples):
    """Number of the first sample of which a sensor is told to be stuck, by sensor."""
    first = {}
    for k, sample in enumerate(samples):
        for key in found(watched, sample)[0]:
            kind, _, name = key.partition(" ")
            assert kind == "stuck"
            first.setdefault(name, k)
    return first


@pytest.mark.parametrize("n", [2, 7])
def test_noise_does_not_repeat_itself(n):
    first, *rest = moving(20)
    samples = [first, *(replace(sample, xdot=(1.0,)) for sample in rest)]
    assert stuck_at(screen(stuck=n), samples) == {"der(x)": n + 1}
    interrupted = [replace(s, xdot=(1.001,)) if k % n == 0 else s for k, s in enumerate(samples)]
    assert stuck_at(screen(stuck=n), interrupted) == {}
    exact = replace(SENSORS, is_noisy=(False, False))
    assert stuck_at(screen(exact, stuck=n), samples) == {}


@pytest.mark.parametrize(
    ("x", "v", "u", "expected"),
    [
        (0.0, 0.0, 0.0, {}),  # at rest
        (0.0, 1e-7, 0.0, {"x": 10}),
        (0.0, -1e-7, 0.0, {"x": 10}),
        (0.0, 0.9e-8, 0.0, {}),  # of a step of 0.1 s less than 1e-9
        (1e6, 0.9e-2, 0.0, {}),  # less than 1e-9 of its size
        (1e6, 1.1e-2, 0.0, {"x": 10}),
        (0.0, 0.0, 1.0, {"v": 10}),
    ],
)
def test_a_state_that_the_model_moves_does_not_keep_its_bits(x, v, u, expected):
    assert stuck_at(screen(TWO, inconsistent=1e9), standing(12, x, v, u)) == expected


def test_each_sensor_is_stuck_in_its_own_time():
    samples = [replace(sample, xdot=(1.0,), x=(5.0 * (k > 0),)) for k, sample in enumerate(moving(20))]
    assert stuck_at(screen(stuck=4, inconsistent=1e9), samples) == {"der(x)": 4, "x": 5}


def coarse(n, v, step, stuck_from=10**9):
    """Samples of x = v t, read in steps, and of a rate that is read in steps of 2: four samples of each."""
    at = [step * round(v * min(k, stuck_from) * H / step) for k in range(n)]
    return [Sample(k * H, (x, v), (0.0,), (2.0 * (k // 4 % 2),)) for k, x in enumerate(at)]


def test_a_coarse_reading_that_repeats_itself_is_not_stuck():
    """A step of 0.5 at 0.1 a sample: the same five times."""
    watched = screen(TWO, stuck=3, inconsistent=1e9, outlier=1e9)
    samples = coarse(40, 0.1 / H, 0.5)
    first = stuck_at(watched, samples)
    assert all(k < 20 for k in first.values())  # until it is known how these sensors read
    assert stuck_at(watched, [replace(s, t=s.t + 40 * H) for s in samples]) == {}


def test_a_coarse_reading_is_stuck_where_the_model_moves_it_by_many_steps():
    """From sample 100 on it stands still; by the model, at 0.1 a sample, it has moved by ten steps of 0.5 after 50."""
    samples = [replace(s, xdot=(k % 7 / 7.0,)) for k, s in enumerate(coarse(200, 0.1 / H, 0.5, 100))]
    watched = screen(TWO, stuck=3, inconsistent=1e9, outlier=1e9)
    stuck_at(watched, samples[:60])
    assert stuck_at(watched, samples[60:]) == {"x": pytest.approx(100 + 50 - 60, abs=5)}


def test_a_sensor_that_is_stuck_now_and_then_is_so_each_time():
    """Five times for 20 samples, 80 samples apart: that is not how a fine sensor reads."""
    rng, held = np.random.default_rng(0), 0.0
    watched = screen(TWO, stuck=4, inconsistent=1e9, outlier=1e9)
    told = []
    for k in range(500):
        held = held if k % 100 >= 80 else float(rng.normal(0.0, 1e-3))
        told.append("stuck der(v)" in found(watched, Sample(k * H, (0.0, 0.0), (0.0,), (held,)))[0])
    assert [sum(told[n : n + 100]) for n in range(0, 500, 100)] == [17] * 5


def test_beside_what_is_missing_nothing_is_stuck():
    watched = screen()
    for sample in moving(20):
        assert found(watched, replace(sample, x=(0.0,), xdot=(nan,)))[0] == {"missing der(x)"}


# Sensors that fail, and recover.


def test_a_sensor_that_is_bad_in_more_than_half_of_the_samples_rests_re_tuning_until_a_tenth():
    watched, gets, sensors = screen(patience=20), [], []
    for k, sample in enumerate(moving(60)):
        seen = watched.step(sample.t, replace(sample, xdot=(nan,)) if k < 11 else sample, THETA)
        gets.append(seen.sample is not None)
        sensors += [(k, e.detail["sensor"], e.detail["reason"]) for e in seen.events if e.kind == "sensor"]
    assert gets == [False] * 29 + [True] * 31  # of the newest 20, 2 are bad at number 28
    assert sensors == [
        (10, "der(x)", "der(x) was bad in 11 of 11 samples, now missing: re-tuning is suspended"),
        (28, "der(x)", "der(x) is good again: re-tuning resumes"),
    ]
    assert watched.summary() == {"kept_out": 29, "found": {"missing der(x)": 11}, "failed": []}


def test_half_of_the_samples_may_be_bad_and_every_sensor_counts_for_itself():
    watched = screen(patience=20)
    for k, sample in enumerate(moving(40)):
        broken = {0: {"xdot": (nan,)}, 1: {"x": (nan,)}}[k % 2] if k >= 20 else {}
        watched.step(sample.t, replace(sample, **broken), THETA)
        assert watched.summary()["failed"] == []
    for sample in moving(1, first=40):
        watched.step(sample.t, replace(sample, xdot=(nan,), x=(nan,)), THETA)
    assert watched.summary()["failed"] == ["x"]  # the oldest that went was one of der(x)


# Outliers: a jump of the residual by 8 times what is usual, at least sqrt(2) standard deviations.


def fed(values, inputs=None, thetas=None, sensors=SENSORS, before=9):
    """For each derivative, in standard deviations from 1: whether it is suspect, and the outliers of the one before.

    Before the first of them some are alike, which show what is usual.
    """
    watched, seen = Outliers(8.0, sensors.names, sensors.noise, sensors.residual), []
    for k in range(-before, 0):
        xdot = tuple(1.0 + SIGMA * np.zeros_like(np.atleast_1d(values[0])))
        watched.step(Sample(k * H, (0.0,), (1.0,), xdot), THETA)
    for k, value in enumerate(values):
        u = 1.0 if inputs is None else inputs[k]
        xdot = tuple(1.0 + SIGMA * np.atleast_1d(value))
        seen.append(watched.step(Sample(k * H, (0.0,), (u,), xdot), THETA if thetas is None else thetas[k]))
    return seen


GOOD, SUSPECT, OUTLIER = (False, []), (True, []), (False, ["der(x)"])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("jump", "is_far"), [(11.3, False), (11.33, True)])  # 8 sqrt(2) = 11.314
def test_how_far_a_jump_is(jump, is_far, sign):
    assert fed([0.0, sign * jump]) == [GOOD, SUSPECT if is_far else GOOD]


@pytest.mark.parametrize(
    ("share", "is_outlier"), [(0.29, True), (0.31, False), (1.0, False), (0.0, True), (-1.0, True)]
)
def test_how_much_of_a_jump_must_persist(share, is_outlier):
    last, after, later = fed([0.0, 0.0, 30.0, share * 30.0, share * 30.0])[2:]
    assert last == SUSPECT
    assert after[1] == (["der(x)"] if is_outlier else [])
    assert after[0] == (share == -1.0)  # the other way: the next jump
    assert later[1] == []


def test_an_outlier_is_told_once():
    assert fed([0.0, 50.0, 0.0, 0.0, 0.0]) == [GOOD, SUSPECT, OUTLIER, GOOD, GOOD]


def test_a_spike_at_the_second_sample_of_all_does_not_excuse_itself():
    """Its own change is the only one so far; that of the third sample from the first shows what is usual."""
    assert fed([0.0, 50.0, 1.0, 0.0, 1.0], before=0) == [GOOD, SUSPECT, OUTLIER, GOOD, GOOD]
    assert fed([0.0, 50.0, 49.0, 50.0, 49.0], before=0) == [GOOD, SUSPECT, GOOD, GOOD, GOOD]


def test_noise_that_is_larger_than_declared_is_seldom_an_outlier_at_the_second_sample():
    rng = np.random.default_rng(0)
    third = [fed(rng.normal(0.0, 10.0, 3), before=0)[2] for _ in range(500)]
    assert sum(bool(outliers) for _, outliers in third) < 0.01 * len(third)


def test_the_first_jump_of_all_may_be_noise_of_ten_times_the_declared_size():
    """Three standard deviations of its changes: 30 sqrt(2) = 42.4."""
    assert fed([0.0, 42.0, 0.0], before=0)[2] == GOOD
    assert fed([0.0, 43.0, 0.0], before=0)[2] == OUTLIER
    assert fed([0.0, 42.0, 0.0], before=5)[2] == OUTLIER


def test_a_drift_is_no_jump():
    assert fed(np.arange(100.0)) == [GOOD] * 100


def test_what_is_usual_is_the_median_of_the_newest_changes():
    """1.4826 times it is the standard deviation: the limit is 11.86 times the changes seen."""
    noise = [10.0 * (k % 2) for k in range(40)]
    for jump, is_far in ((118.0, False), (119.0, True)):
        assert fed([*noise, noise[-1] + jump])[-1] == (SUSPECT if is_far else GOOD)
    assert fed([*noise, *[noise[-1]] * 14, noise[-1] + 50.0])[-1] == GOOD  # 17 of 31
    assert fed([*noise, *[noise[-1]] * 16, noise[-1] + 50.0])[-1] == SUSPECT


@pytest.mark.parametrize(("jump", "is_far"), [(0.0, False), (50.0, False), (53.0, False), (54.0, True)])
def test_where_the_model_moves_much_its_error_may_move_as_much(jump, is_far):
    """By 21.34 standard deviations: |jump - 21.34| is beyond 11.31 + 21.34 from 53.99 on."""
    moves = 21.34
    assert fed([0.0, jump], inputs=[1.0, 1.0 + moves * SIGMA])[-1] == (SUSPECT if is_far else GOOD)


def test_more_than_five_suspects_in_a_row_are_believed():
    values = [0.0, *[100.0 * (-1.0) ** k for k in range(6)]]
    assert [is_suspect for is_suspect, _ in fed(values)] == [False, *[True] * 5, False]
    assert [is_suspect for is_suspect, _ in fed([*values, values[-1], values[-1] + 3000.0])][-2:] == [False, True]


def test_a_suspect_is_judged_by_what_was_in_force_at_it():
    """What was written for it is wrong by far, and the input moves: that is no jump of the sensor."""
    thetas = [THETA, THETA, 100.0 * THETA]
    assert fed([0.0, 50.0, 1.0], inputs=[1.0, 1.0, 1.0 + SIGMA], thetas=thetas) == [GOOD, SUSPECT, OUTLIER]


def test_only_the_sensor_that_jumped_is_named():
    pair = Sensors(
        ("der(x)", "der(y)", "x", "y"), (True,) * 4, (SIGMA,) * 2, (0, 1), (0.0,) * 2, residual, lambda t, s: [0.0] * 2
    )
    values = [(0.0, 0.0), (0.0, 1.0), (50.0, 2.0), (0.0, 1.0), (0.0, 0.0)]
    assert fed(values, sensors=pair) == [GOOD, GOOD, SUSPECT, OUTLIER, GOOD]


def test_a_residual_that_is_no_number_is_neither_suspect_nor_what_is_usual():
    """Where the model fails for some input."""
    thetas = [THETA, THETA, THETA * inf, THETA, THETA, THETA]
    assert fed([0.0, 0.0, 0.0, 0.0, 50.0, 0.0], thetas=thetas) == [GOOD] * 4 + [SUSPECT, OUTLIER]
    assert fed([0.0] * 3 + [50.0, 0.0], inputs=[1.0, nan, 1.0, 1.0, 1.0]) == [GOOD] * 3 + [SUSPECT, OUTLIER]


def test_the_estimator_gets_what_is_suspect_and_hears_that_it_was_an_outlier():
    watched, samples = screen(), moving(12)
    samples[6] = replace(samples[6], xdot=(2.0,))
    seen = steps(watched, samples)
    assert all(s.sample is not None for s in seen)
    assert [s.is_suspect for s in seen] == [k == 6 for k in range(12)]
    assert [s.was_outlier for s in seen] == [k == 7 for k in range(12)]
    assert told(seen[7]) == [("outlier", "der(x)")]
    assert watched.summary() == {"kept_out": 1, "found": {"outlier der(x)": 1}, "failed": []}


def test_a_suspect_waits_for_the_next_sample_that_is_sound():
    watched, samples = screen(), moving(12)
    samples[6] = replace(samples[6], xdot=(2.0,))
    samples[7] = replace(samples[7], xdot=(nan,))
    seen = steps(watched, samples)
    assert [s.was_outlier for s in seen] == [k == 8 for k in range(12)]


# Derivatives that do not fit the motion: over n steps by more than 8 standard deviations of what is summed.


def inconsistent(n=60, bias=0.0, rates=None, times=None, inputs=None, noise=SIGMA, state_noise=0.0, model=slope):
    """Numbers of the samples that are inconsistent; rates: of the state, 1 where there are none."""
    watched = Consistency((0,), (noise,), (state_noise,), model, 8.0, H)
    rates = np.ones(max(n, np.size(bias))) if rates is None else np.array(rates, dtype=float)
    biases = np.broadcast_to(bias, len(rates))
    x, odd = H * np.cumsum(rates), []
    for k, rate in enumerate(rates):
        t = k * H if times is None else times[k]
        u = 1.0 if inputs is None else inputs[k]
        if watched.step(Sample(t, (x[k],), (u,), (rate + biases[k],)), THETA).derivatives:
            odd.append(k)
    return odd


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("bias", "first"), [(1.0, 5), (0.0195, 17), (0.0179, 20), (0.0178, None)])
def test_how_large_a_bias_is_found_and_when(bias, first, sign):
    """n bias H > 8 SIGMA H sqrt(n), from 5 steps on and up to 20."""
    assert inconsistent(bias=sign * bias) == ([] if first is None else [*range(first, 60)])


@pytest.mark.parametrize(("bias", "is_found"), [(0.0560, False), (0.0570, True)])
def test_noise_of_the_state_hides_a_bias(bias, is_found):
    """20 bias H > 8 sqrt(2) 0.01."""
    assert bool(inconsistent(bias=bias, noise=1e-9, state_noise=0.01)) == is_found


@pytest.mark.parametrize(("bias", "is_found"), [(4.78, False), (4.83, True)])
def test_noise_that_was_not_declared_hides_a_bias(bias, is_found):
    """With changes of 2: 8 sqrt(20) 1.05 2 H + H/2 (20 2 + 2) = 9.61 = 20 bias H."""
    scatter = np.array([(-1.0) ** k for k in range(60)])
    assert bool(inconsistent(bias=bias + scatter, noise=1e-9)) == is_found


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("bias", "is_found"), [(0.1178, False), (0.1180, True)])
def test_the_rectangle_errs_where_the_modelled_derivative_changes(bias, is_found, sign):
    """By 0.1 in every step: bias > 0.1 + 8 SIGMA / sqrt(20)."""
    assert bool(inconsistent(bias=bias, model=lambda theta, x, u: [sign * x[0]])) == is_found


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_wanders_to_both_sides_is_consistent_once_it_has_done_so(seed):
    """The noise has 3 declared standard deviations and a correlation of 0.95, as scipy's filter makes it."""
    white = np.random.default_rng(seed).standard_normal(3000)
    noise = lfilter([3.0 * SIGMA * np.sqrt(1.0 - 0.95**2)], [1.0, -0.95], white)
    odd = inconsistent(bias=noise)
    assert len([k for k in odd if k < 1500]) > 20
    assert len([k for k in odd if k >= 1500]) <= 60
    biased = np.where(np.arange(3000) < 2000, noise, noise + 20.0 * SIGMA)
    assert {*range(2100, 3000)} <= {*inconsistent(bias=biased)}


@pytest.mark.parametrize("size", [0.05, 0.2])
def test_what_is_beyond_to_one_side_or_far_beyond_is_no_noise_that_wanders(size):
    """One bias comes and goes on one side; the other has 20 standard deviations and changes its side."""
    sign = np.repeat([1.0, 0.0, 1.0 if size < 0.1 else -1.0, 0.0, 1.0], 100)
    odd = {*inconsistent(bias=size * sign, rates=np.full(500, 10.0))}  # large: 20 deviations are no gain
    assert {*range(430, 500)} <= odd


def test_an_input_that_was_held_over_the_step_is_no_error_of_the_rectangle():
    inputs = [100.0 * (-1.0) ** k for k in range(60)]
    assert inconsistent(bias=0.0195, inputs=inputs) == [*range(17, 60)]


def test_a_jump_of_the_motion_is_consistent():
    assert inconsistent(rates=[0.0] * 30 + [5.0] * 30) == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("rate", "excess", "within"), [(0.07, 0.25, 200), (0.035, 0.25, 400), (0.3, 0.05, 0), (0.16, 0.1, 0)]
)
def test_a_wrong_gain_that_no_twenty_samples_show_is_found_in_some_hundred(rate, excess, within, sign):
    """A sine of 120 samples, whose blocks of 20 have means of 0.95 rate cos 30 degrees and 0.

    No bias reaches 0.0179. The gain is wrong by excess / (1 + excess): it must exceed 0.1, and 8 standard deviations,
    that is 8 SIGMA sqrt(20) by 20 rate sqrt(5) 0.67, or 0.012 / rate; over ten blocks 0.0085 / rate.
    """
    rates = sign * rate * np.sin(2.0 * np.pi * np.arange(400) / 120)
    odd = inconsistent(rates=rates, bias=excess * rates)
    assert bool(odd) == bool(within)
    assert not odd or 100 <= odd[0] <= within


def test_a_derivative_in_another_unit_stays_inconsistent_where_the_state_hardly_moves():
    """Its noise is larger as well, and explains everything to who takes it for the sensor's own."""
    rng = np.random.default_rng(0)
    rates = 3.0 * SIGMA * np.sin(np.arange(300) / 40.0)
    measured = rates + rng.normal(0.0, SIGMA, 300)
    odd = inconsistent(rates=rates, bias=np.where(np.arange(300) < 100, 1.0, 57.3) * measured - rates)
    assert set(range(105, 300)) <= set(odd)


def test_the_noise_of_a_derivative_is_no_wrong_gain_where_the_state_stands_still():
    gain, one = DerivativeGain(limit=5.0), np.ones(1)
    for noise in np.random.default_rng(0).normal(0.0, 1.0, (200, 1)):
        gain = gain.take(0.0 * one, noise, 0.0 * one, 0.0 * one, one, one)
        assert not np.any(gain.n_wrong)


def test_an_offset_is_no_wrong_gain():
    """The motion slows down until the offset is a half of it."""
    rates = np.linspace(0.06, 0.02, 200)
    assert inconsistent(rates=rates, bias=0.012) == []


def test_many_spikes_in_a_row_are_no_wrong_gain():
    """They are a third of one block of twenty samples, and of no other."""
    odd = inconsistent(bias=[5.0 * (130 <= k < 134) for k in range(300)])
    assert odd
    assert odd[-1] < 131 + 60


def test_the_gain_is_1_where_the_derivative_changes_within_a_step():
    """A lag of two steps behind stairs of 1, 2 and 3: the rectangles have 1.54 / 2 of each, the trapezoids 2.04 / 2."""
    stairs = np.cumsum(np.resize([1.0, 2.0, 3.0], 15)).repeat(SUMMED)
    x = lfilter([1.0 - exp(-0.5)], [1.0, -exp(-0.5)], stairs)  # exact, as the input is held over a step
    watched = Consistency((0,), (SIGMA,), (0.0,), lambda theta, x, u: [(u[0] - x[0]) / (2.0 * H)], 8.0, H)
    samples = [Sample(k * H, (x[k],), (u,), ((u - x[k]) / (2.0 * H),)) for k, u in enumerate(stairs.tolist())]
    assert not any(watched.step(sample, THETA).derivatives for sample in samples)


def test_a_gain_that_changes_its_sign_with_the_motion_is_one_too():
    """A quarter too much at each turn, of a sine of 120 samples; a bias of the same size is none."""
    rates = 0.08 * np.sign(np.sin(2.0 * np.pi * np.arange(400) / 120))
    assert inconsistent(rates=rates, bias=0.2 * rates, noise=SIGMA)
    assert not inconsistent(rates=rates, bias=0.2 * np.abs(rates), noise=SIGMA)


@pytest.mark.parametrize(("rest", "last"), [(0.0095, 89), (0.0088, 67)])
def test_what_was_inconsistent_is_so_until_it_has_been_below_half_of_the_limit_for_20_samples(rest, last):
    """20 bias H > 4 SIGMA H sqrt(20) + H/2 (0.03 - rest), the last for the change while it is among the newest 20."""
    odd = inconsistent(bias=[0.03] * 30 + [rest] * 60)
    assert odd == [*range(odd[0], last + 1)]
    assert inconsistent(bias=rest) == []


@pytest.mark.parametrize("n", [2, 3])
def test_after_a_few_spikes_in_a_row_a_derivative_is_trusted_again_at_once(n):
    """From the second on, and for three samples more for each; single spikes every 15 samples are not inconsistent."""
    spikes = [5.0 * (30 <= k < 30 + n or (k > 40 and k % 15 == 0)) for k in range(200)]
    assert inconsistent(bias=spikes) == [*range(31, 31 + 4 * (n - 1) - 1)]


def test_many_spikes_in_a_row_are_a_fault_for_as_long_as_they_are_among_the_newest():
    odd = inconsistent(bias=[5.0 * (30 <= k < 34) for k in range(100)])
    assert odd == [*range(31, odd[-1] + 1)]
    assert odd[-1] > 31 + 20


def test_a_wrong_sign_does_not_fit_where_the_derivative_is_small_either():
    rates = np.sin(2.0 * np.pi * np.arange(400) / 200)
    assert inconsistent(400, rates=rates, bias=-2.0 * rates) == [*range(5, 400)]


def test_a_wrong_sign_that_fits_but_for_a_few_samples_is_no_burst_of_spikes():
    """The derivative is large for a few samples of each half wave of ten, and neither comes nor goes at once."""
    rates = 0.05 * np.sin(2.0 * np.pi * np.arange(200) / 20) ** 3
    assert len(inconsistent(200, rates=rates, bias=-2.0 * rates)) >= 29  # 19 where they are left out as spikes


def test_after_a_spike_of_the_state_its_derivative_is_trusted():
    """The spike is in the sum of 20 motions when it begins, at 30, and by its end alone at 50: each is a jump."""
    watched = Consistency((0,), (SIGMA,), (0.0,), slope, 8.0, H)
    told = [watched.step(Sample(k * H, (k * H + (k == 30),), (1.0,), (1.0,)), THETA) for k in range(60)]
    assert not any(contradictions.derivatives for contradictions in told)
    assert [k for k, contradictions in enumerate(told) if contradictions.jumps] == [30]


def test_what_was_far_at_a_suspect_is_an_outlier_however_much_the_write_due_to_it_moves_the_input():
    """The model's change is in the limit: its error may be as large."""
    assert fed([0.0, 50.0, 60.0], inputs=[1.0, 1.0, 1.0 + 60.0 * SIGMA]) == [GOOD, SUSPECT, OUTLIER]


def test_a_jump_that_the_moved_input_has_made_smaller_is_no_outlier():
    """With other parameters, residuals change with the input: a fifth of the jump is left, which is no noise."""
    assert fed([0.0, 50.0, 75.0], inputs=[1.0, 1.0, 1.0 + 60.0 * SIGMA])[2] != OUTLIER


def test_a_suspect_waits_for_the_next_sample_once_there_has_been_an_outlier():
    """It is confirmed by the next, then, which is used."""
    watched, samples = screen(), moving(40)
    for k in (6, 20):
        samples[k] = replace(samples[k], xdot=(2.0,))
    samples[30:] = [replace(s, xdot=(s.xdot[0] + 1.0,)) for s in samples[30:]]
    seen = steps(watched, samples)
    assert [k for k, s in enumerate(seen) if s.sample is None][:2] == [20, 30]
    assert [k for k, s in enumerate(seen) if s.is_suspect] == [6]
    assert [k for k, s in enumerate(seen) if s.was_outlier] == [7, 21]


@pytest.mark.parametrize(("n_wrong", "is_used"), [(2, True), (3, False)])
def test_the_derivatives_that_are_right_are_used_while_they_are_a_half_at_least(n_wrong, is_used):
    n, names = 4, ("der(a)", "der(b)", "der(c)", "der(d)", "a", "b", "c", "d")
    sensors = Sensors(
        names, (True,) * n + (False,) * n, (SIGMA,) * n, (0, 1, 2, 3), (0.0,) * n,
        lambda theta, s: (np.array(s.xdot) - 1.0) / SIGMA, lambda theta, x, u: [1.0] * n,
    )  # fmt: skip
    watched, rng = screen(sensors), np.random.default_rng(0)
    bias = np.array([1.0 * (i < n_wrong) for i in range(n)])
    for k in range(60):
        rates = 1.0 + bias * (k > 30) + rng.normal(0.0, SIGMA, n)
        seen = watched.step(k * H, Sample(k * H, (k * H,) * n, (1.0,), tuple(rates)), THETA)
    assert (seen.sample is not None) == is_used
    assert seen.sample is None or [v != v for v in seen.sample.xdot] == [True, True, False, False]


def test_one_spike_is_no_bias():
    assert inconsistent(bias=[5.0 * (k == 30) for k in range(60)]) == []


def test_after_a_gap_it_begins_anew():
    times = [(k + 3 * (k >= 30)) * H for k in range(60)]
    assert inconsistent(bias=1.0, times=times) == [*range(5, 30), *range(35, 60)]
    jitter = [(k + 0.2 * (k % 2)) * H for k in range(60)]
    assert inconsistent(bias=1.0, times=jitter) == [*range(5, 60)]


def test_what_is_inconsistent_is_kept_out_and_what_is_missing_is_not_summed():
    watched, samples = screen(), [replace(s, xdot=(s.xdot[0] + 1.0,)) for s in moving(12)]
    assert [found(watched, s) for s in samples][4:6] == [(set(), True), ({"inconsistent der(x)"}, False)]
    samples[8] = replace(samples[8], xdot=(nan,))
    watched = screen()
    assert [found(watched, s)[0] for s in samples][8:10] == [{"missing der(x)"}, set()]


def test_samples_before_a_sensor_is_found_to_be_faulty_are_doubtful():
    """Three times as many as are summed, as a derivative begins to be inconsistent; then twice all that are judged."""
    watched = screen(patience=20)
    doubtful = [seen.n_doubtful for seen in steps(watched, [replace(s, xdot=(2.0,)) for s in moving(40)])]
    assert {k: n for k, n in enumerate(doubtful) if n} == {5: 60, 15: 40}
    assert watched.summary()["failed"] == ["der(x)"]
    watched = screen(patience=20)
    seen = steps(watched, [replace(s, xdot=(nan,) if k > 20 else s.xdot) for k, s in enumerate(moving(40))])
    assert {k: s.n_doubtful for k, s in enumerate(seen) if s.n_doubtful} == {31: 40}


def test_limits_are_those_of_the_settings():
    sizes = sqrt(2.0) * np.array([2.9, 3.1])
    for size, is_suspect in zip(sizes, (False, True), strict=True):
        samples = moving(3)
        samples[2] = replace(samples[2], xdot=(1.0 + size * SIGMA,))
        assert steps(screen(outlier=3.0), samples)[-1].is_suspect == is_suspect


# Two derivatives, of which one is missing.

PAIR = Sensors(
    ("der(x)", "der(y)", "x", "y"), (True, True, False, False), (SIGMA, SIGMA), (0, 1), (0.0, 0.0),
    lambda theta, sample: np.array([0.0 if v != v else (v - 1.0) / SIGMA for v in sample.xdot]),
    lambda theta, x, u: [1.0, 1.0],
)  # fmt: skip


def pair(n, is_missing, der_y=lambda k: 1.0):
    rng = np.random.default_rng(0)
    for k in range(n):
        x, y = rng.normal([1.0, der_y(k)], 0.1 * SIGMA)
        yield Sample(k * H, (k * H, k * H), (1.0,), (nan if is_missing(k) else x, y))


@pytest.mark.parametrize("is_missing", [lambda k: False, lambda k: k >= 10], ids=["both", "one is missing"])
def test_a_wrong_derivative_is_found_beside_one_that_is_missing(is_missing):
    watched = screen(PAIR)
    seen = [found(watched, s)[0] for s in pair(60, is_missing, lambda k: -1.0 if k >= 30 else 1.0)]
    assert not any("inconsistent der(y)" in told for told in seen[:30])
    assert all("inconsistent der(y)" in told for told in seen[33:])


def test_a_spike_is_found_beside_a_derivative_that_is_missing():
    watched = screen(PAIR, inconsistent=1e9)
    seen = steps(watched, pair(60, lambda k: k >= 10, lambda k: 51.0 if k == 40 else 1.0))
    assert [k for k, s in enumerate(seen) if s.is_suspect] == [40]
    assert [k for k, s in enumerate(seen) if s.was_outlier] == [41]


def test_a_suspect_is_retracted_though_the_next_sample_lacks_another_derivative():
    watched = screen(PAIR, inconsistent=1e9)
    seen = steps(watched, pair(60, lambda k: k == 41, lambda k: 51.0 if k == 40 else 1.0))
    assert (seen[40].is_suspect, seen[41].was_outlier) == (True, True)
    assert np.isnan(seen[41].sample.xdot[0])
    assert seen[41].sample.xdot[1] == pytest.approx(1.0, abs=SIGMA)


# The states that a filter makes derivatives of, which has an output every few points.


def filtered(n_points, every, *, is_kinematic=False):
    still = lambda theta, x, u: [1.0]  # noqa: E731
    nothing = lambda theta, sample: np.empty(0)  # noqa: E731
    others = (THETA,) if is_kinematic else ()
    sensors = Sensors(("x",), (True,), (), (), (SIGMA,), nothing, still, others)
    states = SampleScreen(ObservationSettings(), sensors, H)
    return FilteredScreen(states, (SIGMA,), n_points, every, lambda theta, sample: np.array(sample.y, bool))


def through(watched, measured):
    """Whether the estimator gets the filter's output at each of these samples, which is made of the newest ones."""
    return [watched.step(s.t, s, THETA, s).sample is not None for s in measured]


def test_no_output_of_a_filter_passes_that_a_missing_value_is_part_of():
    samples = [replace(s, xdot=()) for s in moving(20, first=1)]
    samples[9] = replace(samples[9], x=(nan,))
    passes = through(filtered(4, 1), samples)
    assert passes == [False] * 2 + [True] * 7 + [False] * 4 + [True] * 7  # the exact sample before them is one of four


def carried(n, change=lambda k: 0.0, seed=0):
    """n samples of a state that moves as modelled but for a change (1,) of each, with noise."""
    rng = np.random.default_rng(seed)
    return [Sample(k * H, (k * H + change(k) + rng.normal(0.0, SIGMA),), (1.0,), ()) for k in range(1, n + 1)]


@pytest.mark.parametrize("parity", [0, 1], ids=["made with it", "made without it"])
def test_no_output_of_a_filter_passes_that_an_isolated_value_is_part_of(parity):
    """The next value tells, so that an output which ends with it waits, and is not passed then."""
    samples, watched = carried(60, lambda k: 30.0 * SIGMA if k == 41 else 0.0), filtered(4, 2)
    made = [s.t if k % 2 == parity else None for k, s in enumerate(samples)]
    seen = [watched.step(s.t, s if t else None, THETA, s) for s, t in zip(samples, made, strict=True)]
    assert [told(one) for one in seen if told(one)] == [[("outlier", "x")]]
    passed = [k for k, one in enumerate(seen, 1) if one.sample is not None]
    assert passed == [k for k in range(3, 61) if k % 2 != parity and not 41 <= k < 45]


def test_an_output_of_a_filter_after_a_step_of_its_state_passes_one_sample_late():
    samples, watched = carried(60, lambda k: 30.0 * SIGMA if k >= 41 else 0.0), filtered(4, 2)
    seen = [watched.step(s.t, s if k % 2 else None, THETA, s) for k, s in enumerate(samples, 1)]
    assert [k for k, one in enumerate(seen, 1) if one.sample is not None and k > 36] == [37, 39, 42, *range(43, 61, 2)]
    assert seen[41].sample is samples[40]
    assert watched.summary()["found"] == {}


def test_a_derivative_beside_a_corner_of_the_model_is_left_out_but_not_two_in_a_row():
    """Whether the model has one at a sample is in y."""
    corners = [(0, 0), (1, 0), (1, 1), (1, 1), (1, 1), (0, 0)]
    samples, watched = carried(20), filtered(4, 1)
    made = [replace(s, xdot=(1.0, 2.0), y=(0, 0)) for s in samples]
    for k, y in enumerate(corners, 10):
        made[k] = replace(made[k], y=y)
    seen = [watched.step(s.t, m, THETA, s).sample for s, m in zip(samples, made, strict=True)]
    left = [None if s is None else s.xdot for s in seen[10:16]]
    assert str(left) == str([(1.0, 2.0), (nan, 2.0), (1.0, 2.0), None, (1.0, 2.0), (1.0, 2.0)])
    assert all(s is not None for s in seen[16:])


def test_an_isolated_value_is_told_once_though_it_is_a_jump_against_the_motion_too():
    samples, watched = carried(60, lambda k: 30.0 * SIGMA if k == 41 else 0.0), filtered(4, 2, is_kinematic=True)
    for s in samples:
        watched.step(s.t, s, THETA, s)
    assert watched.summary()["found"] == {"jump x": 1}


def test_a_stuck_state_is_told_and_as_many_outputs_of_the_filter_are_doubtful_as_were_made_since():
    rng = np.random.default_rng(1)
    samples = [Sample(k * H, (k * H + rng.normal(0.0, SIGMA),), (1.0,), ()) for k in range(1, 60)]
    samples += [Sample(k * H, samples[-1].x, (1.0,), ()) for k in range(60, 160)]
    watched = filtered(4, 5)
    seen = [watched.step(s.t, s, THETA, s) for s in samples]
    failed = next(one for one in seen if told(one, "sensor"))
    assert told(failed, "sensor") == [(None, "x")]
    assert failed.n_doubtful == 2 * ObservationSettings().patience // 5
    assert watched.summary()["failed"] == ["x"]
    assert all(one.sample is None for one in seen[-40:])


def test_between_two_outputs_of_a_filter_there_is_no_sample():
    watched = filtered(4, 1)
    seen = [watched.step(s.t, None, THETA, replace(s, xdot=())) for s in moving(10, first=1)]
    assert all(one.sample is None and not one.events for one in seen)


# Outputs and measured states, for roll-outs.


def outputs_screen(**options):
    return OutputScreen(ObservationSettings(), {"x": SIGMA}, {"x": SIGMA, "v": SIGMA}, H, **options)


def rolled(n, seed=0):
    """n samples of a position, which is the output, and a velocity; both are measured."""
    rng, t = np.random.default_rng(seed), H * np.arange(1, n + 1)
    x, v = np.sin(t) + rng.normal(0.0, SIGMA, n), np.cos(t) + rng.normal(0.0, SIGMA, n)
    return [Sample(*row) for row in zip(t.tolist(), zip(x, v, strict=True), [(1.0,)] * n, [()] * n, [(a,) for a in x])]


def test_an_isolated_output_is_told_by_the_next_sample_and_as_a_state_is_the_mean_of_its_neighbours():
    samples, watched = rolled(100), outputs_screen()
    spike = replace(samples[60], x=(9.0, samples[60].x[1]), y=(9.0,))
    seen = steps(watched, [*samples[:60], spike, *samples[61:]])
    assert told(seen[61]) == [("outlier", "x")]
    before = seen[61].before
    assert np.isnan(before.y[0])
    assert before.x == (pytest.approx(0.5 * (samples[59].x[0] + samples[61].x[0])), samples[60].x[1])
    assert [one.sample for one in seen] == [*samples[:60], spike, *samples[61:]]
    assert [k for k, one in enumerate(seen) if one.before is not None] == [61]


def test_a_state_that_is_stuck_ends_the_scoring_though_only_roll_outs_begin_in_it():
    samples, watched = rolled(300), outputs_screen()
    samples[100:] = [replace(s, x=(s.x[0], 0.5)) for s in samples[100:]]
    seen = steps(watched, samples)
    assert watched.summary()["failed"] == ["v"]
    assert all(np.isnan(one.sample.y[0]) for one in seen[200:])
    assert [told(one, "sensor") for one in seen if told(one, "sensor")] == [[(None, "v")]]


def test_values_that_a_log_lacks_are_no_fault_of_their_sensors():
    samples = rolled(50)
    samples[20] = replace(samples[20], x=(nan, samples[20].x[1]), y=(nan,))
    seen = steps(outputs_screen(may_be_missing=True), samples)
    assert all(not one.events for one in seen)
    assert np.isnan(seen[20].sample.y[0])
