"""Whether a state's sensor or its derivative's is named, on a mass with a spring: m v' = u - k s - c v, s' = v.

Its samples are exact, by the matrix exponential over each step, and noise is added.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from cosim.sampling.screen import SampleScreen, Sensors
from cosim.scenarios.schema.sampling import ObservationSettings
from estimator import Sample

H, K, C, M = 0.01, 4.0, 0.6, 1.3
SIGMA, NOISE = 0.02, 1e-3
THETA, OTHERS = np.array([M]), (np.array([0.5]), np.array([2.0]))
S, V, RATE = "s", "v", "der(v)"


def slope(theta, x, u):
    return [x[1], (u[0] - K * x[0] - C * x[1]) / theta[0]]


def residual(theta, sample):
    return np.array([(sample.xdot[0] - slope(theta, sample.x, sample.u)[1]) / SIGMA])


def screen(model=slope, noise=(NOISE, NOISE)):
    sensors = Sensors((RATE, S, V), (True, True, True), (SIGMA,), (1,), noise, residual, model, OTHERS)
    return SampleScreen(ObservationSettings(), sensors, H)


def oscillating(n, masses=lambda k: M, kick=lambda k: 0.0, noise=NOISE):
    """n samples under a force of 3 sin(3 t) + 2; kick: of the velocity, at a sample's beginning."""
    rng, x, samples = np.random.default_rng(1), np.array([0.4, 0.0]), []
    for k in range(n):
        t, m = k * H, masses(k)
        u = 3.0 * np.sin(3.0 * t) + 2.0
        a = np.array([[0.0, 1.0, 0.0], [-K / m, -C / m, u / m], [0.0, 0.0, 0.0]])
        x = (expm(H * a) @ [x[0], x[1] + kick(k), 1.0])[:2]
        rate = (u - K * x[0] - C * x[1]) / m
        measured = x + rng.normal(0.0, noise, 2)
        samples.append(Sample(t, (measured[0], measured[1]), (u,), (rate + rng.normal(0.0, SIGMA),)))
    return samples


def wrong(samples, name, error, first, last=10**9):
    """The samples with an error of one sensor, from one sample on."""

    def one(k, s):
        if not first <= k < last:
            return s
        x = tuple(error(v) if name == own else v for own, v in zip((S, V), s.x, strict=True))
        return replace(s, x=x, xdot=(error(s.xdot[0]),) if name == RATE else s.xdot)

    return [one(k, s) for k, s in enumerate(samples)]


def seen_in(samples, watched=None, theta=THETA):
    """The screen's results, and by sensor the numbers of the samples at which it is found to be inconsistent."""
    watched, results, found = watched or screen(), [], {}
    for k, sample in enumerate(samples):
        before = watched.summary()["found"]
        results.append(watched.step(sample.t, sample, theta))
        for key, n in watched.summary()["found"].items():
            if n > before.get(key, 0) and key.startswith("inconsistent "):
                found.setdefault(key.removeprefix("inconsistent "), []).append(k)
    return results, found


ERRORS = {
    "gain": lambda v: 1.3 * v,
    "sign": lambda v: -v,
    "unit": lambda v: 57.3 * v,
    "offset": lambda v: v + 0.3,
}


@pytest.mark.parametrize("error", ERRORS.values(), ids=ERRORS)
def test_a_state_that_becomes_wrong_is_named_and_no_sample_is_used(error):
    results, found = seen_in(wrong(oscillating(500), V, error, 130))
    assert set(found) <= {RATE, V}
    assert set(range(170, 500)) <= set(found[V])
    assert not [k for k in found.get(RATE, []) if k >= 170 or k < 130]
    assert all(seen.sample is None for seen in results[140:])  # at first the velocity is near 0, whatever the gain is
    assert all(seen.sample is not None for seen in results[:130])


@pytest.mark.parametrize("error", [ERRORS[name] for name in ("gain", "sign", "unit")], ids=["gain", "sign", "unit"])
def test_a_derivative_that_becomes_wrong_is_named_and_its_state_is_not(error):
    _, found = seen_in(wrong(oscillating(500), RATE, error, 130))
    assert set(found) == {RATE}
    assert min(found[RATE]) >= 130


def test_a_derivative_with_a_bias_is_named_and_its_state_is_not():
    _, found = seen_in(wrong(oscillating(500), RATE, lambda v: v + 1.5, 130))
    assert set(found) == {RATE}


@pytest.mark.parametrize(("mass", "kick"), [(M, 0.4), (2.5, 0.4), (0.8, -1.0), (4.0, 1.0)])
def test_a_collision_is_no_fault_of_the_state(mass, kick):
    """The velocity jumps, which no derivative shows, and with it the mass, as a load is picked up or lost.

    The estimator waits for four samples, and goes on.
    """
    samples = oscillating(400, lambda k: M if k < 150 else mass, lambda k: kick * (k == 150))
    watched = screen()
    results, found = seen_in(samples, watched)
    assert found == {}
    assert [k for k, seen in enumerate(results) if seen.sample is None] == [150, 151, 152, 153]
    assert watched.summary() == {"kept_out": 4, "found": {f"jump {V}": 1}, "failed": []}


def test_a_gap_in_time_while_it_is_undecided_is_no_error():
    samples = wrong(oscillating(300), V, ERRORS["offset"], 100)
    for first in (101, 102, 103, 104, 119):
        _, found = seen_in([*samples[:first], *samples[first + 2 :]])
        assert set(found) <= {RATE, V}


def test_a_changed_mass_is_no_fault():
    _, found = seen_in(oscillating(400, lambda k: M if k < 150 else 3.0 * M))
    assert found == {}


def test_a_sensor_that_is_right_again_is_forgiven():
    results, found = seen_in(wrong(oscillating(1300), V, ERRORS["gain"], 130, 800))
    assert 799 in found[V]
    assert max(max(numbers) for numbers in found.values()) < 800 + 150
    assert all(seen.sample is not None for seen in results[1010:])


# The position, whose derivative is not sampled: it is the velocity, whatever the mass and the force are.


@pytest.mark.parametrize("error", ERRORS.values(), ids=ERRORS)
def test_a_position_that_jumps_without_velocity_is_named(error):
    results, found = seen_in(wrong(oscillating(500), S, error, 130))
    assert min(found[S]) <= 130 + 20
    assert set(range(170, 500)) <= set(found[S])
    assert all(seen.sample is None for seen in results[130:])


def shifted(theta, x, u):
    """The slope where the position is counted from 0.4 on."""
    return slope(theta, (x[0] + 0.4, x[1]), u)


def test_a_gain_of_a_position_that_begins_without_a_jump_is_found():
    samples = [replace(s, x=(s.x[0] - 0.4, s.x[1])) for s in oscillating(700)]
    first = next(k for k in range(200, 700) if abs(samples[k].x[0]) < 3.0 * NOISE)
    _, found = seen_in(wrong(samples, S, ERRORS["gain"], first), screen(shifted))
    assert first < min(found[S]) < first + 300


def test_what_a_position_was_found_wrong_for_is_doubtful_far_back():
    """The gain shows after a hundred samples or more: as many again, and three times twenty, may be wrong as well."""
    samples = [replace(s, x=(s.x[0] - 0.4, s.x[1])) for s in oscillating(700)]
    first = next(k for k in range(200, 700) if abs(samples[k].x[0]) < 3.0 * NOISE)
    results, found = seen_in(wrong(samples, S, ERRORS["gain"], first), screen(shifted))
    at = min(found[S])
    assert results[at].n_doubtful >= at - first


@pytest.mark.parametrize("step", [1e-4, 1e-3, 3e-3, 1e-2, 2e-2])
def test_a_coarse_position_is_not_named(step):
    samples = [replace(s, x=(step * round(s.x[0] / step), s.x[1])) for s in oscillating(800, noise=0.0)]
    _, found = seen_in(samples, screen(noise=(0.0, 0.0)))
    assert S not in found


def test_an_angle_that_wraps_is_not_named():
    """A pendulum that turns over, at a rate of 1.5 rad/s on: each turn it jumps by 2 pi, and the model is the same."""

    def model(theta, x, u):
        return [x[1], -np.sin(x[0]) + u[0]]

    rng, x, samples = np.random.default_rng(0), np.array([0.0, 2.5]), []
    for k in range(1500):
        for _ in range(20):  # a midpoint rule of a twentieth of the step
            middle = x + 0.5 * (H / 20.0) * np.array(model(None, x, (0.0,)))
            x = x + (H / 20.0) * np.array(model(None, middle, (0.0,)))
        angle = (x[0] + np.pi) % (2.0 * np.pi) - np.pi
        measured = (angle + rng.normal(0.0, NOISE), x[1] + rng.normal(0.0, NOISE))
        samples.append(Sample(k * H, measured, (0.0,), (-np.sin(x[0]) + rng.normal(0.0, SIGMA),)))
    sensors = Sensors(
        (RATE, S, V), (True, True, True), (SIGMA,), (1,), (NOISE, NOISE),
        lambda theta, s: np.array([(s.xdot[0] - model(theta, s.x, s.u)[1]) / SIGMA]), model, OTHERS,
    )  # fmt: skip
    results, found = seen_in(samples, SampleScreen(ObservationSettings(), sensors, H))
    assert sum(abs(a.x[0] - b.x[0]) > 6.0 for a, b in pairwise(samples)) >= 4
    assert found == {}
    assert sum(seen.sample is None for seen in results) <= 10 * 6


@pytest.mark.parametrize(
    "model",
    [
        lambda theta, x, u: [x[1] * theta[0], slope(theta, x, u)[1]],
        lambda theta, x, u: [x[1] * (1.0 + 0.1 * (u[0] > 3.0)), slope(theta, x, u)[1]],
    ],
    ids=["parameter", "input"],
)
def test_a_state_whose_derivative_depends_on_parameters_or_inputs_is_not_checked(model):
    _, found = seen_in(wrong(oscillating(500), S, ERRORS["gain"], 130), screen(model))
    assert S not in found


def tank(n, error, first):
    """n samples of a tank, h' = u - a sqrt(h), whose level's sensor has an error from one sample on."""

    def model(theta, x, u):
        return [u[0] - theta[0] * max(x[0], 0.0) ** 0.5]

    rng, x, samples = np.random.default_rng(2), 1.0, []
    for k in range(n):
        u = 1.0 + 0.3 * np.sin(0.02 * k)
        for _ in range(10):  # Heun's rule over a tenth of the step
            rate = model((1.0,), (x,), (u,))[0]
            x += 0.05 * H * (rate + model((1.0,), (x + 0.1 * H * rate,), (u,))[0])
        level = x + rng.normal(0.0, NOISE)
        rate = model((1.0,), (x,), (u,))[0] + rng.normal(0.0, SIGMA)
        samples.append(Sample(k * H, (error(level) if k >= first else level,), (u,), (rate,)))
    sensors = Sensors(
        ("der(h)", "h"), (True, True), (SIGMA,), (0,), (NOISE,),
        lambda theta, s: np.array([(s.xdot[0] - model(theta, s.x, s.u)[0]) / SIGMA]), model, OTHERS,
    )  # fmt: skip
    return samples, SampleScreen(ObservationSettings(), sensors, H)


def test_a_wrong_state_stays_so_where_the_model_does_not_change_with_it():
    """The model clips a level below 0: no small correction of the wrong sign explains anything."""
    samples, watched = tank(600, ERRORS["sign"], 130)
    _, found = seen_in(samples, watched, np.array([1.0]))
    assert set(range(140, 600)) <= set(found["h"])


# Without any sampled derivative, as where a filter makes them, only such a motion tells a wrong sensor.


def states_screen(noise=(NOISE, NOISE)):
    nothing = lambda theta, sample: np.empty(0)  # noqa: E731
    return SampleScreen(ObservationSettings(), Sensors((S, V), (True, True), (), (), noise, nothing, slope, OTHERS), H)


def states_only(samples):
    return [replace(sample, xdot=()) for sample in samples]


@pytest.mark.parametrize("name", [S, V])
@pytest.mark.parametrize("error", [ERRORS["sign"], ERRORS["unit"], lambda v: v / 1000.0], ids=["sign", "unit", "milli"])
def test_a_state_in_a_wrong_unit_or_of_the_wrong_sign_is_found_as_soon_as_it_has_moved(name, error):
    """Each is a multiple of what it should be, far from 1."""
    results, found = seen_in(
        states_only(wrong(oscillating(300, noise=1e-5), name, error, 0)), states_screen((1e-5, 1e-5))
    )
    assert set(found) == {S}
    assert all(seen.sample is None for seen in results[25:])


def test_states_without_derivatives_that_are_right_are_used():
    results, found = seen_in(states_only(oscillating(500)), states_screen())
    assert found == {}
    assert all(seen.sample is not None for seen in results)


def test_a_motion_that_the_model_lacks_is_no_wrong_unit():
    """A road moves the wheel as much as its velocity does."""
    rng, samples = np.random.default_rng(4), states_only(oscillating(500))
    road = np.cumsum(rng.normal(0.0, 0.02, len(samples)))
    rough = [replace(s, x=(s.x[0] + float(r), s.x[1])) for s, r in zip(samples, road, strict=True)]
    results, found = seen_in(rough, states_screen())
    assert found == {}
    assert all(seen.sample is not None for seen in results)


@pytest.mark.parametrize("step", [0.05, 0.2])
def test_a_coarse_position_without_derivatives_is_not_named(step):
    coarse = [replace(s, x=(step * round(s.x[0] / step), s.x[1])) for s in states_only(oscillating(500))]
    _, found = seen_in(coarse, states_screen((0.0, NOISE)))
    assert found == {}


@pytest.mark.parametrize("first", range(200, 320, 15))
def test_a_velocity_whose_sign_becomes_wrong_is_found_at_its_third_sample(first):
    """The position shows it, which moves by 1e-3 a sample at least, a hundred times its noise."""
    samples = wrong(oscillating(360, noise=1e-5), V, ERRORS["sign"], first)
    assert abs(samples[first].x[1]) > 0.1
    results, found = seen_in(states_only(samples), states_screen((1e-5, 1e-5)))
    assert (found[S][0], set(found)) == (first + 2, {S})
    assert all(seen.sample is None for seen in results[first + 2 : first + 30])


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_a_blow_is_no_sensor_that_becomes_wrong(size):
    """It moves the position as well."""
    samples = states_only(oscillating(400, kick=lambda k: size if k == 250 else 0.0, noise=1e-5))
    _, found = seen_in(samples, states_screen((1e-5, 1e-5)))
    assert found == {}


@pytest.mark.parametrize("step", [0.002, 0.02])
def test_a_coarse_position_that_sets_off_is_not_named(step):
    """From rest on, by up to several steps of its sensor a sample; the velocity is exact."""
    moving = [(0.5 * 3.0 * (t := max(0.0, k * H - 1.0)) ** 2, 3.0 * t) for k in range(300)]
    coarse = [Sample(k * H, (step * round(s / step), v), (0.0,), ()) for k, (s, v) in enumerate(moving)]
    _, found = seen_in(coarse, states_screen((0.0, 0.0)))
    assert found == {}


# A sensor that is late: the motion by the integrated derivative differs by the derivative's change times the delay.


@pytest.mark.parametrize(("name", "named"), [(RATE, RATE), (S, S)])
def test_a_sensor_that_is_late_by_three_samples_is_named(name, named):
    exact = oscillating(900)
    late = [exact[max(0, k - 3)] for k in range(900)]
    samples = [
        replace(
            s,
            x=tuple(a if own == name else b for own, a, b in zip((S, V), old.x, s.x, strict=True)),
            xdot=old.xdot if name == RATE else s.xdot,
        )
        for s, old in zip(exact, late, strict=True)
    ]
    _, found = seen_in(samples)
    assert max(found, key=lambda sensor: len(found[sensor])) == named
    assert len(found[named]) > 300


def test_a_late_velocity_keeps_the_samples_out():
    """It is late for its own derivative, and the position is early for it."""
    exact = oscillating(900)
    late = [replace(s, x=(s.x[0], exact[max(0, k - 3)].x[1])) for k, s in enumerate(exact)]
    results, found = seen_in(late)
    assert {S, V} & {*found}
    assert sum(seen.sample is None for seen in results[300:]) > 300


def test_an_actuator_that_lags_is_no_delay_of_a_sensor():
    """The spring is stiff, and the force, with a time constant of two samples, balances it: the rate hardly changes."""
    rng, x, samples = np.random.default_rng(3), np.array([0.4, 0.0, 0.0]), []
    for k in range(1500):
        u = 3.0 * np.sin(3.0 * k * H) + 100.0 * K * x[0] - 20.0 * x[1] - 50.0 * x[0]
        a = np.zeros((4, 4))
        a[0, 1], a[1, :3], a[2, 2], a[2, 3] = 1.0, (-100.0 * K / M, -C / M, 1.0 / M), -0.5 / H, 0.5 * u / H
        x = (expm(H * a) @ [*x, 1.0])[:3]
        rate = a[1, :3] @ x
        samples.append(Sample(k * H, (x[0], x[1]), (u,), (rate + rng.normal(0.0, 1e-3),)))

    def model(theta, x, u):
        return [x[1], (u[0] - 100.0 * K * x[0] - C * x[1]) / theta[0]]

    sensors = Sensors(
        (RATE, S, V), (True, False, False), (1e-3,), (1,), (0.0, 0.0),
        lambda theta, s: np.array([(s.xdot[0] - model(theta, s.x, s.u)[1]) / 1e-3]), model, OTHERS,
    )  # fmt: skip
    assert max(abs(s.x[0]) for s in samples) < 2.0
    _, found = seen_in(samples, SampleScreen(ObservationSettings(), sensors, H))
    assert found == {}


def test_a_sensor_that_is_late_by_one_sample_is_not_named():
    """A solver of one step between samples errs by as much."""
    exact = oscillating(900)
    _, found = seen_in([replace(s, xdot=exact[max(0, k - 1)].xdot) for k, s in enumerate(exact)])
    assert found == {}
