"""Actuators that the plant's model lacks: a lag, a dead time, a limited rate or a limited range of its inputs.

tau dv/dt = u - v for a first-order lag, v = u some steps ago, dv/dt towards u at a limited rate, or v = u within
limits, which are the same where an actuator is stuck. The input u is held over each step, from sample to sample or from
one of the points to the next that samples are means of, so that v follows from the inputs alone, and a model that is
given v in place of u has the lag whatever its equations are.
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
    """Dead time in steps."""
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
    made = np.empty((len(lags), *inputs.shape))
    made[:] = start
    gaps, begin, sent = np.diff(times), start.tolist(), inputs[1:].T.tolist()
    for i, lag in enumerate(lags):
        if lag.time_constant:
            gains = (-np.expm1(-gaps / lag.time_constant)).tolist()
            made[i, 1:] = np.transpose([_following(v, gains, u) for v, u in zip(begin, sent, strict=True)])
        elif lag.rates:
            most = [(gaps * rate).tolist() for rate in lag.rates]
            made[i, 1:] = np.transpose([_limited(*one) for one in zip(begin, most, sent, strict=True)])
        elif lag.n_late:
            made[i, lag.n_late :] = inputs[: max(len(inputs) - lag.n_late, 0)]
        elif lag.limits:
            made[i] = np.clip(inputs, *np.transpose(lag.limits))
    return made


def step_means(lags: Sequence[Lag], times: Vector, inputs: Vector, made: Vector) -> Vector:
    """Return the mean (k, ..., n, p) of what arrives over the step up to each time; at the first one what arrives then.

    made (k, ..., n, p): what arrives at the times, as `arriving` returns it.
    """
    means, gaps = made.copy(), np.diff(times)[:, None]
    for i, lag in enumerate(lags):
        moves = np.diff(made[i], axis=-2)
        if lag.time_constant:  # the integral of tau dv/dt = u - v
            means[i, ..., 1:, :] = inputs[1:] - lag.time_constant / gaps * moves
        elif lag.rates:
            means[i, ..., 1:, :] -= moves * np.abs(moves) / (2.0 * gaps * np.array(lag.rates))
    return means


def _following(v: float, gains: Sequence[float], inputs: Sequence[float]) -> list[float]:
    """Return the way (n,) from v towards each of the inputs (n,), by that share of what is left."""
    way: list[float] = []
    for gain, u in zip(gains, inputs, strict=True):
        v += gain * (u - v)
        way.append(v)
    return way


def _limited(v: float, most: Sequence[float], inputs: Sequence[float]) -> list[float]:
    """Return the way (n,) from v towards each of the inputs (n,), by no more than so much (n,)."""
    way: list[float] = []
    for limit, u in zip(most, inputs, strict=True):
        v += min(max(u - v, -limit), limit)
        way.append(v)
    return way
