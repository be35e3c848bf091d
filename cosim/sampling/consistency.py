"""Consistency of sampled derivatives with the differences of their states.

This detects a derivative sensor that is biased, scaled, delayed or has the wrong sign, as long as the sensor of its
state is right, whatever the parameters are.
"""

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import Sample, Vector

from ..user_code import USERS
from .derivative_gain import DerivativeGain
from .medians import column_medians
from .sensor_checks import SUMMED

_FEWEST: Final = 5
"""Least number of samples whose scatter is an estimate of the noise."""
_STILL: Final = 0.5
"""Share of the noise's limit above which a derivative that was inconsistent still is."""
_BURST: Final = 3
"""Largest number of spikes in a row that are no fault of the derivative once they are over."""
_OTHER: Final = 1.5
"""Factor by which inputs are changed to see whether a derivative depends on them."""
_UNIT: Final = 0.5
"""Error of a gain that twenty samples show."""
_PARTED: Final = 2
"""Number of newest samples in which a state must not follow its derivative."""
_UNUSUAL: Final = 2.0
"""Multiple of the most that was missed of a motion before by which each of them must be off."""
_LEFT: Final = 0.1
"""Largest share of the squares that it may leave of what the model misses of the motion."""
_CLOSE: Final = 0.3
"""Share of each motion that may be missed without such an error: it is less than 0.5 of what is modelled."""
_SHY: Final = 3
"""Number of consistent samples that make good for an inconsistent one."""
_WANDERING: Final = 10.0
"""Largest mean over twenty samples, in standard deviations, of noise that wanders to both sides of zero."""


class Contradictions(NamedTuple):
    """Pairs of a state and its derivative that contradict each other, by their numbers among all pairs."""

    derivatives: tuple[int, ...] = ()
    """Pairs whose sampled derivative does not fit the state's motion."""
    states: tuple[int, ...] = ()
    """Pairs whose state does not fit its modelled derivative, or is late."""
    jumps: tuple[int, ...] = ()
    """Pairs whose state has jumped with the newest sample though its derivative has not."""


class Consistency:
    """Check of x_k - x_j against h sum xdot_i, i = j+1 .. k, over the newest samples, channel by channel.

    A sample at the end of a step belongs to the input that was held over it. So the rectangle rule errs by h/2 times
    the change of the derivative over the step, whose size the model predicts. The limit is the sum of that of the
    noise, declared or observed, whichever is larger, of twice that error, and of h/2 sum |xdot_i - xdot_(i-1)|, the
    last counted twice, so that a spike is no bias; nor are a few in a row, once they are over. A channel that was
    inconsistent is so until it has been below this, with half of the noise that it had before, for three times as many
    samples, at most 20: a derivative with the wrong sign fits, too, where it is small. What is beyond the limit now to
    this side and now to that, by little, is noise that is correlated from sample to sample, and widens it. A wrong
    `DerivativeGain` over a hundred samples or more is inconsistent, too.

    A state whose derivative is not sampled has a gain by its modelled derivative, where neither parameters nor inputs
    matter to that: kinematics, as of a position. Where no derivative is sampled, two samples tell that it does not
    follow that any more.
    """

    def __init__(
        self,
        channels: tuple[int, ...],
        noise: tuple[float, ...],
        state_noise: tuple[float, ...],
        slope: Callable[[Vector, Sequence[float], Sequence[float]], Sequence[float]],
        limit: float,
        h: float,
        others: tuple[Vector, ...] = (),
    ) -> None:
        """channels (c,): the states' places in x; noise (c,), state_noise (n,): standard deviations of the derivatives
        and of all states; slope: modelled derivatives (n,) at theta, x and u; limit: in standard deviations; h: macro
        step [s]; others: parameters (d,) to compare the other states' derivatives at; none of them is checked without.
        """
        unsampled = [i for i in range(len(state_noise)) if i not in channels] if others else []
        self.places = [*channels, *unsampled]
        """Places in x of the states that are checked, a pair each (k,), those with sampled derivatives first."""
        self._slope, self._h, self._limit, self._others = slope, h, limit, others
        self._n_sampled, self._is_kinematic = len(channels), np.ones(len(unsampled), dtype=bool)
        self._noise = self._declared = np.array([*noise, *[0.0] * len(unsampled)])
        self._state_variance = np.square(np.array(state_noise)[self.places])
        # Motion of the state, derivative, its modelled change, and the size of its change.
        self._rows = np.empty((0, 4, len(self.places)))
        self._noises: dict[int, Vector] = {}  # limits of the declared noise, by the number of changes
        self._usual = self._noise  # observed noise while a derivative is trusted
        self._lowest, self._highest = np.zeros((2, len(self.places)))  # means beyond the limit, to either side
        self.forget()
        self._last: Sample | None = None
        self._distrust = np.zeros(len(self.places), dtype=np.intp)  # number of samples for which it is inconsistent yet

    def step(self, sample: Sample, theta: Vector) -> Contradictions:
        """Return the pairs that contradict each other; a gap in time restarts the check. theta (d,): in force."""
        last, self._last = self._last, sample
        if last is None or abs(sample.t - last.t - self._h) > 0.5 * self._h:
            self._rows, last = self._rows[:0], sample
            self.forget()
        now, before = (self._slope(theta, x, sample.u) for x in (sample.x, last.x))
        moved = [sample.x[i] - last.x[i] for i in self.places]
        drift = [now[i] - before[i] for i in self.places]
        n = self._n_sampled
        xdot = [*sample.xdot, *(now[i] for i in self.places[n:])]
        changes = [*(abs(a - b) for a, b in zip(sample.xdot, last.xdot, strict=True)), *(abs(d) for d in drift[n:])]
        row = np.array([moved, xdot, drift, changes])
        is_finite = np.isfinite(row)
        is_known = is_finite.all(axis=0)  # not beside a missing derivative: no motion is compared there
        row = row if is_finite.all() else np.where(is_known, row, 0.0)
        self._rows = np.concatenate([self._rows[-SUMMED:], row[None]])
        if len(self._rows) <= _FEWEST:
            return Contradictions()
        self._n_block += 1
        if self._n_block == SUMMED:
            self._gain, self._n_block = self._with_block(self._rows), 0
        missed = self._missed(self._rows.transpose(1, 0, 2))
        has_jumped, has_wrong_unit = self._have_jumped(missed), self._have_wrong_unit(self._rows[1:], missed[1:])
        if not n:  # else the pair of the state whose sensor is wrong tells
            has_wrong_unit |= self._have_parted(missed)
        if self._is_kinematic.any() and (has_jumped[n:].any() or has_wrong_unit[n:].any() or not self._n_block):
            self._is_kinematic &= self._are_kinematic(sample, now)
        is_wrong, are_beyond = self._gain.n_wrong > 0, self._are_beyond(self._rows[1:])[:n]
        if not any(map(np.count_nonzero, (is_wrong, are_beyond, has_jumped, has_wrong_unit, self._distrust))):
            return Contradictions()
        is_compared = np.append(np.ones(n, dtype=bool), self._is_kinematic)
        is_beyond = is_wrong & is_compared
        is_beyond[:n] |= are_beyond
        if not np.count_nonzero((is_beyond | has_jumped | (self._distrust > 0))[:n]):  # else it may be that state's
            is_beyond |= has_wrong_unit & is_compared
        self._distrust = np.clip(self._distrust + np.where(is_beyond, _SHY, -1 * is_known), 0, SUMMED)
        is_state = (np.arange(len(self.places)) >= n) | self._gain.is_state_late
        found = (self._distrust > 0) & ~is_state, (self._distrust > 0) & is_state, has_jumped & is_compared
        return Contradictions(*(tuple(np.flatnonzero(pairs).tolist()) for pairs in found))

    def _are_kinematic(self, sample: Sample, now: Sequence[float]) -> NDArray[np.bool_]:
        """Return which unsampled derivatives are the same with other parameters and inputs; now (n,): of all states.

        None where the model has no value there. Inputs that are zero stay: of a vector of disturbances a model may take
        all or none, and some are left out of the samples.
        """
        u, unsampled = [_OTHER * value for value in sample.u], self.places[self._n_sampled :]
        try:
            others = [self._slope(theta, sample.x, u) for theta in self._others]
        except USERS:
            return np.zeros(len(unsampled), dtype=bool)
        return np.array([all(other[i] == now[i] for other in others) for i in unsampled])

    def _have_jumped(self, missed: Vector) -> NDArray[np.bool_]:
        """Return which states (k,) have moved by far more against their derivatives than before.

        None that has stood still: a coarse sensor jumps all the time. Nor one whose derivative has: that is a spike.
        missed (n, k): of the motions by the derivatives.
        """
        missed, of_step = np.abs(missed), self._h * np.abs(self._rows[-1, 2])
        has_jumped: NDArray[np.bool_] = missed[-1] > self._of_declared(1) + of_step
        if not np.count_nonzero(has_jumped):  # what is usual only widens the limits
            return has_jumped
        moved, _, _, changes = self._rows.transpose(1, 0, 2)
        usual = np.maximum(2.0 * missed[:-1].max(axis=0), self._limit * 1.4826 * column_medians(missed[:-1]))
        is_own = (moved != 0.0).all(axis=0) & (self._h * changes[-1] < 0.5 * missed[-1])
        is_own &= np.abs(moved[-1] - column_medians(moved)) > 0.5 * missed[-1]
        has_jumped &= (missed[-1] > usual + of_step) & is_own
        return has_jumped

    def _have_wrong_unit(self, rows: Vector, missed: Vector) -> NDArray[np.bool_]:
        """Return which states (k,) without a sampled derivative move by a multiple of what is modelled, far from 1.

        All samples (n, 4, k) must have moved, and not by the same: a coarse sensor stands still or steps, and what a
        model lacks may be constant. missed (n, k): of the motions by the derivatives.
        """
        n, (moved, xdot, drift, _) = self._n_sampled, rows.transpose(1, 0, 2)
        is_wrong, missed = np.zeros(len(self.places), dtype=bool), missed[:, n:]
        if len(rows) < SUMMED or (np.abs(missed) <= _CLOSE * np.abs(moved[:, n:])).all():
            return is_wrong
        modelled = self._h * (xdot - 0.5 * drift)[:, n:]
        usual = np.argsort(np.abs(missed), axis=0)[:-_BURST], np.arange(missed.shape[1])  # without spikes
        missed, modelled = missed[usual], modelled[usual]
        aside = missed - missed.sum(axis=0) / len(missed)
        is_more = _products(aside, aside) > 2.0 * self._limit**2 * len(aside) * self._state_variance[n:]
        is_more &= _is_multiple(missed, modelled)
        if np.count_nonzero(is_more):
            is_more &= _is_multiple(aside, modelled - modelled.sum(axis=0) / len(modelled))
            is_wrong[n:] = is_more & (moved[:, n:] != 0.0).all(axis=0)
        return is_wrong

    def _have_parted(self, missed: Vector) -> NDArray[np.bool_]:
        """Return which states (k,) do not follow their modelled derivatives any more, as they did a moment ago.

        So it is where the sensor of a state that they depend on begins to be wrong: the derivative jumps, and the
        motion does not. None that stands still, as a coarse sensor does. missed (n, k): of the motions by the
        derivatives; the older half of them shows what is usual.
        """
        older, newest = np.abs(missed[: len(missed) // 2]), missed[-_PARTED:]
        if len(older) < _FEWEST:
            return np.zeros(len(self.places), dtype=bool)
        moved, xdot, drift, _ = self._rows[-_PARTED:].transpose(1, 0, 2)
        usual = self._of_declared(1) + _UNUSUAL * older.max(axis=0)
        is_far = np.abs(newest) > np.maximum(usual + self._h * np.abs(drift), _UNIT * self._h * np.abs(xdot))
        is_one_sided = np.abs(np.sign(newest).sum(axis=0)) == _PARTED
        return np.asarray((is_far & (moved != 0.0)).all(axis=0) & is_one_sided)

    def _missed(self, rows: Vector) -> Vector:
        """Return by how much (..., c) the motion over a step exceeds the derivative's, rows (4, ..., c)."""
        moved, xdot, drift, _ = rows
        return moved - self._h * (xdot - 0.5 * drift)

    def forget(self) -> None:
        """Forget the gains so far: a state that was wrong has been in them."""
        self._gain, self._n_block = DerivativeGain(self._limit), 0

    @property
    def n_doubtful(self) -> int:
        """Number of newest samples in which an inconsistent derivative or state may have been wrong already."""
        return 3 * SUMMED + 2 * SUMMED * int(np.max(self._gain.n_wrong, initial=0))

    def _are_beyond(self, rows: Vector) -> NDArray[np.bool_]:
        """Return which channels are beyond their limits, from what is known of each sample (n, 4, c)."""
        n = len(rows)
        is_beyond = self._differ(rows, self._of_declared(n))
        if not np.count_nonzero(is_beyond[: self._n_sampled]):  # the observed noise only widens the limits
            return is_beyond
        self._usual = np.where(self._distrust > 0, self._usual, self._observed_noise(rows))
        limit = self._limit_of_noise(self._usual, n)
        is_beyond &= self._differ(rows, limit) & self._differ(self._without_bursts(rows, self._usual), limit)
        if n == SUMMED and np.count_nonzero(is_beyond):
            self._admit_wandering(rows, is_beyond)
        return is_beyond

    def _admit_wandering(self, rows: Vector, is_beyond: NDArray[np.bool_]) -> None:
        """Take what wanders to both sides, by little, for noise that is correlated from sample to sample.

        A bias stays on one side. rows (n, 4, k): the newest samples; is_beyond (k,): of the pairs.
        """
        mean = self._missed(rows.sum(axis=0)) / (self._h * len(rows))
        self._lowest = np.where(is_beyond, np.minimum(self._lowest, mean), self._lowest)
        self._highest = np.where(is_beyond, np.maximum(self._highest, mean), self._highest)
        size = np.maximum(-self._lowest, self._highest)
        wanders = is_beyond & (self._lowest < 0.0) & (self._highest > 0.0) & (size < _WANDERING * self._declared)
        if np.count_nonzero(wanders):
            of_size = 1.2 * size * np.sqrt(len(rows)) / self._limit
            self._noise = np.where(wanders, np.maximum(self._noise, of_size), self._noise)
            self._noises.clear()

    def _with_block(self, rows: Vector) -> DerivativeGain:
        """Return the gain with a block of samples (n, 4, c), integrated by the trapezoidal rule as the model has it.

        The first is the last one before the block.
        """
        before, rows, h = rows[0], rows[1:], self._h
        sigma = self._observed_noise(rows)
        kept = self._without_bursts(rows, sigma)
        moved, xdot, drift, _ = kept.sum(axis=0)
        change, drifted = np.where((kept == rows).all(axis=(0, 1)), [rows[-1, 1] - before[1], drift], 0.0)
        std = self._limit_of_noise(sigma, len(rows)) / self._limit
        own = h * sigma * np.sqrt(len(rows))
        return self._gain.take(moved, h * (xdot - 0.5 * drift), h * change, h * drifted, std, own)

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

        Spikes come and go at once; a wrong sign, which fits where the derivative is small, does not. And
        without the only motion that the derivative does not show: in a collision the velocity jumps.
        """
        moved, xdot, drift, changes = rows.transpose(1, 0, 2)
        differs = np.abs(moved - self._h * xdot)
        is_odd = differs > self._limit_of_noise(sigma, 1) + self._h * np.abs(drift)
        is_shown = (self._h * changes > 0.5 * differs) | (np.abs(moved - column_medians(moved)) < 0.5 * differs)
        is_step = self._h * changes > 0.5 * np.maximum(differs, np.roll(differs, 1, axis=0))
        is_step[0] = True  # it began before these rows
        left = rows.copy()
        for channel in np.flatnonzero(is_odd.any(axis=0)).tolist():
            odd = is_odd[:, channel]
            for first, end in np.flatnonzero(np.diff(odd, prepend=False, append=False)).reshape(-1, 2):
                if end - first <= _BURST and end < len(rows) and is_step[[first, end], channel].all():
                    left[first:end, :, channel] = 0.0
                    left[end, 3, channel] = 0.0
            if len(rows) == SUMMED and odd.sum() == 1 and not is_shown[odd, channel].any():
                left[odd, :, channel] = 0.0
        return left

    def _of_declared(self, n: int) -> Vector:
        """Return the limit of the declared noise (c,) over n samples."""
        if n not in self._noises:
            self._noises[n] = self._limit_of_noise(self._noise, n)
        return self._noises[n]

    def _limit_of_noise(self, sigma: Vector, n: int) -> Vector:
        h = self._h
        return self._limit * np.sqrt(n * h * h * sigma * sigma + 2.0 * self._state_variance)


def _is_multiple(missed: Vector, modelled: Vector) -> NDArray[np.bool_]:
    """Return whether what is missed of each motion (n, k) is a multiple of what is modelled, and of account.

    That is where the squares that a regression leaves, total - both^2 / size, are a small share of the total.
    """
    size, total, both = _products(modelled, modelled), _products(missed, missed), _products(missed, modelled)
    return np.asarray((both**2 > (1.0 - _LEFT) * total * size) & (np.abs(both) > _UNIT * size))


def _products(a: Vector, b: Vector) -> Vector:
    """Return the scalar product (k,) of each column of a and b (n, k)."""
    return np.einsum("nk,nk->k", a, b)
