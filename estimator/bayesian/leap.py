"""Leaps over a jump of the model, which a smooth surrogate of its residuals does not expect.

Where a model's residual jumps, as where a stuck body breaks away, a candidate on the wrong side has a few rows that are
far off, and a sum of squares that is least there. What fits all the others may put these right, too.
"""

from typing import Final, NamedTuple

import numpy as np

from ..space import Vector, one_at_a_time

_BETTER: Final = 0.5
"""Share of the sum of squares before, below which a leap has succeeded."""
_SEEN: Final = 10.0
"""Change of the residuals, in standard deviations, over the distances that show their slopes."""
_NEAR: Final = 0.003
"""Largest such distance, in the unit cube: the next jump may not be far."""


class Leap(NamedTuple):
    """Place that may be beyond a jump of the model."""

    place: Vector
    """Place (d,) in the unit cube."""
    about: list[Vector]
    """Places about it that show the slopes there."""
    before: float
    """Sum of squares from which it leaps."""

    def has_succeeded(self, z: Vector, residual: Vector) -> bool:
        """Return whether this residual (D,) at z (d,) is that of the place, and far less than before."""
        return bool(np.abs(z - self.place).max() < 1e-9 and residual @ residual < _BETTER * self.before)


def leap(z: Vector, r: Vector, slope: Vector) -> Leap:
    """Return the leap from z (d,), with residual r (D,) and slope (D, d), to the least absolute residuals."""
    place = np.clip(z + least_absolute_step(r, slope), 0.0, 1.0)
    steps = np.minimum(_SEEN / np.maximum(np.linalg.norm(slope, axis=0), _SEEN), _NEAR)
    return Leap(place, one_at_a_time(place, steps), float(r @ r))


def least_absolute_step(r: Vector, slope: Vector) -> Vector:
    """Return the step (d,) that makes the sum of |r + slope step| least, half the squares where they are below one.

    That is Huber's loss, by iteratively reweighted least squares: Holland and Welsch (1977), "Robust regression using
    iteratively reweighted least-squares".
    """
    step = np.zeros(slope.shape[1])
    for _ in range(20):
        root = np.maximum(np.abs(r + slope @ step), 1.0) ** -0.5
        step = -np.asarray(np.linalg.lstsq(root[:, None] * slope, root * r)[0], dtype=np.float64)
    return step
