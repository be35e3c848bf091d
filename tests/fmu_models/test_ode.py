from math import cos, sin

import numpy as np
import pytest
from numpy.testing import assert_allclose

from fmu_models.kernel import ode


def van_der_pol(x):
    return (x[1], (1 - x[0] ** 2) * x[1] - x[0])


def forced_pendulum(x):
    return (x[1], -9.81 * sin(x[0]) - 0.1 * x[1] + cos(3 * x[2]), 1.0)


def test_one_step_satisfies_the_eight_order_conditions_of_order_4(oracles):
    oracles.check_order_conditions(ode)


def test_one_step_multiplies_a_linear_mode_by_the_exponential_to_fourth_order():
    for z in (-2.5, -0.3, 0.7):
        (got,) = ode.rk4_step(lambda x: (x[0],), (1.0,), z)
        # Four products and four sums.
        assert_allclose(got, 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, atol=4e-15)


@pytest.mark.parametrize(
    ("f", "x0", "duration", "n_steps"),
    [
        pytest.param(van_der_pol, (1.0, 0.5), 3.0, (80, 160, 320), id="van-der-pol"),
        pytest.param(forced_pendulum, (1.0, 0.0, 0.0), 2.0, (80, 160, 320), id="forced-pendulum"),
    ],
)
def test_the_error_falls_with_the_fourth_power_of_the_step(oracles, f, x0, duration, n_steps):
    oracles.check_order_of_convergence(ode, f, x0, duration, n_steps)


@pytest.mark.parametrize(
    ("duration", "max_step", "n_steps"),
    [
        pytest.param(0.01, 0.001, 10, id="divides"),
        pytest.param(0.3, 0.1, 3, id="quotient-rounds-below-3"),
        pytest.param(0.07, 0.01, 7, id="quotient-rounds-above-7"),
        pytest.param(0.01, 0.003, 4, id="does-not-divide"),
        pytest.param(0.01, 0.009999, 2, id="just-too-long"),
        pytest.param(0.01, 1.0, 1, id="shorter-than-a-step"),
    ],
)
def test_integrate_takes_the_fewest_equal_steps(duration, max_step, n_steps):
    stages = []

    def clock(x):
        stages.append(x[0])
        return (1.0,)

    (end,) = ode.integrate(clock, (0.0,), duration, max_step)
    assert len(stages) == 4 * n_steps
    # A rounding per step.
    assert_allclose(stages[::4], np.arange(n_steps) * duration / n_steps, atol=1e-15)
    assert_allclose(stages[1::4], (np.arange(n_steps) + 0.5) * duration / n_steps, atol=1e-15)
    assert_allclose(end, duration, rtol=1e-14)


def test_no_duration_leaves_the_state():
    assert ode.integrate(van_der_pol, (1.0, 0.5), 0.0, 0.001) == (1.0, 0.5)


def test_a_reversed_step_returns_to_the_start():
    x0 = (1.0, 0.5)
    there = ode.rk4_step(van_der_pol, x0, 1e-3)
    # Both steps miss by the local error, a few h^5.
    assert_allclose(ode.rk4_step(van_der_pol, there, -1e-3), x0, atol=1e-14)
