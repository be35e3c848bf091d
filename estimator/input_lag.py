"""Lag of the plant's inputs that its model lacks: actuators that follow late, or samples of dead time.

tau dv/dt = u - v for a first-order lag, or v = u some samples ago. The input u is held from sample to sample, so that
v follows from the inputs alone, and a model that is given v in place of u has the lag whatever its equations are.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from math import inf
from typing import Any, Final, NamedTuple

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used
from numpy.typing import NDArray

from .hypotheses import NEVER, Fit, plain_fit
from .samples import Sample
from .space import Vector

_TIME_CONSTANTS: Final = np.geomspace(0.25, 20.0, 10)
"""Time constants that are tried, in intervals of sampling, before the best one is refined."""
_MOST_LATE: Final = 16
"""Longest dead time that is tried, in samples."""
_PROMISING: Final = 0.5
"""Share of the sum of squares without a lag that one must go below to be refined."""
_PRECISION: Final = 1e-4
"""Relative precision of the time constant."""
_KEPT: Final = 120
"""Number of inputs that are kept: what came before has faded to less than one in a hundred of the longest lag."""
_ASIDE: Final = 0.01
"""Step of differences in an input, as a share of its size."""
_LEAST: Final = 3
"""Least number of inputs that show a lag."""

Inputs = Mapping[float, tuple[float, ...]]
"""Inputs (p,) that arrive at the plant, by the time of the sample [s]."""
RowsWith = Callable[[Vector], Vector]
"""Residuals (k, n, c) of n samples with each of k sets of inputs (k, n, p) that arrive at the plant."""


@dataclass(frozen=True)
class Lag:
    """First-order lag or dead time of the inputs; neither by default."""

    time_constant: float = 0.0
    """tau [s]."""
    n_late: int = 0
    """Dead time in samples."""

    def __bool__(self) -> bool:
        return self.time_constant > 0.0 or self.n_late > 0

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
    following = [j for j, lag in enumerate(lags) if lag.time_constant]
    if following:
        taus = np.array([lags[j].time_constant for j in following])
        v = made[0, following]
        way = [v]
        for gain, u in zip(-np.expm1(-np.diff(times)[:, None] / taus)[..., None], inputs[1:], strict=True):
            v = v + gain * (u - v)
            way.append(v)
        made[:, following] = way
    for j, lag in enumerate(lags):
        if lag.n_late:
            made[lag.n_late :, j] = inputs[: max(len(inputs) - lag.n_late, 0)]
    return made.transpose(1, 0, 2)


@dataclass(frozen=True)
class FoundLag:
    """Lag that explains samples best."""

    lag: Lag
    arriving: Inputs
    """Inputs that arrive at the plant then, from some time on."""
    fit: Fit


NO_LAG: Final = FoundLag(Lag(), {}, NEVER)


@dataclass
class InputHistory:
    """Newest inputs, and what arrives at the plant where a lag is known."""

    may_lag: tuple[int, ...] | None = None
    """Places of the inputs that actuators may delay, all by the same; None for all. The others are measured."""
    lag: Lag = field(default_factory=Lag)
    """Known lag."""
    _times: list[float] = field(default_factory=list[float])
    _inputs: list[tuple[float, ...]] = field(default_factory=list[tuple[float, ...]])
    _arriving: dict[float, tuple[float, ...]] = field(default_factory=dict[float, tuple[float, ...]])

    def copy(self) -> "InputHistory":
        """Return an independent copy."""
        other = copy(self)
        other._times, other._inputs, other._arriving = [*self._times], [*self._inputs], dict(self._arriving)
        return other

    def take(self, sample: Sample) -> None:
        """Take the input of a sample."""
        self._times.append(sample.t)
        self._inputs.append(sample.u)
        if self.lag and len(self._times) > 1:
            self._arriving[sample.t] = self._arrives()
        if len(self._times) > _KEPT:
            self._forget(1)

    def _arrives(self) -> tuple[float, ...]:
        """Return what arrives with the newest input, by the known lag."""
        n = self.lag.n_late
        start = self._inputs[-1 - n] if 0 < n < len(self._inputs) else self._arriving[self._times[-2]]
        newest = slice(-1, None) if n else slice(-2, None)
        made = self._made([self.lag], *map(np.array, (self._times[newest], self._inputs[newest], start)))
        return tuple(made[0, -1].tolist())

    def _made(self, lags: Sequence[Lag], times: Vector, inputs: Vector, start: Vector) -> Vector:
        """Return what arrives of inputs (n, p) with each of k lags (k, n, p): the measured ones as they are."""
        places = self._places(inputs)
        made = np.repeat(inputs[None], len(lags), axis=0)
        made[..., places] = arriving(lags, times, inputs[:, places], start[places])
        return made

    def _places(self, inputs: Vector) -> list[int]:
        return [*range(inputs.shape[1])] if self.may_lag is None else [*self.may_lag]

    def _forget(self, n: int) -> None:
        for t in self._times[:n]:
            self._arriving.pop(t, None)
        del self._times[:n], self._inputs[:n]

    @property
    def arriving(self) -> Inputs:
        """Inputs that arrive at the plant, by time; none where those that were sent do."""
        return self._arriving

    @property
    def begin(self) -> float:
        """Time of the first input that is kept [s]; infinite without any."""
        return self._times[0] if self._times else inf

    def summary(self) -> dict[str, Any]:
        """Return the known lag as JSON values, in seconds."""
        return self.describe(self.lag)

    def describe(self, lag: Lag) -> dict[str, Any]:
        """Return a lag as JSON values, in seconds."""
        step = float(np.median(np.diff(self._times))) if lag.n_late else 0.0
        return {"time_constant": lag.time_constant, "dead_time": lag.n_late * step}

    def adopt(self, found: FoundLag) -> None:
        """Take a lag for known."""
        self.lag, self._arriving = found.lag, dict(found.arriving)
        if self._arriving:
            self._forget(self._times.index(next(iter(self._arriving))))

    def search(self, rows_with: RowsWith, times: Sequence[float]) -> FoundLag:
        """Return the lag that explains best: none, one of all inputs that are kept, or of those since the first sample.

        rows_with: residuals of n samples with what arrives at the plant; times (n,): theirs [s], all of them kept.
        """
        places = np.searchsorted(self._times, times)
        none = FoundLag(Lag(), {}, plain_fit(rows_with(np.array(self._inputs)[None, places])[0], 0))
        if self.may_lag == () or len(self._times) < _LEAST or not np.any(np.diff(self._inputs, axis=0)):
            return none
        known = self._best(rows_with, places, none.fit, 0, is_free=False)
        found = [none, known]
        if not known.fit.is_explained:
            found.append(self._best(rows_with, places, none.fit, int(places[0]), is_free=True))
        return min(found, key=lambda one: one.fit.score)

    def _best(self, rows_with: RowsWith, places: NDArray[np.intp], none: Fit, first: int, *, is_free: bool) -> FoundLag:
        """Return the best lag of the inputs from the first one on; is_free: what arrives then is fitted, too.

        places (n,): of the samples' inputs among those that are kept; none: fit without a lag.
        """
        if len(self._times) - first < _LEAST:
            return NO_LAG
        times, inputs = np.array(self._times[first:]), np.array(self._inputs[first:])
        start = np.array(self._arriving.get(self._times[first], self._inputs[first]))
        seen, may_lag = places - first, self._places(inputs)
        aside = np.diag(_ASIDE * np.maximum(np.abs(inputs).max(axis=0), 1e-6))[may_lag] if is_free else None

        def fits(lags: Sequence[Lag]) -> list[_Tried]:
            made = self._made(lags, times, inputs, start)
            rows = rows_with(made[:, seen])
            if aside is not None:
                fading = np.array([lag.fading(times) for lag in lags])
                made = _started(made, fading[:, None, :, None] * aside[:, None], rows, seen, rows_with)
                rows = rows_with(made[:, seen])
            n_free = 1 + is_free * len(may_lag)
            tried = zip(lags, made, rows, strict=True)
            return [_Tried(lag, arrives, plain_fit(left, n_free)) for lag, arrives, left in tried]

        return self._found(_best_of(fits, times, none, is_free), first)

    def _found(self, best: "_Tried | None", first: int) -> FoundLag:
        """Return a lag that was tried on the inputs from the first one on, as what is found."""
        if best is None:
            return NO_LAG
        return FoundLag(best.lag, dict(zip(self._times[first:], map(tuple, best.made.tolist()), strict=True)), best.fit)


class _Tried(NamedTuple):
    """Lag that was tried."""

    lag: Lag
    made: Vector
    """What arrives at the plant with it (N, p)."""
    fit: Fit


def _started(made: Vector, moved: Vector, rows: Vector, seen: NDArray[np.intp], rows_with: RowsWith) -> Vector:
    """Return what arrives with each of k lags (k, N, p), what arrives first being fitted to the samples.

    moved (k, q, N, p): changes of it; rows (k, n, c): residuals before; seen (n,): places of the samples' inputs.
    """
    k, q, _, p = moved.shape
    aside = rows_with((made[:, None] + moved)[:, :, seen].reshape(k * q, len(seen), p))
    slopes = (aside.reshape(k, q, -1) - rows.reshape(k, 1, -1)).transpose(0, 2, 1)
    fitted = made.copy()
    for i, slope in enumerate(slopes):
        if np.all(np.isfinite(slope)):
            steps = np.linalg.lstsq(slope, rows[i].reshape(-1), rcond=1e-7)[0]
            fitted[i] -= np.tensordot(steps, moved[i], 1)
    return fitted


def _best_of(fits: Callable[[Sequence[Lag]], list[_Tried]], times: Vector, none: Fit, is_free: bool) -> _Tried | None:
    """Return the best of all lags of inputs at times (n,) [s], or None; none: fit without a lag."""
    most = min(_MOST_LATE, len(times) // 2 if is_free else len(times) - _LEAST)
    late = _inner(fits([Lag(n_late=n) for n in range(1, most + 1)]) if most > 0 else [])
    if late is not None and late.fit.is_explained:
        return late
    step = float(np.median(np.diff(times)))
    slow = _inner(fits([Lag(tau) for tau in (step * _TIME_CONSTANTS).tolist()]))
    if slow is None or slow.fit.squares > _PROMISING * none.squares:
        return late
    ratio = _TIME_CONSTANTS[1] / _TIME_CONSTANTS[0]
    refined = scipy.optimize.minimize_scalar(
        lambda log_tau: fits([Lag(float(np.exp(log_tau)))])[0].fit.squares,
        bounds=np.log(slow.lag.time_constant * np.array([1.0 / ratio, ratio])),
        method="bounded", options={"xatol": _PRECISION},
    )  # fmt: skip
    (best,) = fits([Lag(float(np.exp(refined.x)))])
    return best if late is None or best.fit.score < late.fit.score else late


def _inner(tried: Sequence[_Tried]) -> _Tried | None:
    """Return the best one, or None where that is the longest: such a lag is a gain, or no input at all."""
    best = min(tried, key=lambda one: one.fit.squares, default=None)
    return None if best is None or best is tried[-1] else best
