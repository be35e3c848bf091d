"""Thinning of long series, such that no peak is lost."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ..runs.result import Series

MOST_ROWS: Final = 4000
"""Number of rows up to which a series is drawn whole."""


def kept_rows(*series: Series, n: int = MOST_ROWS) -> NDArray[Any]:
    """Return the rows, about n at most, at which some of the series (m,) has its extremes within a stretch of rows.

    All rows of a short series; of a long one the first and the last, too.
    """
    m = len(series[0])
    if m <= n:
        return np.arange(m)
    length = -(-m * 2 * len(series) // n)
    begins = np.arange(0, m, length)
    kept: list[NDArray[Any]] = [np.array([0, m - 1])]
    for values in series:
        for sign in (1.0, -1.0):
            padded = np.full(len(begins) * length, -np.inf)
            padded[:m] = np.nan_to_num(sign * values, nan=-np.inf, posinf=np.inf, neginf=-np.inf)
            kept.append(begins + np.argmax(padded.reshape(-1, length), axis=1))
    return np.unique(np.minimum(np.concatenate(kept), m - 1))
