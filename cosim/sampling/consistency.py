"""Consistency of sampled derivatives with the differences of their states.

This detects a derivative sensor that is biased, scaled, delayed or has the wrong sign, as long as the sensor of its
state is right, whatever the parameters are.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Sample, Vector

from .medians import column_medians

_LENGTH: Final = 20
"""Samples over which derivatives are summed."""
_FEWEST: Final = 5
"""Least number of samples whose scatter is an estimate of the noise."""


class Consistency:
    """Check of x_k - x_j against h sum xdot_i, i = j+1 .. k, over the newest samples, channel by channel.

    A sample at the end of a step belongs to the input that was held over it. So the rectangle rule errs by h/2 times
    the change of the derivative over the step, whose size the model predicts. The limit is the sum of that of the
    noise, declared or observed, whichever is larger, of twice that error, and of h/2 sum |xdot_i - xdot_(i-1)|, the
    last counted twice, so that a spike is no bias.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        noise: tuple[float, ...],
        state_noise: tuple[float, ...],
        slope: Callable[[Vector, Sequence[float], Sequence[float]], Sequence[float]],
        limit: float,
        h: float,
    ) -> None:
        """channels (c,): the states' places in x; noise, state_noise (c,): standard deviations of the derivatives and
        of these states; slope: modelled derivatives (n,) at theta, x and u; limit: in standard deviations; h: macro
        step [s]."""
        self._channels, self._slope, self._h, self._limit = list(channels), slope, h, limit
        self._noise, self._state_variance = np.array(noise), np.square(state_noise)
        self._rows = np.empty((0, 3, len(channels)))  # motion of the state, derivative and its modelled change
        self._last: Sample | None = None

    def step(self, sample: Sample, theta: Vector) -> NDArray[np.intp]:
        """Return the channels whose derivative does not fit the state's motion; a gap in time restarts the check.

        theta (d,): parameters in force.
        """
        last, self._last = self._last, sample
        if last is None or abs(sample.t - last.t - self._h) > 0.5 * self._h:
            self._rows, last = self._rows[:0], sample
        now, before = (self._slope(theta, x, sample.u) for x in (sample.x, last.x))
        moved = [sample.x[i] - last.x[i] for i in self._channels]
        row = [moved, sample.xdot, [now[i] - before[i] for i in self._channels]]
        self._rows = np.concatenate([self._rows[-_LENGTH:], [row]])
        if len(self._rows) <= _FEWEST:
            return np.empty(0, dtype=np.intp)
        moved, xdot, drift = self._rows.swapaxes(0, 1)
        differs = np.abs(moved[1:].sum(axis=0) - self._h * xdot[1:].sum(axis=0))
        changes = np.abs(xdot[1:] - xdot[:-1])
        if (differs <= self._limits(self._noise, changes, drift[1:])).all():  # the observed noise only widens them
            return np.empty(0, dtype=np.intp)
        sigma = np.maximum(self._noise, 1.05 * column_medians(changes))  # of a difference: 0.954 sigma
        return np.flatnonzero(differs > self._limits(sigma, changes, drift[1:]))

    def _limits(self, sigma: Vector, changes: Vector, drift: Vector) -> Vector:
        n, h = len(drift), self._h
        noise = np.sqrt(n * h * h * sigma * sigma + 2.0 * self._state_variance)
        return self._limit * noise + h * np.abs(drift).sum(axis=0) + 0.5 * h * (changes.sum(axis=0) + changes[-1])
