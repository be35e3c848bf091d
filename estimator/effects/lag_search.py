"""Search for the lag of the inputs that explains samples: a dead time, a first-order lag, or limited rates."""

from collections.abc import Callable, Sequence
from math import ceil, inf, isfinite, log
from typing import Final, NamedTuple

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..hypotheses import Fit
from ..significance import FALSE_ALARM, chi2_limit
from ..space import Vector
from .lag import Lag

_TIME_CONSTANTS: Final = np.geomspace(0.25, 20.0, 10)
"""Time constants that are tried, in intervals of sampling, before the best one is refined; from a quarter of a step."""
_MOST_LATE: Final = 16
"""Longest dead time that is tried, in intervals of sampling; of more steps, some."""
_LONGER: Final = 1.15
"""Ratio of one dead time to the one before, of those of more steps."""
_RATES: Final = np.geomspace(0.02, 0.98, 14)
"""Limits of the rate that are tried, as shares of the fastest change of an input."""
_PROMISING: Final = 0.5
"""Share of the sum of squares without a lag below which the rates are worth a trial."""
_NEAR: Final = 0.12
"""Share below which a lag is refined: one that explains has less beside it, a quarter of its time constant away."""
_EXPLAINING: Final = 4.0
"""Sum of squares by the chi-square limit up to which it is refined, too: of a lag that hardly shows."""
_PASSES: Final = 3
"""Largest number of times that the limits of several rates are refined, one after the other: each depends on all."""
_PRECISION: Final = 1e-4
"""Relative precision of the time constant, and of a limited rate."""
ASIDE: Final = 0.01
"""Step of differences in an input, as a share of its size."""
LEAST: Final = 3
"""Least number of inputs that show a lag."""

RowsWith = Callable[[Vector], Vector]
"""Residuals (k, n, c) of n samples with each of k sets of inputs (k, n, p) that arrive at the plant."""


class TriedLag(NamedTuple):
    """Lag that was tried."""

    lag: Lag
    made: Vector
    """What arrives at the plant with it (N, p)."""
    fit: Fit


Fits = Callable[[Sequence[Lag]], list[TriedLag]]
"""Function that tries lags."""


def best_lag(fits: Fits, times: Vector, inputs: Vector, none: Fit, *, is_free: bool, every: int = 1) -> TriedLag | None:
    """Return the best of all lags of inputs (n, q), held up to times (n,) [s], or None.

    none: fit without a lag. is_free: whether what arrives first is fitted, too; rates are not limited then. every:
    number of times from one sample to the next.
    """
    most = min(_MOST_LATE * every, len(times) // 2 if is_free else len(times) - LEAST)
    late = _late(fits, most, none)
    found = [_inner(late)]
    if every == 1 and found[0] is not None and found[0].fit.is_explained:
        return found[0]
    step = float(np.median(np.diff(times)))
    time_constants = _over_samples(_TIME_CONSTANTS, every, longer=True)
    slow = fits([Lag(tau) for tau in (step * time_constants).tolist()])
    best = _inner(slow)
    if best is not None and _is_near(best, none):
        found.append(_refined(fits, best, lambda tau: Lag(tau), best.lag.time_constant, time_constants))
    is_late = min(one.fit.squares for one in [*late, *slow]) <= _PROMISING * none.squares
    if is_late and not is_free and not any(one is not None and one.fit.is_explained for one in found):
        found.append(_limited(fits, times, inputs, none, _over_samples(_RATES, every, longer=False)))
    return min((one for one in found if one is not None), key=lambda one: one.fit.score, default=None)


def _late(fits: Fits, most: int, none: Fit) -> list[TriedLag]:
    """Return the dead times of up to so many steps, by their length: of long ones some, and those near the best."""
    if most < 1:
        return []
    steps = [*range(1, min(most, _MOST_LATE) + 1)]
    few = steps[-1]
    steps += np.geomspace(few, most, round(log(most / few) / log(_LONGER)) + 1)[1:].round().astype(int).tolist()
    late = fits([Lag(n_late=n) for n in steps])
    best = _inner(late)
    if best is None or best.lag.n_late < few or not _is_near(best, none):
        return late
    place = steps.index(best.lag.n_late)
    close = [n for n in range(steps[place - 1] + 1, steps[place + 1]) if n != steps[place]]
    return sorted([*late, *fits([Lag(n_late=n) for n in close])], key=lambda one: one.lag.n_late) if close else late


def _over_samples(tried: Vector, every: int, *, longer: bool) -> Vector:
    """Return values that are tried, for samples so many steps apart: in the same ratios, to larger or smaller ones."""
    if every == 1:
        return tried
    n = len(tried) + ceil(log(every) / log(tried[1] / tried[0]))
    return np.geomspace(tried[0], every * tried[-1], n) if longer else np.geomspace(tried[0] / every, tried[-1], n)


def _inner(tried: Sequence[TriedLag]) -> TriedLag | None:
    """Return the best one, or None where that is the longest: such a lag is a gain, or no input at all."""
    best = min(tried, key=lambda one: one.fit.squares, default=None)
    return None if best is None or best is tried[-1] else best


def _is_near(tried: TriedLag, none: Fit) -> bool:
    """Return whether a lag beside one that was tried may explain the samples; none: fit without a lag."""
    return tried.fit.squares <= max(_NEAR * none.squares, _EXPLAINING * chi2_limit(FALSE_ALARM, none.n_values))


def _refined(fits: Fits, best: TriedLag, lag_of: Callable[[float], Lag], value: float, tried: Vector) -> TriedLag:
    """Return the best lag_of(v) for v between the values that were tried beside the best one, or that one."""
    ratio, found = tried[1] / tried[0], dict[float, TriedLag]()

    def squares(log_value: float) -> float:
        (one,) = fits([lag_of(float(np.exp(log_value)))])
        found[log_value] = one
        return one.fit.squares

    bounds = np.log(value * np.array([1.0 / ratio, ratio]))
    options = {"xatol": _PRECISION}
    refined = scipy.optimize.minimize_scalar(squares, bounds=bounds, method="bounded", options=options)
    return min(best, found[refined.x], key=lambda one: one.fit.squares)


def _limited(fits: Fits, times: Vector, inputs: Vector, none: Fit, shares: Vector) -> TriedLag | None:
    """Return the best limits of the inputs' rates, or None: first one for all or one share of all, then each by itself.

    shares: of the fastest change of an input, that are tried.
    """
    fastest = np.abs(np.diff(inputs, axis=0) / np.diff(times)[:, None]).max(axis=0)
    fastest = np.where(fastest > 0.0, fastest, inf)
    limited = [j for j, most in enumerate(fastest) if isfinite(most)]
    if not limited:
        return None
    same = np.where(np.isfinite(fastest), fastest[limited].max(), inf)
    scales = [fastest] if np.array_equal(same, fastest) else [fastest, same]
    tried = [_inner(fits([Lag(rates=tuple(rates.tolist())) for rates in shares[:, None] * of])) for of in scales]
    best = min((one for one in tried if one is not None), key=lambda one: one.fit.squares, default=None)
    if best is None or best.fit.squares > _PROMISING * none.squares:
        return None
    if _is_near(best, none):
        rates = best.lag.rates
        best = _refined(fits, best, lambda share: Lag(rates=tuple(share * rate for rate in rates)), 1.0, shares)
    for j in limited:
        best = _limited_at(fits, best, j, (shares * fastest[j]).tolist())
    if _is_near(best, none):
        for j in limited * min(len(limited), _PASSES):
            best = _refined_at(fits, best, j, shares)
    return best


def _with_rate(lag: Lag, j: int, rate: float) -> Lag:
    """Return a lag with another limit of the rate of input j, beside the others' limits."""
    return Lag(rates=(*lag.rates[:j], rate, *lag.rates[j + 1 :]))


def _limited_at(fits: Fits, best: TriedLag, j: int, rates: Sequence[float]) -> TriedLag:
    """Return the best of these limits of the rate of input j, or none, beside the others' limits."""
    tried = fits([_with_rate(best.lag, j, rate) for rate in [*rates, inf]])
    return min([best, *tried], key=lambda one: one.fit.score)


def _refined_at(fits: Fits, best: TriedLag, j: int, tried: Vector) -> TriedLag:
    """Return the best limit of the rate of input j close to the one it has, if any, beside the others' limits.

    tried: rates that have been tried, in their ratio.
    """
    rate = best.lag.rates[j]
    return best if rate == inf else _refined(fits, best, lambda r: _with_rate(best.lag, j, r), rate, tried)


def with_fitted_start(
    made: Vector, moved: Vector, rows: Vector, of_samples: Callable[[Vector], Vector], rows_with: RowsWith
) -> Vector:
    """Return what arrives with each of k lags (k, N, p), what arrives first being fitted to the samples.

    moved (k, q, N, p): changes of it; rows (k, n, c): residuals before; of_samples: what samples have of it.
    """
    k, q, _, p = moved.shape
    aside = rows_with(of_samples(made[:, None] + moved).reshape(k * q, -1, p))
    slopes = (aside.reshape(k, q, -1) - rows.reshape(k, 1, -1)).transpose(0, 2, 1)
    fitted = made.copy()
    for i, slope in enumerate(slopes):
        if np.all(np.isfinite(slope)):
            steps = np.linalg.lstsq(slope, rows[i].reshape(-1), rcond=1e-7)[0]
            fitted[i] -= (steps[None] @ moved[i].reshape(q, -1)).reshape(fitted[i].shape)
    return fitted
