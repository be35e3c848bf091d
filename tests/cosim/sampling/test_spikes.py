"""Spikes in sampled values: what is isolated is found, what changes or lies between the steps of a sensor is not."""

import numpy as np
import pytest

from cosim.sampling.spikes import Spikes

SIGMA = 0.01


def found(values, noise=SIGMA):
    """The places of the spikes, and the mean of their neighbours."""
    watched = Spikes((noise,))
    means = [float(watched.step((v,))[0]) for v in values]
    return {k - 1: mean for k, mean in enumerate(means) if mean == mean}


def noisy(course, seed=0):
    return np.asarray(course) + np.random.default_rng(seed).normal(0.0, SIGMA, len(course))


COURSES = {
    "still": np.zeros(400),
    "ramp": 0.3 * np.arange(400.0),
    "wave": np.sin(0.05 * np.arange(400.0)),
    "unstable": 1e-6 * np.exp(0.04 * np.arange(400.0)),
}


@pytest.mark.parametrize("course", COURSES.values(), ids=COURSES)
@pytest.mark.parametrize("seed", range(5))
def test_noise_about_a_smooth_course_has_no_spikes(course, seed):
    assert found(noisy(course, seed)) == {}


@pytest.mark.parametrize("course", COURSES.values(), ids=COURSES)
def test_each_isolated_value_is_found_and_the_mean_of_its_neighbours_is_what_the_course_is_there(course):
    values, places = noisy(course), [20, 60, 62, 200, 301]
    values[places] += [1.0, -2.0, 1.5, 50.0, -1.0]
    spikes = found(values)
    assert sorted(spikes) == places
    assert list(spikes.values()) == pytest.approx(course[places], abs=0.05)


BENDS = {
    "step": lambda k: 0.5 * (k >= 100),
    "kink": lambda k: 5.0 * np.maximum(k - 100, 0),
    "collision": lambda k: np.abs(k - 100.0),
    "pulse": lambda k: 3.0 * ((k >= 100) & (k < 102)),
}


@pytest.mark.parametrize("course", BENDS.values(), ids=BENDS)
def test_a_course_that_bends_or_jumps_has_no_spikes(course):
    assert found(noisy(course(np.arange(400)))) == {}


@pytest.mark.parametrize("step", [0.02, 0.1, 1.0])
def test_a_coarse_sensor_has_no_spikes(step):
    assert found(step * np.round(np.sin(0.02 * np.arange(800.0)) / step)) == {}


def test_a_series_without_noise_and_the_first_ten_values_have_none():
    values = np.zeros(100)
    values[[5, 80]] = 7.0
    assert found(values, 0.0) == {}
    assert set(found(values)) == {80}


def test_a_missing_value_is_none_and_its_neighbours_are_not_judged():
    values = noisy(COURSES["ramp"])
    values[[100, 101, 150]] = np.nan
    values[[102, 160]] += 3.0
    assert set(found(values)) == {160}


def test_series_side_by_side_do_not_disturb_each_other():
    values = np.column_stack([noisy(COURSES["wave"], 1), noisy(COURSES["ramp"], 2)])
    values[100, 1] += 5.0
    watched = Spikes((SIGMA, SIGMA))
    spikes = np.isfinite([watched.step(row) for row in values])
    assert np.argwhere(spikes).tolist() == [[101, 1]]
