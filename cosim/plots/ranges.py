"""Ranges of axes that accept any data, and values fit to draw in them; without Matplotlib."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..runs.result import Series

AxisLimits = tuple[float, float]


def value_range(series: Sequence[ArrayLike], percentile: float = 0.0) -> AxisLimits | None:
    """Return the extreme values, or the percentiles that far from both ends; None if no value is below 1e100."""
    flat = np.concatenate([np.ravel(np.asarray(s, dtype=float)) for s in series]) if series else np.empty(0)
    finite = flat[np.abs(flat) < 1e100]  # NaN is not
    if not len(finite):
        return None
    low, high = np.percentile(finite, [percentile, 100.0 - percentile])
    return float(low), float(high)


def tame(values: ArrayLike, limits: AxisLimits, is_log: bool = False) -> Series:
    """Return values (n,) fit to draw: NaN if not finite (or not positive, on a log axis), else not far outside."""
    y = np.asarray(values, dtype=float)
    usable = np.isfinite(y) & ((y > 0.0) | (not is_log))
    low, high = limits
    far = (low / 10.0, high * 10.0) if is_log else (low - 2.0 * (high - low), high + 2.0 * (high - low))
    return np.where(usable, np.clip(np.where(usable, y, low), *far), np.nan)


def tracking_limits(reference: Series, outputs: Sequence[Series]) -> AxisLimits:
    """Return limits for all curves, without excursions of more than twice the reference's range from it."""
    wanted = value_range([reference, *outputs], percentile=0.2) or (0.0, 1.0)
    low, high = value_range([reference]) or wanted
    width = high - low
    if width <= 1e-9 * max(abs(low), abs(high)):
        return min(low, wanted[0]), max(high, wanted[1])
    return min(low, max(wanted[0], low - 2.0 * width)), max(high, min(wanted[1], high + 2.0 * width))


def error_limits(errors: Sequence[Series], divergence: float) -> AxisLimits:
    """Return limits over at most six decades; the smallest percent of the values may lie below them."""
    positive = [e[np.isfinite(e) & (e > 0.0)] for e in errors]
    low, _ = value_range(positive, percentile=1.0) or (1e-3, 1.0)
    _, high = value_range(positive) or (1e-3, 1.0)
    high = min(max(high, 1e-30), 2.0 * divergence)
    return min(max(low, 1e-6 * high), 0.5 * high), high
