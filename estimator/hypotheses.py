"""Hypotheses on samples that contradict the parameters in force: parameters have changed, or a disturbance acts.

They are compared by evidence that counts their free values: Willsky and Jones (1976), "A generalized likelihood ratio
approach to the detection and estimation of jumps in linear systems"; Schwarz (1978); Blanke et al. (2016), "Diagnosis
and Fault-Tolerant Control", chapter 6. Residuals are in standard deviations of their true size.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from math import inf, isfinite, log
from typing import Final

import numpy as np

from .differences import OfMany, forward_differences, value_and_slope
from .significance import FALSE_ALARM, chi2_limit
from .space import Vector

_BEYOND: Final = 0.5
"""Share of the scaled bounds by which the parameters that explain may lie outside of them."""
_LONGEST: Final = 0.5
"""Longest step of a parameter, as a share of the scaled bounds."""
_DAMPINGS: Final = np.append(0.0, 3.0 ** np.arange(-15.0, 3.0))
"""Dampings of the steps that are tried, by the largest singular value of the Jacobian."""
_FEW: Final = [0, 4, 8, 12, 16, 18]
"""Indices of those that are tried one after the other, where calls are dear."""
_ENOUGH: Final = 0.1
"""Gain of the sum of squares below which the search ends."""
_LITTLE: Final = 0.01
"""The same as a share of the sum."""
_SINGULAR: Final = 1e-7
"""Share of the largest singular value of the Jacobian below which nothing moves in a direction."""
_SPARE: Final = 12
"""Least number of values in excess of those fitted that can tell drifting parameters from whatever changes smoothly."""
USUAL_RATE: Final = 0.0025
"""Standard deviation of a drifting parameter's change from sample to sample, as a share of the scaled bounds."""
LARGEST_RATE: Final = 2.0 * USUAL_RATE
"""Largest change of a parameter from sample to sample, as a share of the scaled bounds: faster, it is none."""
_ORDER: Final = 2
"""Highest power of time in a disturbance that changes."""
MARGIN: Final = 10.0
"""Least difference of two scores: "very strong evidence", Kass and Raftery (1995), "Bayes factors"."""
_CLEARLY: Final = 4.0
"""Number of margins by which changed parameters must explain samples better than coloured noise to be written early."""


@dataclass(frozen=True)
class Fit:
    """Sum of squared residuals of a hypothesis with its values at their best."""

    squares: float
    """Sum of squared residuals."""
    n_free: int
    """Number of values that were fitted."""
    n_values: int
    """Number of residuals."""

    @property
    def score(self) -> float:
        """Twice the negative log evidence but for a constant: squares + n_free log n_values; the least is the best."""
        return self.squares + self.n_free * log(max(self.n_values, 2))

    @property
    def is_explained(self) -> bool:
        """True where the residuals pass a chi-square test that leaves some degrees of freedom."""
        left = self.n_values - self.n_free
        return left > 0 and self.squares <= chi2_limit(FALSE_ALARM, left)

    @property
    def is_possible(self) -> bool:
        """True where the residuals do not refute the hypothesis, be it that they are too few."""
        return self.n_values <= self.n_free or self.is_explained


NEVER: Final = Fit(inf, 0, 1)


def plain_fit(rows: Vector, n_free: int, n_values: int | None = None) -> Fit:
    """Return the fit of rows (n, c) that n_free values were fitted to; zeros are missing values."""
    by_channel = np.einsum("n...,n...->...", rows, rows)
    squares = float(by_channel.sum())
    n = int(np.count_nonzero(rows)) if n_values is None else n_values
    return Fit(squares, n_free, n) if isfinite(squares) else NEVER


def n_channels_of(rows: Vector) -> int:
    """Return the number of channels in rows (n, c): those with a value other than zero."""
    return int(np.count_nonzero(rows.any(axis=0)))


@dataclass(frozen=True)
class Disturbance:
    """Lumped disturbance that explains rows of residuals: constant, or changing smoothly."""

    newest: Vector
    """Its value (c,) at the newest sample, in standard deviations."""
    largest: Vector
    """Its largest size (c,) in the rows: a changing one may pass through zero."""
    fit: Fit
    is_constant: bool
    """True of a constant one, False of a line or a parabola in time."""


def disturbance_of(rows: Vector, *, may_drift: bool = True) -> Disturbance:
    """Return the disturbance that explains rows (n, c) best: on each channel a constant, a line or a parabola in time.

    It enters the residuals linearly, so that it is projected out of them. Zeros are missing values.
    """
    n, n_channels, n_values = len(rows), n_channels_of(rows), int(np.count_nonzero(rows))
    mean = mean_of(rows)
    left = rows - mean if n_values == n * n_channels else np.where(rows, rows - mean, 0.0)
    found = [Disturbance(mean, np.abs(mean), plain_fit(left, n_channels, n_values), True)]
    for order in range(1, min(_ORDER, (n - 1) // 2) + 1) if may_drift else ():
        if found[-1].fit.is_explained:
            break
        course, fit = _polynomial_fit(rows, order)
        found.append(Disturbance(course[-1], np.abs(course).max(axis=0), fit, False))
    return min(found, key=lambda d: d.fit.score)


def cubic_disturbance(rows: Vector) -> Fit:
    """Return the fit to rows (n, c) of a disturbance that goes as a cubic in time on each channel."""
    return _polynomial_fit(rows, 3)[1]


def _polynomial_fit(rows: Vector, order: int) -> tuple[Vector, Fit]:
    """Return the polynomial (n, c) in time that explains rows (n, c) best, channel by channel, and its fit."""
    n_channels, n_values = n_channels_of(rows), int(np.count_nonzero(rows))
    if n_values == len(rows) * n_channels:
        course = _polynomial(len(rows), order) @ rows
        left = rows - course
    else:
        course = _course(rows, order)
        left = np.where(rows, rows - course, 0.0)
    return course, plain_fit(left, (order + 1) * n_channels, n_values)


def mean_of(rows: Vector) -> Vector:
    """Return the mean (..., c) of rows (..., n, c); zeros are missing values."""
    if rows.all():
        return rows.mean(axis=-2)
    return rows.sum(axis=-2) / np.maximum(np.count_nonzero(rows, axis=-2), 1)


def _course(rows: Vector, order: int) -> Vector:
    """Return the least-squares polynomial (n, c) in time of rows (n, c), of those in each column that are not zero.

    NaN where a row is not finite.
    """
    if not np.all(np.isfinite(rows)):
        return np.full(rows.shape, np.nan)
    powers = np.linspace(-1.0, 1.0, len(rows))[:, None] ** np.arange(order + 1)
    seen = [np.flatnonzero(column) for column in rows.T]
    return np.column_stack(
        [powers @ np.linalg.lstsq(powers[k], column[k])[0] for k, column in zip(seen, rows.T, strict=True)]
    )


@cache
def _polynomial(n: int, order: int) -> Vector:
    """Return the matrix (n, n) that makes of n values those of their least-squares polynomial."""
    powers = np.linspace(-1.0, 1.0, n)[:, None] ** np.arange(order + 1)
    fitted: Vector = powers @ np.linalg.pinv(powers)
    fitted.flags.writeable = False
    return fitted


@dataclass(frozen=True)
class Weighing:
    """Comparison of the hypotheses on a window of samples."""

    parameters: Fit
    """Changed parameters, constant over the window or changing at a constant rate."""
    disturbance: Fit
    """A disturbance, constant or changing at a constant rate, with the parameters in force."""
    nothing: Fit
    """The parameters in force, without a disturbance."""
    inputs: Fit = NEVER
    """The parameters in force, with inputs that are stuck."""
    noise: Fit = NEVER
    """The parameters in force, with a noise that is larger than known."""
    coloured: Fit = NEVER
    """The parameters in force, with a noise that is correlated from sample to sample; compared while it is unknown."""

    @property
    def are_parameters_possible(self) -> bool:
        """True where changed parameters explain the samples, and nothing else does much better."""
        return self.parameters.is_possible and self._lead > -MARGIN

    @property
    def are_parameters_proven(self) -> bool:
        """True where changed parameters explain the samples, and nothing else does nearly as well."""
        return self.parameters.is_explained and self._lead >= MARGIN

    @property
    def are_parameters_certain(self) -> bool:
        """True where they are proven by twice the margin.

        So many windows are compared that noise which is correlated from sample to sample, or larger than known, looks
        like changed parameters in one of them.
        """
        lead = min(self._lead, self.noise.score - self.parameters.score)
        return self.parameters.is_explained and lead >= 2.0 * MARGIN

    @property
    def may_be_coloured(self) -> bool:
        """True where a noise that is correlated from sample to sample explains them nearly as well as parameters do."""
        return self.coloured.score - self.parameters.score < _CLEARLY * MARGIN

    @property
    def fits(self) -> dict[str, Fit]:
        """Fits of the hypotheses that were compared; a larger noise is one only where parameters are to be certain."""
        not_compared = {"noise"} | {name for name in ("inputs", "coloured") if getattr(self, name) is NEVER}
        return {name: fit for name, fit in vars(self).items() if name not in not_compared}

    @property
    def _lead(self) -> float:
        others = self.nothing.score, self.disturbance.score, self.inputs.score, self.coloured.score
        return min(others) - self.parameters.score


@dataclass(frozen=True)
class ChangedParameters:
    """Parameters that explain rows of residuals best."""

    z: Vector
    """Place (d,) in the scaled bounds, or beyond: 0 and 1 are the bounds."""
    rows: Vector
    """Residuals (n, c) there, or of parameters that change at a constant rate through it."""
    fit: Fit
    """Fit of these parameters, or of parameters that change at a constant rate through them."""
    rate: float = 0.0
    """Largest change of one of them in a sample interval, as a share of the scaled bounds; 0 for constant ones."""


def changed_parameters(
    rows_at: Callable[[Vector], Vector],
    z: Vector,
    times: Vector | None = None,
    *,
    iterations: int = 30,
    step: float = 1e-6,
    may_drift: bool = True,
    beyond: float = _BEYOND,
) -> ChangedParameters:
    """Return the parameters that explain residuals rows_at(z) (n, c) best, by damped Gauss-Newton steps from z (d,).

    Each step is the best of many dampings (Levenberg 1944); parameters at the end of their range stay there.
    Columns of zeros count as missing. step: of differences. may_drift: parameters that change in time are a straight
    line through the best constant ones, to first order; rows are in the order of time then. times (n,): of the rows,
    in sample intervals; None where each row is an interval after the one before. beyond: share of the scaled bounds by
    which they may lie outside of them.
    """
    if is_cheap := isinstance(rows_at, OfMany):
        rows, jacobian = value_and_slope(rows_at, z, step)
    else:
        rows = rows_at(z)
        jacobian = np.zeros((rows.size, len(z)))
    now = float((rows**2).sum())
    for i in range(0 if plain_fit(rows, len(z)).is_explained else iterations):
        if i or not is_cheap:
            jacobian = forward_differences(rows_at, z, rows, step)
        if not np.isfinite(jacobian).all():
            break
        before, better = now, _better(rows_at, _damped_steps(jacobian, rows.reshape(-1), z, beyond), now)
        if better is None:
            break
        z, rows = better
        now = float((rows**2).sum())
        if before - now < max(_ENOUGH, _LITTLE * before):
            break
    n, d = len(rows), len(z)
    constant = plain_fit(rows, d)
    can_tell = n >= 3 and constant.n_values - 2 * d >= _SPARE
    if not (may_drift and can_tell) or constant.is_explained or not np.all(np.isfinite(jacobian)):
        return ChangedParameters(z, rows, constant)
    times = np.arange(float(n)) if times is None else times
    duration = times[-1] - times[0]
    tau = np.repeat(2.0 * (times - times[0]) / duration - 1.0, rows.shape[1])[:, None]
    both = np.hstack([jacobian, tau * jacobian])
    # Where the rows tell nothing of it a parameter does not change: a prior on the rates, one row each.
    prior = np.hstack([np.zeros((d, d)), np.eye(d) / (USUAL_RATE * duration / 2.0)])
    moves = np.linalg.lstsq(np.vstack([both, prior]), np.append(rows.reshape(-1), np.zeros(d)), rcond=1e-7)[0]
    left = rows.reshape(-1) - both @ moves
    line = Fit(float(left @ left), 2 * d, constant.n_values)
    if line.score >= constant.score:
        return ChangedParameters(z, rows, constant)
    return ChangedParameters(z, left.reshape(rows.shape), line, float(np.abs(moves[d:]).max()) * 2.0 / duration)


def _damped_steps(jacobian: Vector, r: Vector, z: Vector, beyond: float) -> Vector:
    """Return the places (k, d) that damped Gauss-Newton steps from z (d,) lead to."""
    slope = jacobian.T @ r
    is_stuck = ((z <= -beyond) & (slope > 0.0)) | ((z >= 1.0 + beyond) & (slope < 0.0))
    u, s, vt = np.linalg.svd(np.where(is_stuck, 0.0, jacobian), full_matrices=False)
    squares = s**2 + (_DAMPINGS[:, None] * s[0]) ** 2
    gains = np.divide(s, squares, out=np.zeros(squares.shape), where=(s > _SINGULAR * s[0]) & (squares > 0.0))
    moves = -(gains * (u.T @ r)) @ vt
    longest = np.maximum(np.abs(moves).max(axis=1, keepdims=True), 1e-300)
    return np.minimum(np.maximum(z + moves * np.minimum(1.0, _LONGEST / longest), -beyond), 1.0 + beyond)


def _better(rows_at: Callable[[Vector], Vector], places: Vector, squares: float) -> tuple[Vector, Vector] | None:
    """Return the place of the least sum of squares and its rows, where that is below `squares`; else None.

    Where each call is a roll-out, a few places are tried one by one, and the first below it is taken.
    """
    if not isinstance(rows_at, OfMany):
        found = ((place, rows_at(place)) for place in places[_FEW])
        return next((pair for pair in found if np.sum(pair[1] ** 2) < squares), None)  # False where it is no number
    rows = rows_at(places)
    with np.errstate(over="ignore", invalid="ignore"):
        reached = (rows**2).sum(axis=(1, 2))
    best = int(np.where(np.isnan(reached), inf, reached).argmin())
    return (places[best], rows[best]) if reached[best] < squares else None
