"""Lags of inputs whose means over several steps samples have: a lag acts in each step."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimator.effects.input_lag import FoundLag, InputHistory
from estimator.effects.lag import Lag
from estimator.effects.step_means import StepMeans
from estimator.hypotheses import NEVER
from estimator.samples import Sample

STEP, SIGMA = 0.02, 0.01
N_STEPS = 400
MEANS = StepMeans((-0.05, 0.0, 0.1, 0.2, 0.25, 0.25, 0.15, 0.1, 0.05, 0.0, -0.05), 0.1, 11)
TIMES = STEP * np.arange(1, N_STEPS + 1)
FINE = 200
"""Substeps of a step by which the truth is made."""


def sent():
    """Inputs (N, 2) held up to each time; the second one is measured."""
    t = TIMES - STEP
    return np.column_stack([np.sin(1.7 * t) + 0.6 * np.sign(np.sin(0.9 * t)), np.cos(2.3 * t)])


def behind(law, v=0.4):
    """What arrives of the first input in the mean over each step (N,), by small steps; law(v, u, dt): the next v."""
    means = []
    for u in sent()[:, 0]:
        way = []
        for _ in range(FINE):
            before, v = v, law(v, u, STEP / FINE)
            way.append((before + v) / 2.0)
        means.append(np.mean(way))
    return np.array(means)


def late(n):
    return np.concatenate([np.full(n, 0.4), sent()[:-n, 0]])


def samples_of(arrives, places):
    """Residuals with each of k sets of inputs (k, n, 2) of samples whose newest steps are at places (n,)."""
    true = MEANS.of(np.column_stack([arrives, sent()[:, 1]]), places)
    noise = SIGMA * np.random.default_rng(3).standard_normal((len(places), 1))
    return lambda inputs: ((true - inputs) @ [[2.0], [-1.0]] + noise) / SIGMA


def with_samples(n_steps=N_STEPS, every=11):
    """A history, and the places of its samples' newest steps."""
    history, places = InputHistory((0,), means=MEANS), []
    for k, u in enumerate(sent()[:n_steps].tolist()):
        history.take_input(float(TIMES[k]), tuple(u))
        if k >= 10 and not (k - 10) % every:
            history.take(Sample(float(TIMES[k]) - MEANS.delay, (0.0,), (9.0, 9.0), (0.0,)))
            places.append(k)
    return history, np.array(places)


def found_in(arrives, first=0):
    """The history and the lag that the samples from the first on show."""
    history, places = with_samples()
    places = places[first:]
    times = [float(TIMES[k]) - MEANS.delay for k in places]
    return history, history.search(samples_of(arrives, places), times)


def following(tau):
    return behind(lambda v, u, dt: u + (v - u) * np.exp(-dt / tau))


@pytest.mark.parametrize("first", [0, 20])
@pytest.mark.parametrize("tau", [0.01, 0.04, 0.16, 0.6])
def test_a_time_constant_of_half_a_step_to_three_samples_is_found(tau, first):
    history, found = found_in(following(tau), first)
    assert found.fit.is_explained
    assert found.lag == Lag(pytest.approx(tau, rel=0.03, abs=1e-3))
    assert history.describe(found.lag, ("u", "w"))["time_constant"] == found.lag.time_constant


@pytest.mark.parametrize("n", [2, 5, 16, 29, 60])
def test_a_dead_time_is_found_to_the_step(n):
    history, found = found_in(late(n), 10)
    assert found.lag == Lag(n_late=n)
    assert found.fit.is_explained
    assert history.describe(found.lag, ("u", "w"))["dead_time"] == pytest.approx(n * STEP)


def test_a_limited_rate_is_found():
    _, found = found_in(behind(lambda v, u, dt: v + np.clip(u - v, -1.2 * dt, 1.2 * dt), 0.0))
    assert found.fit.is_explained
    assert found.lag.rates == (pytest.approx(1.2, rel=0.02),)


@pytest.mark.parametrize("rates", [(6.0, 6.0), (9.0, 4.0)])
def test_limited_rates_of_inputs_of_which_one_is_faster_are_found(rates):
    history, made, dt = InputHistory(), [], 0.05
    for k in range(56):
        t = dt * k
        u = np.array([3.0 * np.sin(1.7 * t), np.sin(0.9 * t)]) + np.array([9.0, 2.5]) * (k >= 40)
        made.append(u if not made else made[-1] + np.clip(u - made[-1], -dt * np.array(rates), dt * np.array(rates)))
        history.take(Sample(t, (0.0,), tuple(u.tolist()), (0.0, 0.0)))
    noise = SIGMA * np.random.default_rng(3).standard_normal((16, 2))
    true, effects = np.array(made)[-16:], np.array([[2.0, 0.7], [-1.0, 1.5]])
    found = history.search(
        lambda inputs: ((true - inputs) @ effects + noise) / SIGMA, (dt * np.arange(40, 56)).tolist()
    )
    assert found.fit.is_explained
    assert found.lag.rates == pytest.approx(rates, rel=0.02)


def test_inputs_that_do_not_change_have_no_lag():
    history = InputHistory((0,))
    for k in range(30):
        history.take(Sample(0.05 * k, (0.0,), (1.0, float(k)), (0.0,)))
    for size in (0.0, 9.0):
        found = history.search(
            lambda inputs, size=size: np.full((len(inputs), 20, 1), size), (0.05 * np.arange(10, 30)).tolist()
        )
        assert found.lag == Lag()


def test_a_limit_of_which_samples_have_means_is_found():
    _, found = found_in(np.minimum(sent()[:, 0], 0.9))
    assert found.fit.is_explained
    assert found.lag.limits == ((-np.inf, pytest.approx(0.9, abs=0.01)),)


@pytest.mark.parametrize("arrives", [following(0.16), late(5)], ids=["lag", "dead time"])
def test_a_lag_that_is_known_goes_on(arrives):
    """Also through a copy that takes later inputs again; samples' own inputs, means of what was sent, do not matter."""
    history, places = with_samples(250)
    times = [float(TIMES[k]) - MEANS.delay for k in places]
    history.adopt(history.search(samples_of(arrives, places), times))
    before = history.copy()
    for k, u in enumerate(sent()[250:].tolist(), 250):
        history.take_input(float(TIMES[k]), tuple(u))
        history.take(Sample(float(TIMES[k]) - MEANS.delay, (0.0,), (9.0, 9.0), (0.0,)))
    before.take_since(history)
    newest = np.arange(250, N_STEPS)
    true = MEANS.of(np.column_stack([arrives, sent()[:, 1]]), newest)
    for one in (history, before):
        made = np.array([one.arriving[float(TIMES[k]) - MEANS.delay] for k in newest])
        assert_allclose(made, true, atol=0.02)
        assert_allclose(made[:, 1], true[:, 1], rtol=1e-12)
    assert_array_equal(list(before.arriving.values()), list(history.arriving.values()))


def test_what_is_kept_is_bounded():
    """A hundred and twenty samples' worth, however long a run is, and nothing of samples whose inputs are not kept."""
    history = InputHistory(means=MEANS)
    history.take_input(-STEP, (0.3,))
    history.adopt(FoundLag(Lag(0.1), {-STEP: (0.3,)}, NEVER))
    for k in range(3000):
        history.take_input(STEP * k, (float(np.sin(0.1 * k)),))
        if not k % 11:
            history.take(Sample(STEP * k - MEANS.delay, (0.0,), (0.0,), (0.0,)))
    assert len(history._times) == len(history._inputs) == 120 * 11 + 10
    assert len(history._sampled) <= 120
    assert len(history._arriving) <= len(history._times)
    assert history.begin == pytest.approx(history._times[10] - MEANS.delay)
    assert history._sampled[0] >= history.begin
    assert set(history.arriving) <= set(history._sampled)


def test_samples_before_the_inputs_that_are_kept_have_none_that_arrive():
    history = InputHistory(means=MEANS, lag=Lag(0.1))
    assert history.begin == np.inf
    history.take(Sample(0.0, (0.0,), (0.0,), (0.0,)))
    assert not history.arriving
