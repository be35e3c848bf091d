"""Filters on roll-outs that begin in noisy states: the Kalman filter of states and parameters together."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from cosim.objectives.rollout_start import NoisyStartObjective, _factor
from estimator import EpisodeWindow, Evaluation, Objective, Parameter, ParameterSpace, Sample, SampleSequence
from estimator.baselines.kalman import EnsembleKalman, UnscentedKalman

H, NOISE, START_NOISE, N = 0.05, np.array([0.02, 0.05]), np.array([0.03, 0.08]), 20
SPACE = ParameterSpace((Parameter("force", -4.0, 4.0), Parameter("wind", -2.0, 6.0)))
LOWER, WIDTH, HELD, TRUTH = np.array([-4.0, -2.0]), 8.0, np.array([0.5, 1.0]), np.array([1.4, 0.6])
A = np.array([[0.0, 1.0, 0.0, 0.0], [-4.0, -0.6, 1.0, 0.3], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
F = expm(H * A)
"""Transition of position, speed, a constant force, and a wind, of which 0.3 pushes."""
C = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])


class LinearRollOuts:
    """Roll-outs of the linear plant from the measured state, as a RolloutObjective has them."""

    way, is_ready, why_lost = "measured", True, None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def add_sample(self, sample):
        pass

    def snapshot(self, is_needed):
        return True

    def revert(self, theta): ...

    def move_inputs(self, moved, stretch): ...

    def accept(self, theta, stretch):
        pass

    def evaluate(self, thetas, stretch):
        found = []
        for theta in thetas:
            z, rows = np.array([*stretch.samples[0].x, *theta]), []
            for sample in stretch.samples[1:]:
                z = F @ z
                rows.append(np.nan_to_num((C @ z - sample.y) / NOISE))
            found.append(Evaluation(np.array(rows).T.reshape(-1)))
        return found


def measured(seed, noise=1.0):
    """Samples whose states are measured as the outputs are; the first is where the window begins."""
    rng, z = np.random.default_rng(seed), np.array([0.3, -0.2, *TRUTH])
    first = Sample(0.0, tuple(z[:2] + noise * START_NOISE * rng.standard_normal(2)), (), (), (np.nan, np.nan))
    samples = [first]
    for k in range(N):
        z = F @ z
        y = tuple(z[:2] + noise * NOISE * rng.standard_normal(2))
        samples.append(Sample(H * (k + 1), y, (), (), y))
    return samples


@pytest.mark.parametrize("size", [1.0, 1e9, 1e11])
def test_residuals_are_whitened_however_far_a_roll_out_diverges(size):
    """In the covariance itself the noise is lost beside 1e18."""
    moved = [size * np.linspace(0.0, 1.0, N), size * np.linspace(0.0, 1.0, N) ** 2]
    factor = _factor(np.zeros(N), moved, N)
    aside = np.array(moved) / size
    assert_allclose(factor @ factor.T / size**2, aside.T @ aside + np.eye(N) / size**2, atol=1e-9)
    assert np.all(factor.diagonal() > 0.9)


def kalman(samples, jump):
    """The textbook's filter of position, speed and both parameters: mean and covariance of the latter at the end."""
    z = np.array([*samples[0].x, *HELD])
    P = np.diag([*START_NOISE**2, (jump * WIDTH) ** 2, (jump * WIDTH) ** 2])
    for sample in samples[1:]:
        z, P = F @ z, F @ P @ F.T
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.diag(NOISE**2))
        z, P = z + K @ (np.array(sample.y) - C @ z), (np.eye(4) - K @ C) @ P
    return z[2:], P[2:, 2:]


@pytest.mark.parametrize("estimator", [UnscentedKalman, EnsembleKalman])
@pytest.mark.parametrize("seed", range(3))
def test_with_noisy_states_it_is_the_kalman_filter_of_states_and_parameters(estimator, seed):
    """To 1e-9 of the bounds, although the residuals know the states' noise by differences only."""
    samples = measured(seed)
    with NoisyStartObjective(LinearRollOuts, START_NOISE) as objective:
        window = EpisodeWindow(objective, N)
        window.append(samples[0])
        window.begin(HELD)
        for sample in samples[1:]:
            window.append(sample)
        made = estimator(SPACE, HELD, np.random.default_rng(seed))
        made.solve(Objective(window, None, 30))
    estimate, (mean, P) = made.estimate(), kalman(samples, 0.3)
    assert_allclose(estimate.theta, mean, rtol=0.0, atol=WIDTH * 1e-9)
    assert_allclose(estimate.std, np.sqrt(np.diag(P)), rtol=1e-7)


class ScaledStart(LinearRollOuts):
    """Roll-outs from the measured state times the first parameter: what its noise does depends on the candidate."""

    def evaluate(self, thetas, stretch):
        first, *others = stretch.samples
        starts = [replace(first, x=tuple(theta[0] * np.array(first.x))) for theta in thetas]
        scaled = [replace(stretch, samples=(start, *others)) for start in starts]
        return [super(ScaledStart, self).evaluate([theta], s)[0] for theta, s in zip(thetas, scaled, strict=True)]


def test_candidates_are_whitened_alike_whatever_inputs_are_tried_in_between():
    stretch = SampleSequence(tuple(measured(0)), None)
    as_with_other_inputs = replace(stretch, samples=tuple(stretch.samples))
    found = []
    for between in (False, True):
        with NoisyStartObjective(ScaledStart, START_NOISE) as objective:
            objective.evaluate([HELD], stretch)
            if between:
                objective.evaluate([2.0 * HELD], as_with_other_inputs)
            found.append(objective.evaluate([TRUTH], stretch)[0].residual)
    assert_array_equal(*found)
    with NoisyStartObjective(ScaledStart, START_NOISE) as objective:
        (own,) = objective.evaluate([TRUTH], stretch)
    assert np.abs(own.residual - found[0]).max() > 0.1  # its own factor is another


def test_a_value_that_turns_out_to_be_wrong_has_no_part_in_the_whitening_of_others():
    stretch = SampleSequence(tuple(measured(0)), None)
    newest = stretch.samples[-1]
    known = replace(newest, y=(np.nan, *newest.y[1:]))
    corrected = replace(stretch, samples=(*stretch.samples[:-1], known))
    found = []
    for before in ([stretch], []):  # candidates have been compared with the wrong value, or not
        with NoisyStartObjective(LinearRollOuts, START_NOISE) as objective:
            for seen in before:
                objective.evaluate([HELD], seen)
            (evaluation,) = objective.evaluate([HELD], corrected)
            found.append(evaluation.residual)
    assert_allclose(*found, rtol=1e-12)
