"""Actuators that the plant's model lacks: a lag, a dead time, a limited rate or a limited range of its inputs.

tau dv/dt = u - v for a first-order lag, v = u some samples ago, dv/dt towards u at a limited rate, or v = u within
limits, which are the same where an actuator is stuck. The input u is held from sample to sample, so that v follows from
the inputs alone, and a model that is given v in place of u has the lag whatever its equations are.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from ..space import Vector


@dataclass(frozen=True)
class Lag:
    """First-order lag, dead time, limited rate or limited range of the inputs; none of them by default."""

    time_constant: float = 0.0
    """tau [s]."""
    n_late: int = 0
    """Dead time in samples."""
    rates: tuple[float, ...] = ()
    """Fastest change (q,) of each input that may lag, in its units by second; infinite where it is not limited."""
    limits: tuple[tuple[float, float], ...] = ()
    """Least and largest value (q,) of each input that arrives, the same where it is stuck; infinite without a limit."""

    def __bool__(self) -> bool:
        return self.time_constant > 0.0 or self.n_late > 0 or bool(self.rates) or bool(self.limits)

    @property
    def n_values(self) -> int:
        """Number of its values: one, or one for each limit."""
        if self.limits:
            return sum(isfinite(limit) for limits in self.limits for limit in set(limits))
        return sum(rate < inf for rate in self.rates) if self.rates else 1

    def fading(self, times: Vector) -> Vector:
        """Return the share (n,) at times (n,) [s] of what arrived at the first of them."""
        if self.n_late:
            return (np.arange(len(times)) < self.n_late).astype(float)
        return np.exp(-(times - times[0]) / self.time_constant)


def arriving(lags: Sequence[Lag], times: Vector, inputs: Vector, start: Vector) -> Vector:
    """Return what arrives of inputs (n, p), held up to times (n,) [s], with each of k lags: (k, n, p).

    start (p,): what arrives at the first time, and until the first input arrives.
    """
    made = np.empty((len(times), len(lags), inputs.shape[1]))
    made[:] = start
    gaps = np.diff(times)[:, None, None]
    following = [j for j, lag in enumerate(lags) if lag.time_constant]
    if following:
        taus = np.array([lags[j].time_constant for j in following])[:, None]
        v = made[0, following]
        way = [v]
        for gain, u in zip(-np.expm1(-gaps / taus), inputs[1:], strict=True):
            v = v + gain * (u - v)
            way.append(v)
        made[:, following] = way
    limited = [j for j, lag in enumerate(lags) if lag.rates]
    if limited:
        rates = np.array([lags[j].rates for j in limited])
        v = made[0, limited]
        way = [v]
        for most, u in zip(gaps * rates, inputs[1:], strict=True):
            v = v + np.minimum(np.maximum(u - v, -most), most)
            way.append(v)
        made[:, limited] = way
    for j, lag in enumerate(lags):
        if lag.n_late:
            made[lag.n_late :, j] = inputs[: max(len(inputs) - lag.n_late, 0)]
        elif lag.limits:
            made[:, j] = np.clip(inputs, *np.transpose(lag.limits))
    return made.transpose(1, 0, 2)
