"""Search for limits of what arrives of the inputs: actuators at the end of their range, or stuck.

What must have arrived of an input for the model to explain a sample follows from the model's slope by it. It is
constant where the actuator is stuck, and where it is at its limit it is that: faults of actuators in Blanke et al.
(2016), "Diagnosis and Fault-Tolerant Control", chapter 3.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from math import inf, isfinite
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import MARGIN, Fit, plain_fit
from ..space import Vector
from .lag import Lag
from .lag_search import ASIDE, RowsWith

_LEAST: Final = 3
"""Least number of samples at a limit, and between two of them."""
_SHORT: Final = 3.0
"""Standard deviations that less must have arrived than was sent, where the search for a limit begins."""
_PASSES: Final = 4
"""Number of times that a limit and the samples at it are found from each other."""
_STEPS: Final = 3
"""Most Gauss-Newton steps by which limits are refined, where the model is not linear in the inputs."""

Limits = tuple[float, float]
"""Least and largest value of an input that arrives."""
Limited = Mapping[int, Limits]
"""Limits of inputs by their place; equal ones where an input is stuck."""


class Tried(NamedTuple):
    """Limits that were tried."""

    limits: Limited
    made: Vector
    """Inputs (n, p) that arrive with them."""
    rows: Vector
    """Residuals (n, c) then."""

    @property
    def fit(self) -> Fit:
        """Fit to the samples."""
        return plain_fit(self.rows, len(_values(self.limits)))


class InputLimits:
    """Limits that explain n samples."""

    def __init__(
        self,
        rows_with: RowsWith,
        inputs: Vector,
        places: Sequence[int],
        of_samples: Callable[[Vector], Vector] = lambda inputs: inputs,
    ) -> None:
        """rows_with: residuals (k, n, c) with each of k sets of inputs (k, n, p); inputs (N, p): that were sent in each
        step; places: of those that actuators pass on; of_samples: what samples have of them, (k, n, p) of (k, N, p)."""
        self._rows_with, self._inputs, self._places, self._of_samples = rows_with, inputs, places, of_samples
        self._sent = of_samples(inputs[None])[0]
        ranges = np.ptp(self._sent, axis=0) if len(inputs) else np.zeros(0)
        self._moving = [j for j in places if len(inputs) and ranges[j] > 0.0]  # of others nothing is told

    def stuck(self) -> Tried | None:
        """Return the one input, or all of them, that may be stuck; None where no input varies."""
        return self._best([*self._stuck(self._arrived())]) if self._moving else None

    def best(self) -> Tried | None:
        """Return the limits that explain best, one input's or all that are stuck; None where no input varies."""
        if not self._moving:
            return None
        arrived = self._arrived()
        stuck, at_limit = self._best([*self._stuck(arrived)]), self._best([*self._at_limit(arrived)])
        if at_limit is None or (stuck is not None and stuck.fit.score + MARGIN <= at_limit.fit.score):
            return stuck
        return at_limit  # less is lost if it is wrong: what is within the limits arrives

    def lag(self, tried: Tried) -> Lag:
        """Return limits as a lag of all inputs that actuators pass on."""
        return Lag(limits=tuple(tried.limits.get(j, (-inf, inf)) for j in self._places))

    def _arrived(self) -> list[tuple[int, Vector, Vector]]:
        """Return what must have arrived of each input that varies, by itself, for every sample (n,), and its weight.

        The weight is the inverse of the variance, 0 where the input reaches no channel.
        """
        sent = self._sent[:, self._moving].T  # (q, n)
        steps = ASIDE * np.abs(sent).max(axis=1)
        moved = np.repeat(self._sent[None], len(steps) + 1, axis=0)
        for j, inputs, step in zip(self._moving, moved[1:], steps, strict=True):
            inputs[:, j] += step
        rows = self._rows_with(moved)
        slopes = (rows[1:] - rows[0]) / steps[:, None, None]  # (q, n, c)
        along, weights = (slopes * rows[0]).sum(axis=2), (slopes**2).sum(axis=2)
        known = np.isfinite(along) & (weights > 0.0)
        off = np.divide(along, weights, out=np.zeros(along.shape), where=known)
        return [*zip(self._moving, sent - off, np.where(known, weights, 0.0), strict=True)]

    def _stuck(self, arrived: Sequence[tuple[int, Vector, Vector]]) -> Iterator[Limited]:
        means = {j: _mean(v, w) for j, v, w in arrived if w.any()}
        yield from ({j: (value, value)} for j, value in means.items())
        if len(means) > 1:
            yield {j: (value, value) for j, value in means.items()}

    def _at_limit(self, arrived: Sequence[tuple[int, Vector, Vector]]) -> Iterator[Limited]:
        """Yield an upper limit of each input, a lower one, and both, as far as the samples show them."""
        for j, v, w in arrived:
            sent = self._sent[:, j]
            upper, lower = _limit(sent, v, w), -_limit(-sent, -v, w)
            if upper < inf:
                yield {j: (-inf, upper)}
            if lower > -inf:
                yield {j: (lower, inf)}
            if -inf < lower < upper < inf and np.count_nonzero((lower < sent) & (sent < upper)) >= _LEAST:
                yield {j: (lower, upper)}

    def _best(self, limits: Sequence[Limited]) -> Tried | None:
        found = min(self._tried(limits), key=lambda one: one.fit.score, default=None)
        for _ in range(0 if found is None else _STEPS):
            assert found is not None
            better = self._refined(found)
            if better.fit.squares >= found.fit.squares:
                break
            found = better
        return found

    def _tried(self, limits: Sequence[Limited]) -> list[Tried]:
        if not limits:
            return []
        made = np.repeat(self._inputs[None], len(limits), axis=0)
        for arriving, of in zip(made, limits, strict=True):
            for j, (lower, upper) in of.items():
                arriving[:, j] = np.minimum(np.maximum(arriving[:, j], lower), upper)
        made = self._of_samples(made)
        return [Tried(*one) for one in zip(limits, made, self._rows_with(made), strict=True)]

    def _refined(self, found: Tried) -> Tried:
        """Return the limits a Gauss-Newton step away."""
        values: Vector = np.array(_values(found.limits))
        step = ASIDE * float(np.abs(self._sent[:, [*found.limits]]).max())
        aside = self._tried([_with_values(found.limits, moved) for moved in values + step * np.identity(len(values))])
        slopes = np.array([(one.rows - found.rows).reshape(-1) / step for one in aside])
        if not np.all(np.isfinite(slopes)):
            return found
        moves = np.linalg.lstsq(slopes.T, found.rows.reshape(-1), rcond=1e-7)[0]
        return self._tried([_with_values(found.limits, values - moves)])[0]


def _values(limits: Limited) -> list[float]:
    """Return the limits that there are, one number for an input that is stuck."""
    return [v for lower, upper in limits.values() for v in sorted({lower, upper}) if isfinite(v)]


def _with_values(limits: Limited, values: Vector) -> Limited:
    """Return limits of the same kinds at other values."""
    rest = iter(values.tolist())
    moved: dict[int, Limits] = {}
    for j, (lower, upper) in limits.items():
        first = next(rest) if isfinite(lower) or lower == upper else lower
        moved[j] = (first, first if lower == upper else next(rest) if isfinite(upper) else upper)
    return moved


def _mean(values: Vector, weights: Vector) -> float:
    """Return the weighted mean of values (n,)."""
    return float((values * weights).sum() / weights.sum())


def _limit(sent: Vector, arrived: Vector, weights: Vector) -> float:
    """Return the largest value that arrives, infinite where too few samples (n,) show one."""
    is_at_limit: NDArray[np.bool_] = (sent - arrived) * np.sqrt(weights) > _SHORT
    limit = inf
    for _ in range(_PASSES):
        if np.count_nonzero(is_at_limit) < _LEAST:
            return inf
        limit = _mean(arrived[is_at_limit], weights[is_at_limit])
        is_at_limit = (sent > limit) & (weights > 0.0)
    return limit
