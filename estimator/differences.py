"""Slopes of functions that have no derivative at hand."""

from collections.abc import Callable, Sequence
from math import inf

import numpy as np

from .space import Vector


def central_differences(
    function: Callable[[Vector], Sequence[float] | Vector],
    z: Vector,
    steps: Vector,
    lower: float = -inf,
    upper: float = inf,
) -> Vector:
    """Return df/dz (D, d) at z (d,) by central differences, one-sided at a bound.

    function: f (D,) of a place (d,); steps (d,): to either side; lower, upper: of every coordinate of the places.
    """
    columns: list[Vector] = []
    for i, step in enumerate(steps.tolist()):
        above, below = z.copy(), z.copy()
        above[i], below[i] = min(z[i] + step, upper), max(z[i] - step, lower)
        columns.append(np.subtract(function(above), function(below)) / (above[i] - below[i]))
    return np.column_stack(columns)


def forward_differences(function: Callable[[Vector], Vector], z: Vector, value: Vector, step: float) -> Vector:
    """Return df/dz (D, d) at z (d,) of the unit cube by steps towards the cube's middle; value: f(z), of any shape."""
    columns: list[Vector] = []
    for i, z_i in enumerate(z.tolist()):
        aside = z.copy()
        aside[i] += step if z_i < 0.5 else -step
        columns.append((function(aside) - value).reshape(-1) / (aside[i] - z_i))
    return np.column_stack(columns)
