"""Consistency of sampled derivatives with the differences of their states.

This detects a derivative sensor that is biased, scaled, delayed or has the wrong sign, as long as the sensor of its
state is right, whatever the parameters are.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Sample, Vector

from .derivative_gain import DerivativeGain
from .medians import column_medians
from .sensor_checks import SUMMED

_FEWEST: Final = 5
"""Least number of samples whose scatter is an estimate of the noise."""
_STILL: Final = 0.5
"""Share of the noise's limit above which a derivative that was inconsistent still is."""
_BURST: Final = 3
"""Largest number of spikes in a row that are no fault of the derivative once they are over."""
_SHY: Final = 3
"""Number of consistent samples that make good for an inconsistent one."""


class Consistency:
    """Check of x_k - x_j against h sum xdot_i, i = j+1 .. k, over the newest samples, channel by channel.

    A sample at the end of a step belongs to the input that was held over it. So the rectangle rule errs by h/2 times
    the change of the derivative over the step, whose size the model predicts. The limit is the sum of that of the
    noise, declared or observed, whichever is larger, of twice that error, and of h/2 sum |xdot_i - xdot_(i-1)|, the
    last counted twice, so that a spike is no bias; nor are a few in a row, once they are over. A channel that was
    inconsistent is so until it has been below this, with half of the noise's part, for three times as many samples, at
    most 20: a derivative with the wrong sign fits, too, where it is small, and a spike of the state is over soon. A
    wrong `DerivativeGain` over a hundred samples is inconsistent, too.
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
        # Motion of the state, derivative, its modelled change, and the size of its change.
        self._rows = np.empty((0, 4, len(channels)))
        self._noises: dict[int, Vector] = {}  # limits of the declared noise, by the number of changes
        self._gain, self._n_block = DerivativeGain(limit), 0
        self._last: Sample | None = None
        self._distrust = np.zeros(len(channels), dtype=np.intp)  # number of samples for which it is inconsistent yet

    def step(self, sample: Sample, theta: Vector) -> NDArray[np.intp]:
        """Return the channels whose derivative does not fit the state's motion; a gap in time restarts the check.

        theta (d,): parameters in force.
        """
        last, self._last = self._last, sample
        if last is None or abs(sample.t - last.t - self._h) > 0.5 * self._h:
            self._rows, last = self._rows[:0], sample
            self._gain, self._n_block = DerivativeGain(self._limit), 0
        now, before = (self._slope(theta, x, sample.u) for x in (sample.x, last.x))
        moved = [sample.x[i] - last.x[i] for i in self._channels]
        drift = [now[i] - before[i] for i in self._channels]
        changes = [abs(a - b) for a, b in zip(sample.xdot, last.xdot, strict=True)]
        row = np.array([moved, sample.xdot, drift, changes])
        is_known = np.isfinite(row).all(axis=0)  # not beside a missing derivative: no motion is compared there
        self._rows = np.concatenate([self._rows[-SUMMED:], [np.where(is_known, row, 0.0)]])
        if len(self._rows) <= _FEWEST:
            return np.empty(0, dtype=np.intp)
        self._n_block += 1
        if self._n_block == SUMMED:
            self._gain, self._n_block = self._with_block(self._rows[1:]), 0
        is_beyond = self._are_beyond(self._rows[1:]) | self._gain.is_wrong
        self._distrust = np.clip(self._distrust + np.where(is_beyond, _SHY, -1 * is_known), 0, SUMMED)
        return np.flatnonzero(self._distrust)

    def _are_beyond(self, rows: Vector) -> NDArray[np.bool_]:
        """Return which channels are beyond their limits, from what is known of each sample (n, 4, c)."""
        n = len(rows)
        if n not in self._noises:
            self._noises[n] = self._limit_of_noise(self._noise, n)
        is_beyond = self._differ(rows, self._noises[n])
        if not is_beyond.any():  # the observed noise only widens the limits
            return is_beyond
        sigma = self._observed_noise(rows)
        limit = self._limit_of_noise(sigma, n)
        return self._differ(rows, limit) & self._differ(self._without_bursts(rows, sigma), limit)

    def _with_block(self, rows: Vector) -> DerivativeGain:
        """Return the gain with a block of samples (n, 4, c), integrated by the trapezoidal rule as the model has it."""
        sigma = self._observed_noise(rows)
        moved, xdot, drift, _ = self._without_bursts(rows, sigma).sum(axis=0)
        std = self._limit_of_noise(sigma, len(rows)) / self._limit
        return self._gain.take(moved, self._h * (xdot - 0.5 * drift), std)

    def _observed_noise(self, rows: Vector) -> Vector:
        """Return the standard deviations (c,) that derivatives have, the declared ones at least."""
        return np.maximum(self._noise, 1.05 * column_medians(rows[:, 3]))  # of a difference: 0.954 sigma

    def _differ(self, rows: Vector, of_noise: Vector) -> NDArray[np.bool_]:
        """Return in which channels the motion differs by more than the step and noise, by its limit (c,), explain."""
        moved, xdot, _, changes = rows.sum(axis=0)
        drift = np.abs(rows[:, 2]).sum(axis=0)
        h, share = self._h, np.where(self._distrust > 0, _STILL, 1.0)
        of_motion = h * drift + 0.5 * h * (changes + rows[-1, 3])
        return np.abs(moved - h * xdot) > share * of_noise + of_motion

    def _without_bursts(self, rows: Vector, sigma: Vector) -> Vector:
        """Return the rows without up to three spikes in a row that are over, and without the way back from them.

        Spikes come and go at once; a wrong sign, which fits where the derivative is small, does not.
        """
        moved, xdot, drift, changes = rows.transpose(1, 0, 2)
        differs = np.abs(moved - self._h * xdot)
        is_odd = differs > self._limit_of_noise(sigma, 1) + self._h * np.abs(drift)
        is_step = self._h * changes > 0.5 * np.maximum(differs, np.roll(differs, 1, axis=0))
        is_step[0] = True  # it began before these rows
        left = rows.copy()
        for channel, odd in enumerate(is_odd.T):
            for first, end in np.flatnonzero(np.diff(odd, prepend=False, append=False)).reshape(-1, 2):
                if end - first <= _BURST and end < len(rows) and is_step[[first, end], channel].all():
                    left[first:end, :, channel] = 0.0
                    left[end, 3, channel] = 0.0
        return left

    def _limit_of_noise(self, sigma: Vector, n: int) -> Vector:
        h = self._h
        return self._limit * np.sqrt(n * h * h * sigma * sigma + 2.0 * self._state_variance)
