"""Warnings about two measured outputs whose columns seem to be exchanged."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Final

import numpy as np

from estimator.space import Vector

_BETTER: Final = 0.25
"""Share of the sum of squares that must remain with the columns exchanged."""
_FITS: Final = 3.0
"""Residual (root mean square) in standard deviations of the noise up to which nothing needs to be explained."""


def cross_misfit(simulated: Sequence[Vector], measured: Sequence[Vector], noise: Vector) -> Vector:
    """Return the sums of squares (c, c) of each output compared with each column, in the column's noise.

    simulated, measured: (n, c) by window; NaN where nothing was measured.
    """
    total = np.zeros((len(noise), len(noise)))
    with np.errstate(over="ignore", invalid="ignore"):
        for y, m in zip(simulated, measured, strict=True):
            known = np.isfinite(m).astype(float)
            m = np.where(known, m, 0.0)
            total += (y * y).T @ known - 2.0 * y.T @ m + np.sum(m * m, axis=0)
        return total / noise**2


def swapped_columns(measured: Mapping[str, str], tried: Sequence[Vector], n_values: int) -> list[str]:
    """Return a warning for each pair of outputs that some candidate explains far better with their columns exchanged.

    measured: column by output; tried: `cross_misfit` (c, c) of each candidate; n_values: number of values measured.
    """
    finite = [c for c in tried if np.all(np.isfinite(c))]
    best = min(finite, key=np.trace, default=None)
    if best is None or np.trace(best) < _FITS**2 * n_values:
        return []
    names, warnings = list(measured), list[str]()
    for i, j in combinations(range(len(names)), 2):
        if min(c[i, j] + c[j, i] for c in finite) < _BETTER * (best[i, i] + best[j, j]):
            a, b = names[i], names[j]
            warnings.append(
                f"{a} and {b} would fit better with their columns exchanged: is it --measured {a}={measured[b]} "
                f"--measured {b}={measured[a]}?"
            )
    return warnings
