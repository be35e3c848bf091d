"""The constant disturbance of the inputs that explains a sequence best, where the plant is not linear in it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from estimator.diagnosis.disturbed_inputs import disturbed_inputs

STEP, N, SIGMA, LENGTH = 0.02, 50, 0.002, 0.4
THETA = np.array([LENGTH])


def simulated(force, unit):
    """Angles (n,) of a rod that falls over, pushed by forces (2,) of which each is in another unit."""
    x, rows = np.array([0.1, 0.0]), []
    for _ in range(N):
        torque = (force @ unit) * np.cos(x[0])
        x = x + STEP * np.array([x[1], 9.81 / LENGTH * np.sin(x[0]) + torque])
        rows.append(x[0])
    return np.array(rows)


class Window:
    """Window whose inputs are 0 as far as they are known."""

    def __init__(self, truth, unit, seed):
        self.unit = unit
        self.measured = simulated(truth, unit) + SIGMA * np.random.default_rng(seed).standard_normal(N)

    def with_inputs(self, theta, moved):
        return (simulated(moved, self.unit) - self.measured) / SIGMA

    def whitened(self, theta):
        return self.with_inputs(theta, np.zeros(2))

    def largest_inputs(self):
        return np.zeros(2)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("push", [-20.0, -5.0, 5.0, 20.0])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_it_is_least_squares_where_the_plant_is_not_linear_in_it(push, unit, seed):
    """The search ends where the samples are explained. The other input, which is not driven, stays 0."""
    window = Window(np.array([push / unit, 0.0]), np.array([unit, 0.0]), seed)
    found = disturbed_inputs(window, THETA, [0], 2)
    best = least_squares(
        lambda d: window.with_inputs(THETA, np.array([d[0] / unit, 0.0])), [push], xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    assert_allclose(found.inputs, [best.x[0] / unit, 0.0], rtol=1e-3)
    assert found.fit.is_explained
    assert_allclose(found.fit.squares, 2.0 * best.cost, rtol=0.01)


def test_an_input_without_effect_explains_nothing():
    window = Window(np.array([5.0, 0.0]), np.array([1.0, 0.0]), 0)
    found = disturbed_inputs(window, THETA, [1], 2)
    assert not found.fit.is_explained
    assert not found.inputs.any()
