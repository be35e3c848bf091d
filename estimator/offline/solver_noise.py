"""Noise of a simulation's own solver: how much residuals scatter between parameters that are all but equal."""

from collections.abc import Callable, Sequence
from math import factorial
from typing import Final

import numpy as np

from ..space import Vector

_SPACINGS: Final = (1e-4, 1e-3)
"""Distances of the places, in the unit cube: where steps are chosen anew seldom, only far places differ by it."""
_GROWTH: Final = 10.0
"""Largest factor by which noise may grow from one distance to the next: what grows more is no noise."""
_LEVEL: Final = 6
"""Order of the differences."""
_FLAT: Final = 4.0
"""Ratio within which three orders must agree; what is smooth falls from order to order."""


def solver_noise(residuals: Callable[[Sequence[Vector]], Sequence[Vector]], z: Vector) -> float:
    """Return the norm over all rows of the residuals' noise at z (d,), by 13 evaluations; 0 where some fail.

    Differences of order k of a smooth function fall with k, and those of noise of variance s^2 have the variance
    (2k)! / (k!)^2 s^2: Moré and Wild (2011), "Estimating computational noise". The places lie on a line away from
    the bounds.
    """
    inwards = np.where(z < 0.5, 1.0, -1.0) / np.sqrt(len(z))
    places = [z, *(z + k * spacing * inwards for spacing in _SPACINGS for k in range(1, _LEVEL + 1))]
    found = np.array(residuals(places))
    if not np.all(np.isfinite(found)):
        return 0.0
    lines = [found[[0, *range(1 + i * _LEVEL, 1 + (i + 1) * _LEVEL)]] for i in range(len(_SPACINGS))]
    near, far = (_noise(line) for line in lines)
    return max(near, min(far, _GROWTH * near))


def _noise(line: Vector) -> float:
    """Return the noise's norm in rows (7, D) at equal distances; 0 where they differ smoothly."""
    levels: list[float] = []
    for k in range(_LEVEL - 2, _LEVEL + 1):
        share = factorial(k) ** 2 / factorial(2 * k)
        levels.append(float(np.sqrt(share * np.mean(np.sum(np.diff(line, k, axis=0) ** 2, axis=1)))))
    return levels[-1] if max(levels) <= _FLAT * min(levels) else 0.0
