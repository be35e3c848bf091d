"""Chi-square tests of whitened residuals."""

from functools import cache

import scipy  # its parts, 0.3 s, are loaded when they are used

from .space import Vector


@cache
def chi2_limit(false_alarm: float, degrees: int) -> float:
    """Return the value that a chi-square variable exceeds with probability false_alarm; cached.

    Equal to scipy.stats.chi2.isf, which takes 0.5 s to import and 100 us a call.
    """
    return float(scipy.special.chdtri(degrees, false_alarm))


def is_explained(residual: Vector, false_alarm: float) -> bool:
    """Return whether a whitened residual (D,) passes the chi-square test."""
    return len(residual) == 0 or float(residual @ residual) <= chi2_limit(false_alarm, len(residual))
