"""Limits of inputs against those that were made, and against the best of a fine grid."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator.effects.input_limits import InputLimits

SLOPES = np.array([[1.0, 0.3], [0.0, 2.0], [0.5, -0.7]])  # of three channels by two inputs
SIGMA, N = 0.01, 30


def made_up(limited, curvature=0.0, seed=0):
    """Residuals of a plant that gets limited(u) of inputs u (N, 2), as a function of what arrives, and those inputs."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([np.sin(0.37 * np.arange(N)), 2.0 + np.cos(0.21 * np.arange(N))])

    def felt(arrives):
        return arrives @ SLOPES.T + curvature * arrives[..., :1] ** 2

    measured = felt(limited(u)) + SIGMA * rng.standard_normal((N, 3))
    return (lambda arrives: (measured - felt(arrives)) / SIGMA), u


def clipped(place, lower, upper):
    def limited(u):
        arrives = u.copy()
        arrives[:, place] = np.clip(u[:, place], lower, upper)
        return arrives

    return limited


@pytest.mark.parametrize("curvature", [0.0, 0.8])
@pytest.mark.parametrize(
    ("place", "lower", "upper"),
    [(0, -np.inf, 0.6), (0, -0.4, np.inf), (0, -0.4, 0.6), (1, -np.inf, 2.5), (1, 1.7, 1.7)],
)
def test_the_limits_that_a_plant_has_are_found(place, lower, upper, curvature):
    """Also where the model is not linear in the input, and where an actuator is stuck."""
    rows_with, u = made_up(clipped(place, lower, upper), curvature)
    found = InputLimits(rows_with, u, [0, 1]).best()
    assert list(found.limits) == [place]
    assert_allclose(found.limits[place], (lower, upper), atol=0.02)
    assert found.fit.is_explained
    assert found.fit.n_free == len({v for v in (lower, upper) if np.isfinite(v)})


def test_a_limit_is_the_best_of_all():
    """By the sum of squares on a grid of a hundredth of its standard deviation."""
    rows_with, u = made_up(clipped(0, -np.inf, 0.6))
    best = InputLimits(rows_with, u, [0, 1]).best()
    grid = np.arange(0.59, 0.61, 1e-5)
    squares = [np.sum(rows_with(clipped(0, -np.inf, c)(u)[None]) ** 2) for c in grid]
    assert best.limits[0][1] == pytest.approx(grid[np.argmin(squares)], abs=2e-5)
    assert best.fit.squares == pytest.approx(min(squares), rel=1e-6)


def test_all_inputs_may_be_stuck():
    rows_with, u = made_up(lambda u: np.broadcast_to([0.2, 2.3], u.shape))
    found = InputLimits(rows_with, u, [0, 1]).stuck()
    assert {j: limits[0] for j, limits in found.limits.items()} == pytest.approx({0: 0.2, 1: 2.3}, abs=0.02)
    assert found.fit.n_free == 2


def test_what_is_always_at_its_limit_is_limited_rather_than_stuck():
    """Both explain it: what is within the limit is then believed to arrive."""
    rows_with, u = made_up(clipped(1, -np.inf, 0.5))
    lower, upper = InputLimits(rows_with, u, [0, 1]).best().limits[1]
    assert lower == -np.inf
    assert upper == pytest.approx(0.5, abs=0.02)


def test_of_inputs_that_do_not_move_nothing_is_told():
    rows_with, u = made_up(lambda u: u)
    still = np.broadcast_to(u[0], u.shape)
    assert InputLimits(rows_with, still, [0, 1]).best() is InputLimits(rows_with, still, [0, 1]).stuck() is None
    assert InputLimits(rows_with, u, []).best() is None


def test_an_input_that_reaches_nothing_is_no_explanation():
    rows_with, u = made_up(clipped(0, -np.inf, 0.6))
    unfelt = np.column_stack([u, np.cos(np.arange(N))])
    found = InputLimits(lambda arrives: rows_with(arrives[..., :2]), unfelt, [0, 1, 2]).best()
    assert list(found.limits) == [0]
