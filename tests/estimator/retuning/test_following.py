"""The filter between searches, in a loop on a plant written here: drifts, jumps, and what the model lacks."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimator import DerivativeResidual, Parameter, ParameterSpace, Sample, TargetSettings, TargetVector
from estimator.diagnosis.sample_diagnosis import Diagnosis
from estimator.diagnosis.settings import DiagnosisSettings
from estimator.retuning.factory import make_retuner
from estimator.retuning.search import Budget
from estimator.triggers import InnovationSettings

SPACE = ParameterSpace((Parameter("a", 0.5, 5.0), Parameter("b", -4.0, -0.2)))
TRUE, CHANGED = np.array([2.0, -1.0]), np.array([3.2, -1.8])
SIGMA = 0.01
SEEDS = pytest.mark.parametrize("seed", range(3))


def model(x, u, a, b):
    return (a * u[0] + b * x[0], a * x[0] * u[0], b * x[0] + 0.5 * u[0])


class Loop:
    """A loop with sampled derivatives, whose controller writes what it is told to."""

    def __init__(self, seed=0, is_diagnosed=True, settings=None, n_channels=3):
        self.rng, self.k, self.held, self.events, self.writes, self.samples = (
            np.random.default_rng(seed),
            0,
            TRUE,
            [],
            0,
            [],
        )
        whitened = DerivativeResidual(model, SPACE, tuple(range(n_channels)), (SIGMA,) * n_channels)
        diagnosis = Diagnosis(whitened, ("f", "g", "h")[:n_channels], DiagnosisSettings(), None)
        self.n_channels = n_channels
        self.search = TargetVector(SPACE, TRUE, np.random.default_rng(seed + 1), settings)
        made = diagnosis if is_diagnosed else None
        self.retuner = make_retuner(self.search, whitened, InnovationSettings(), Budget(30, 3), 10, diagnosis=made)

    def go(self, n, truth, added=lambda i: 0.0):
        """Take n samples, of parameters and a disturbance that are functions of the number of the sample."""
        for i in range(n):
            t = 0.05 * self.k
            u, x = np.sin(1.7 * t) + 0.6 * np.sign(np.sin(0.9 * t)), np.cos(1.1 * t) + 0.5 * np.sin(4.3 * t + 0.3)
            clean = np.array(model((x,), (u,), *truth(i)))
            xdot = clean + added(i) + SIGMA * self.rng.standard_normal(3)
            self.take(Sample(t, (float(x),), (float(u),), tuple(xdot.tolist()[: self.n_channels])))
        return self

    def take(self, sample):
        proposal = self.retuner.step(sample.t, sample, 0.0, self.held)
        self.samples.append(sample)
        self.events += [event.kind for event in proposal.events]
        for theta in (proposal.theta, proposal.undo):
            if theta is not None:
                self.held, self.writes = theta, self.writes + 1
        self.k += 1


def constant(theta):
    return lambda i: theta


def drift(i):
    """0.1 % of the bounds of the first parameter a sample."""
    return CHANGED + np.array([0.0045 * i, 0.0])


def fast(i):
    """0.25 % of the bounds of the first parameter a sample."""
    return CHANGED + np.array([0.01125 * i, 0.0])


def slow(i):
    """0.13 % of the bounds of the first parameter a sample."""
    return CHANGED + np.array([0.006 * i, 0.0])


def least_squares(samples):
    """The estimate of all samples, in closed form: the model is linear in its parameters."""
    rows = [r for s in samples for r in ([s.u[0], s.x[0]], [s.x[0] * s.u[0], 0.0], [0.0, s.x[0]])]
    targets = [v for s in samples for v in (s.xdot[0], s.xdot[1], s.xdot[2] - 0.5 * s.u[0])]
    return np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0]


@SEEDS
def test_after_a_jump_the_controller_has_what_all_samples_since_then_say(seed):
    """Within the standard deviation that is worth a write; a window of ten samples alone is four of them off."""
    loop = Loop(seed).go(100, constant(TRUE)).go(200, constant(CHANGED))
    best = least_squares(loop.samples[100:])
    H = np.array([r for s in loop.samples[100:] for r in ([s.u[0], s.x[0]], [s.x[0] * s.u[0], 0.0], [0.0, s.x[0]])])
    off = (loop.held - best) / SIGMA
    assert np.sqrt(off @ (H.T @ H) @ off) < 1.5
    assert loop.retuner.n_episodes == 1


@pytest.mark.parametrize("seed", [2, 4])  # where one search finds them
def test_after_a_search_the_filter_has_what_all_samples_since_the_jump_say(seed):
    """Its window is of ten samples, and alone gives seven to ten times the standard deviation here."""
    loop = Loop(seed, n_channels=1).go(100, constant(TRUE)).go(20, constant(CHANGED))
    assert loop.events.count("end") == 1
    since = loop.samples[100:]
    H = np.array([[s.u[0], s.x[0]] for s in since]) / SIGMA
    best = np.linalg.lstsq(H, np.array([s.xdot[0] for s in since]) / SIGMA, rcond=None)[0]
    std = np.sqrt(np.linalg.inv(H.T @ H).diagonal())
    known, span = loop.search.filter.arrival_cost, np.array([4.5, 3.8])  # of the bounds
    assert np.all(np.abs(SPACE.from_unit(known.mean) - best) < 0.1 * std)
    assert_allclose(np.sqrt(known.covariance.diagonal()) * span, std, rtol=0.05)


@pytest.mark.parametrize("seed", [0, 5])  # where a search ends
def test_a_search_that_ends_where_it_began_leaves_no_filter_that_follows_the_noise(seed):
    """One sample is six standard deviations off, and nothing has changed."""
    loop = Loop(seed).go(100, constant(TRUE)).go(1, constant(TRUE), lambda i: 6.0 * SIGMA).go(20, constant(TRUE))
    assert loop.events.count("end") == 1
    assert_array_equal(loop.held, TRUE)
    n = loop.writes
    assert loop.go(130, constant(TRUE)).writes == n
    assert loop.search.filter.arrival_cost is None


def test_a_jump_is_followed_at_the_rate_of_the_setting():
    loop = Loop(settings=TargetSettings(drift=0.01)).go(100, constant(TRUE)).go(2, fast)
    known = loop.search.filter.arrival_cost
    assert known.rate == 0.01
    assert known.n_samples == 1  # the second one, on which the filter has gone on


@SEEDS
def test_a_search_ends_when_nothing_is_to_be_gained(seed):
    loop = Loop(seed).go(100, constant(TRUE)).go(60, constant(CHANGED))
    assert 3 <= loop.retuner.n_evaluations < 30
    assert loop.events.count("end") == loop.events.count("trigger") == 1


@SEEDS
def test_a_jump_into_a_drift_is_followed_from_its_second_sample_on(seed):
    """No constant parameters explain two samples there; a search does it in thirty evaluations, if at all."""
    loop = Loop(seed).go(100, constant(TRUE)).go(2, fast)
    assert_allclose(loop.held, fast(1), atol=0.05)
    loop.go(40, fast)
    assert loop.retuner.n_evaluations <= 6
    assert_allclose(loop.held, fast(39), atol=0.05)


@pytest.mark.full
def test_a_slow_drift_after_a_jump_is_not_refuted():
    """A filter that takes the parameters for constant right after a jump refutes this drift in two of twelve seeds."""
    for seed in range(12):
        loop = Loop(seed).go(100, constant(TRUE)).go(100, slow)
        assert not {"unexplained", "undo"} & set(loop.events), seed


@SEEDS
def test_a_push_is_not_followed_as_a_jump(seed):
    loop = Loop(seed).go(100, constant(TRUE)).go(10, constant(TRUE), lambda i: np.array([0.8, -0.7, 0.9]))
    assert loop.retuner.n_evaluations > 6


@SEEDS
def test_a_jump_is_not_followed_while_a_disturbance_explains_it_as_well(seed):
    """At rest, where state and input do not change, a force and other parameters look the same."""
    loop = Loop(seed).go(100, constant(TRUE))
    x, u = (0.7,), (0.9,)
    for i in range(4):
        xdot = np.array(model(x, u, *CHANGED)) + SIGMA * loop.rng.standard_normal(3)
        loop.take(Sample(5.0 + 0.05 * i, x, u, tuple(xdot.tolist())))
    assert loop.retuner.n_evaluations == 12


@SEEDS
def test_a_drift_after_it_is_followed_and_not_searched_for(seed):
    """One more search at most, where it begins; a search a window would be twenty."""
    loop = Loop(seed).go(100, constant(TRUE)).go(60, constant(CHANGED)).go(200, drift)
    assert loop.retuner.n_episodes <= 2
    assert_allclose(loop.held, drift(199), atol=0.04)
    assert "disturbance" not in loop.events


@pytest.mark.parametrize("seed", range(3))
def test_a_drift_is_not_refuted(seed):
    loop = Loop(seed).go(100, constant(TRUE)).go(60, constant(CHANGED)).go(200, drift)
    assert not {"unexplained", "undo"} & set(loop.events)


def both_drift(i):
    """The second one more slowly."""
    return CHANGED + np.array([0.0045 * i, 0.0019 * i])


@pytest.mark.full
@pytest.mark.parametrize("moved", [drift, both_drift])
def test_of_many_drifts_next_to_none_is_refuted_or_searched_for(moved):
    """Chance of 1 in 20 in each; the error is a standard deviation and a half of what is not worth a write."""
    n_refuted = n_searched = 0
    for seed in range(20):
        loop = Loop(seed).go(100, constant(TRUE)).go(60, constant(CHANGED)).go(200, moved)
        n_refuted += bool({"unexplained", "undo", "disturbance"} & set(loop.events))
        n_searched += loop.retuner.n_episodes > 2
        assert_allclose(loop.held, moved(199), atol=0.06)
    assert n_refuted <= 1
    assert n_searched <= 1


@SEEDS
def test_a_second_jump_is_searched_for(seed):
    loop = Loop(seed).go(100, constant(TRUE)).go(60, constant(CHANGED)).go(60, constant(TRUE))
    assert loop.retuner.n_episodes == 2
    assert_allclose(loop.held, TRUE, atol=0.01)


@SEEDS
def test_what_was_written_for_a_push_comes_back_and_stays(seed):
    """The filter does not bring back what the diagnosis has undone."""
    push = lambda i: np.array([0.3, -0.2, 0.1]) * (i < 12)  # noqa: E731
    loop = Loop(seed).go(100, constant(TRUE)).go(100, constant(TRUE), push)
    assert "disturbance" in loop.events
    assert_array_equal(loop.held, TRUE)


@SEEDS
def test_a_sine_that_the_model_lacks_is_followed_for_a_while_at_most(seed):
    slow = lambda i: 0.15 * np.sin(0.07 * i) * np.ones(3)  # noqa: E731
    loop = Loop(seed).go(100, constant(TRUE)).go(400, constant(TRUE), slow)
    assert_array_equal(loop.held, TRUE)
    assert {"unexplained", "disturbance"} & set(loop.events)


def test_without_a_diagnosis_it_goes_on_too():
    loop = Loop(0, is_diagnosed=False).go(20, constant(TRUE)).go(200, constant(CHANGED))
    assert loop.retuner.n_episodes == 1
    assert_allclose(loop.held, CHANGED, atol=0.01)


def test_an_outlier_takes_the_filter_back():
    """As the supervisor restores a snapshot: the outlier has left no trace in what is written next."""
    loop, other = (Loop(4).go(60, constant(TRUE)).go(60, constant(CHANGED)) for _ in range(2))
    before, held = loop.retuner.snapshot(), loop.held
    bad = replace(loop.samples[-1], t=loop.samples[-1].t + 0.05, xdot=(9.0, -9.0, 9.0))
    loop.take(bad)
    loop.retuner.restore(before, held)
    loop.held, loop.k = held, other.k
    assert_array_equal(loop.go(50, constant(CHANGED)).held, other.go(50, constant(CHANGED)).held)
