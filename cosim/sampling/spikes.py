"""Spikes of sampled values that no model is compared with."""

from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np

from estimator import Vector

_MEMORY: Final = 50
"""Number of newest values whose largest deviation and change are usual."""
_FEWEST: Final = 10
"""Least number of them that show what is usual."""
_LIMIT: Final = 5.0
"""Deviation that a spike must exceed, in standard deviations of the noise."""
_MORE: Final = 2.0
"""Multiple of what is usual that it must exceed."""


class Spikes:
    """Detector of isolated values in several series side by side.

    A value is one where it is off the mean of its neighbours by more than noise, by more than the neighbours differ, as
    after a step of the series, and by more than twice what lately one value was off, or differed from the next.
    """

    def __init__(self, noise: Sequence[float]) -> None:
        """noise (k,): standard deviation of each series; one without noise has no spikes."""
        self._noise = np.array(noise)
        self.is_suspect = False
        """True where a newest value may turn out to be a spike: it has changed by as much as one that is."""
        none = np.full(len(self._noise), np.nan)
        self._before, self._last, self._newest = none, none, none
        self._usual: deque[Vector] = deque(maxlen=_MEMORY)

    def step(self, values: Sequence[float]) -> Vector:
        """Take the newest values (k,); return the mean of the neighbours of each one before them that was a spike.

        NaN for the others.
        """
        now = np.array(values, dtype=float)
        mean = 0.5 * (self._before + now)
        off = np.abs(self._last - mean)
        usual = np.max(self._usual, axis=0) if len(self._usual) >= _FEWEST else np.inf
        limit = np.maximum(_LIMIT * np.sqrt(1.5) * self._noise, _MORE * usual)
        is_spike = (off > limit) & (off > np.abs(now - self._before)) & (self._noise > 0.0)
        has_changed = np.abs(now - self._last) > np.maximum(_LIMIT * np.sqrt(2.0) * self._noise, _MORE * usual)
        self.is_suspect = bool(np.any(has_changed & ~is_spike & (self._noise > 0.0)))
        # What the newest value differed by is the spike's own.
        self._usual.append(np.where(is_spike | np.isnan(self._newest), 0.0, self._newest))
        self._newest = np.where(is_spike, np.nan, np.maximum(off, np.abs(now - self._last)))
        self._before, self._last = np.where(is_spike, mean, self._last), now
        return np.where(is_spike, mean, np.nan)
