"""Chi-square tests of whitened residuals."""

from functools import cache
from typing import Final

import scipy  # its parts, 0.3 s, are loaded when they are used

from .space import Vector

FALSE_ALARM: Final = 1e-4
"""Probability that the residuals of a hypothesis that is true, or of the true parameters, fail the chi-square test."""
SAMPLE_FALSE_ALARM: Final = 1e-6
"""The same of a single sample, of which a run has many."""


@cache
def chi2_limit(false_alarm: float, degrees: int) -> float:
    """Return the value that a chi-square variable exceeds with probability false_alarm; cached.

    Equal to scipy.stats.chi2.isf, which takes 0.5 s to import and 100 us a call.
    """
    return float(scipy.special.chdtri(degrees, false_alarm))


def is_explained(residual: Vector) -> bool:
    """Return whether a whitened residual (D,) passes the chi-square test."""
    return len(residual) == 0 or float(residual @ residual) <= chi2_limit(FALSE_ALARM, len(residual))
