"""Residual scale: the size of what the model leaves unexplained, learnt while nothing happens."""

from collections import deque
from collections.abc import Iterable
from math import isfinite
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import NEVER, Fit, n_channels_of
from ..space import Vector

_MEMORY: Final = 200
"""Number of samples that the scale is estimated from."""
_FEWEST: Final = 100
"""Least number of samples that give an estimate."""
_DEAD_BAND: Final = 1.5
"""Scale below which the declared noise stands: a median of so few samples is no better."""
_AT_ONCE: Final = 30
"""Least number of samples that give an estimate after a rest."""
_STEP: Final = 1.2
"""Factor by which an estimate must differ from the scale in use to replace it."""
_SMOOTH: Final = 0.3
"""Ratio of second to first differences, by that of white noise, below which rows change smoothly."""
TOO_SMALL: Final = 10.0
"""Factor by which a declared noise may be too small, as where it is a sensor's last digit."""
LARGEST: Final = 2.0 * TOO_SMALL
"""Factor from which on what is unexplained is no noise, however rough it is."""
_CORRELATIONS: Final = np.array([[0.5], [0.8], [0.9], [0.95]])
"""Correlations (k, 1) from one sample to the next of the coloured noise that is thought of."""
_MAD: Final = 1.4826
"""Ratio of a normal variable's standard deviation to its median absolute deviation."""
NOISY: Final = 8
"""Least number of samples that show a larger noise than the declared one."""
LARGER: Final = 1.3
"""Factor by which it must be larger."""
MUCH_LARGER: Final = 3.0
"""Factor where the parameters in force stay: they are not fitted, and a smaller one may be what the model lacks."""


class ResidualScale:
    """Scale s (c,) >= 1 of whitened residuals, and their correlation from one sample to the next, channel by channel.

    s = 1.4826 median |r| while the parameters in force are accepted: Mehra (1970), "On the identification of variances
    and adaptive Kalman filtering", with a median in place of the mean, which outliers would move. A residual that
    drifts is no noise: while nothing has been found wanting the spread is that of the differences from sample to
    sample, |r_k - r_(k-1)| / sqrt(2), which a slow change of a parameter leaves as it is.
    """

    def __init__(self, n_channels: int) -> None:
        self.values = np.ones(n_channels)
        """s (c,), in standard deviations of the declared noise."""
        self.correlations = np.zeros(n_channels)
        """Correlation rho (c,) of the residual with that of the sample before, at least 0."""
        self.effective = np.ones(n_channels)
        """Scale (c,) that counts samples as if they were independent: s sqrt((1 + rho) / (1 - rho))."""
        self._admitted = np.zeros(n_channels)  # what the model lacks, noise apart
        self.observed: Vector | None = None
        """Spread (c,) of the residuals at the last estimate, which may be below one; None before the first."""
        self._rows: deque[Vector] = deque(maxlen=_MEMORY)
        self._since_update = 0

    def copy(self) -> "ResidualScale":
        """Return an independent copy."""
        other = ResidualScale(len(self.values))
        other.values, other.correlations, other.observed = self.values, self.correlations, self.observed
        other.effective, other._admitted = self.effective, self._admitted
        other._rows, other._since_update = deque(self._rows, maxlen=_MEMORY), self._since_update
        return other

    def learn(self, row: Vector) -> bool:
        """Take the residual (c,) of a sample at which nothing happened; return whether the scale has changed.

        NaN where a channel has no value: one that has too few of them stays as it is.
        """
        self._rows.append(row)
        self._since_update += 1
        if len(self._rows) < _FEWEST or self._since_update < _FEWEST:
            return False
        self._since_update = 0
        rows = np.array(self._rows)
        of_channels = _known(rows)
        is_seen = np.array([len(values) >= _FEWEST for values in of_channels])
        if not is_seen.any():
            return False
        spread, size = np.ones_like(self.values), np.ones_like(self.values)
        for c in np.flatnonzero(is_seen):
            spread[c], size[c] = spread_of(of_channels[c]), _MAD * np.median(np.abs(of_channels[c]))
        # What was learnt of a lacking model is kept as long as the residuals are of that size.
        observed = np.maximum(spread, np.minimum(self._admitted, size))
        self.observed = np.where(is_seen, observed, self.values if self.observed is None else self.observed)
        return self._adopt(observed, np.nan_to_num(rows), np.where(is_seen, 1.0, self.values))

    def enlarge(self, factors: Vector) -> None:
        """Multiply the scale by factors (c,)."""
        self.values = self.values * factors
        self._count_correlations()
        self._rows.clear()

    def admit(self, rows: Vector) -> bool:
        """Take residuals (n, c) that no parameters explain for the model's usual error; return whether it changed.

        NaN where a channel has no value.
        """
        self._rows.clear()
        self._since_update = 0
        if len(rows) < 2:
            return False
        n_known = np.count_nonzero(np.isfinite(rows), axis=0)
        size = np.sqrt(np.nansum(rows**2, axis=0) / np.maximum(n_known, 1))
        self._admitted = np.maximum(self._admitted, size)
        return self._adopt(self._admitted, np.nan_to_num(rows), self.values)

    def wake(self, rows: Vector) -> bool:
        """Take the residuals (n, c) of a rest, of which only the noise is believed; return whether it changed.

        NaN where a channel has no value: one that has too few of them stays as it is.
        """
        if len(rows) < _AT_ONCE:
            return False
        spread = [float(spread_of(values)) if len(values) >= _AT_ONCE else 0.0 for values in _known(rows)]
        return self._adopt(np.array(spread), np.nan_to_num(rows), self.values)

    def _adopt(self, found: Vector, rows: Vector, least: Vector | float = 1.0) -> bool:
        found = np.maximum(np.where(found < _DEAD_BAND, 1.0, found), least)
        ratio = np.maximum(found / self.values, self.values / found)
        if np.all(ratio < _STEP):
            return False
        self.values = np.where(ratio < _STEP, self.values, found)
        found = np.where(np.any(rows != 0.0, axis=0), _lag_one(rows), self.correlations)
        self.correlations = np.where(self.values > 1.0, found, 0.0)
        self._count_correlations()
        return True

    def _count_correlations(self) -> None:
        self.effective = self.values * np.sqrt((1.0 + self.correlations) / (1.0 - self.correlations))


def is_rough(channels: Iterable[Vector]) -> bool:
    """Return whether channels, each (n,), change from sample to sample by as much as noise does: of white noise the
    squares of the differences are twice its own, von Neumann (1941), of what changes smoothly less than once."""
    return sum(float(np.sum(np.diff(c) ** 2) - np.sum(c**2)) for c in channels) >= 0.0


def is_smooth(rows: Vector) -> bool:
    """Return whether a channel of rows (n, c) that is larger than known noise changes smoothly from row to row.

    The second differences of white noise are 1.7 times as large as the first, those of a sine with twelve rows a period
    half as large.
    """
    first, second = spread_of(rows), spread_of(np.diff(rows, axis=0)) / np.sqrt(3.0)
    return bool(np.any(np.maximum(second, 1.0) < _SMOOTH * np.maximum(first, 1.0)))


def larger_noise(rows: Vector) -> Fit:
    """Return the fit of white noise, on each channel of rows (n, c) of up to ten times the known size.

    Its squares are -2 log likelihoods beside noise of the known size. Zeros are missing values.
    """
    squares, n = np.sum(rows**2, axis=0), np.count_nonzero(rows, axis=0)
    variance = np.clip(squares / np.maximum(n, 1), 1.0, TOO_SMALL**2)
    fitted = float(np.sum(squares / variance + n * np.log(variance)))
    return Fit(fitted, n_channels_of(rows), int(n.sum())) if isfinite(fitted) else NEVER


def coloured_noise(rows: Vector) -> Fit:
    """Return the fit of noise that is correlated from one of rows (n, c) to the next, up to ten times the known size.

    On each channel it is a stationary autoregression of first order, Box and Jenkins (1970), "Time Series Analysis",
    chapter 7, whose innovations are at least as large as known noise. Its squares are as those of `larger_noise`.
    Missing values, which are zeros, count as values.
    """
    n, shrink = len(rows), 1.0 - _CORRELATIONS**2
    innovations = rows[1:] - _CORRELATIONS[:, None] * rows[:-1]
    squares = np.sum(innovations**2, axis=1) / shrink + rows[0] ** 2
    variance = np.clip(squares / n, 1.0 / shrink, TOO_SMALL**2)
    total = squares / variance + n * np.log(variance) + (n - 1) * np.log(shrink)
    fitted = float(total.min(axis=0)[rows.any(axis=0)].sum())
    return Fit(fitted, 2 * n_channels_of(rows), int(np.count_nonzero(rows))) if isfinite(fitted) else NEVER


def spread_of(rows: Vector) -> Vector:
    """Return the standard deviation (c,) of white noise in rows (n, c), from their differences: robust, and blind to
    whatever changes slowly."""
    return _MAD * np.median(np.abs(np.diff(rows, axis=0)), axis=0) / np.sqrt(2.0)


def are_mostly_larger(rows: Vector) -> NDArray[np.bool_]:
    """Return which channels (c,) of rows (n, c) are larger than noise of the known size, a few outliers apart."""
    return np.asarray(_MAD * np.median(np.abs(rows), axis=0) > _DEAD_BAND)


def _known(rows: Vector) -> list[Vector]:
    """Return the values of each channel of rows (n, c), without NaN."""
    return [column[np.isfinite(column)] for column in rows.T]


def _lag_one(rows: Vector) -> Vector:
    """Return the correlation (c,) of each channel of rows (n, c) with itself a sample earlier, in [0, 0.95]."""
    total = np.sum(rows**2, axis=0)
    shared = np.sum(rows[1:] * rows[:-1], axis=0)
    return np.clip(np.divide(shared, total, out=np.zeros(len(total)), where=total > 0.0), 0.0, 0.95)
