"""Statistical linearisation of residuals over points about a mean, and the Kalman update with it.

Over the points r = value + slope xi + e, with xi their places in standard deviations of the distribution that they
stand for: of sigma points this is the unscented transformation, of an ensemble its regression. Where the update is
repeated on the same samples, each time linearised about the last result, it is the posterior linearisation filter:
García-Fernández, Svensson, Morelande, Särkkä (2015), IEEE Trans. Signal Processing 63(20).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np

from ..objective import Objective
from ..significance import is_explained
from ..space import ParameterSpace, Vector

_BETA: Final = 2.0
"""Weight of the centre in the covariance: that of a normal distribution (van der Merwe, 2004)."""
_LITTLE: Final = 0.1
"""Step, in standard deviations after it, at which the iteration ends."""
_MOST: Final = 20
"""Largest number of iterations."""


@dataclass(frozen=True)
class Normal:
    """Normal distribution of the parameters in the unit cube."""

    mean: Vector
    """Mean (d,)."""
    root: Vector
    """Root (d, d) of the covariance, which is root root^T."""

    @property
    def covariance(self) -> Vector:
        """Covariance (d, d)."""
        return self.root @ self.root.T

    def places(self, xi: Vector) -> Vector:
        """Return the places (k, d) of points xi (k, d), those outside the unit cube moved to its faces."""
        return np.clip(self.mean + xi @ self.root.T, 0.0, 1.0)

    def standardised(self, z: Vector) -> Vector:
        """Return the points xi (..., d) of places z (..., d)."""
        return solved(self.root, (z - self.mean).T).T

    def walked(self, walk: float) -> "Normal":
        """Return the distribution one sample later, of parameters that walk by this standard deviation."""
        return Normal(self.mean, root_of(self.covariance + walk**2 * np.eye(len(self.mean))))


def root_of(P: Vector) -> Vector:
    """Return the lower Cholesky factor of a covariance (d, d)."""
    return np.asarray(np.linalg.cholesky(P), dtype=np.float64)


def identifiable_from(identifiable_below: float, spread: float) -> float:
    """Return the deviation of an identifiable parameter: less than half the start's, or the data have added nothing."""
    return min(identifiable_below, 0.5 * spread)


def solved(A: Vector, b: Vector) -> Vector:
    """Return x of A x = b."""
    return np.asarray(np.linalg.solve(A, b), dtype=np.float64)


class Linearised(NamedTuple):
    """Residuals as a linear function of xi, and what is left of them."""

    value: Vector
    """Mean (D,)."""
    slope: Vector
    """Slope (D, d)."""
    error: Vector
    """Covariance (D, D) of what is not linear."""


class Points(Protocol):
    """Points that stand for a distribution, the first of them its mean."""

    @property
    def xi(self) -> Vector:
        """Points (k, d) in standard deviations."""
        ...

    def linearised(self, xi: Vector, residuals: Vector) -> Linearised:
        """Return the linearisation of residuals (k, D) at points xi (k, d), which may have been moved."""
        ...


@dataclass(frozen=True)
class SigmaPoints:
    """The mean, and two points to both sides of it along each direction: Julier and Uhlmann (2004)."""

    d: int
    """Number of parameters."""
    alpha: float = 1.0
    """Spread round the mean; kappa is 3 - d."""

    @property
    def xi(self) -> Vector:
        """Points (2 d + 1, d) in standard deviations."""
        far = np.sqrt(3.0) * self.alpha * np.eye(self.d)
        return np.vstack([np.zeros(self.d), far, -far])

    def linearised(self, xi: Vector, residuals: Vector) -> Linearised:
        """Return the linearisation: mean and covariances are those of the scaled unscented transformation."""
        centre, others = residuals[0], residuals[1:] - residuals[0]
        slope = np.asarray(np.linalg.lstsq(xi[1:], others)[0], dtype=np.float64)
        e = (others - xi[1:] @ slope) / np.sqrt(6.0 * self.alpha**2)
        shift = np.sum(e, axis=0) / np.sqrt(6.0 * self.alpha**2)
        error = e.T @ e + (_BETA - self.alpha**2) * np.outer(shift, shift)
        return Linearised(centre + shift, slope.T, error)


@dataclass(frozen=True)
class EnsemblePoints:
    """The mean, and an ensemble about it."""

    members: Vector
    """Members (n, d) in standard deviations, of mean zero and covariance one."""

    @property
    def xi(self) -> Vector:
        """Points (n + 1, d) in standard deviations."""
        return np.vstack([np.zeros(self.members.shape[1]), self.members])

    def linearised(self, xi: Vector, residuals: Vector) -> Linearised:
        """Return the linearisation by the members' regression."""
        design = np.column_stack([np.ones(len(xi) - 1), xi[1:]])
        found = np.asarray(np.linalg.lstsq(design, residuals[1:])[0], dtype=np.float64)
        e = (residuals[1:] - design @ found) / np.sqrt(len(design))
        return Linearised(found[0], found[1:].T, e.T @ e)


def ensemble(n: int, d: int, rng: np.random.Generator) -> Vector:
    """Return members (n, d) whose mean is zero and whose covariance is one, exactly: Pham (2001)."""
    drawn = rng.standard_normal((n, d))
    drawn -= drawn.mean(axis=0)
    return solved(root_of(drawn.T @ drawn / n), drawn.T).T


def posterior(prior: Normal, at: Normal, seen: Linearised) -> Normal:
    """Return the distribution after residuals that should be zero with unit variance, linearised over `at`."""
    noise = root_of(np.eye(len(seen.value)) + seen.error)
    value = solved(noise, seen.value + seen.slope @ at.standardised(prior.mean))
    slope = solved(noise, seen.slope @ solved(at.root, prior.root))
    factor = root_of(np.eye(len(prior.mean)) + slope.T @ slope)
    shift = solved(factor.T, solved(factor, slope.T @ value))
    return Normal(prior.mean - prior.root @ shift, solved(factor, prior.root.T).T)


class Reached(NamedTuple):
    """Distribution after the samples of an episode."""

    parameters: Normal
    cost: float
    """Sum of squared residuals at its mean; inf where no point has a value."""


class _Trial(NamedTuple):
    """Mean that was evaluated."""

    at: Normal
    residual: Vector
    cost: float
    """Sum of squares of residuals and of the distance from the prior's mean."""


def iterated(prior: Normal, first: Normal, points: Points, objective: Objective, space: ParameterSpace) -> Reached:
    """Return what the samples of an episode make of a prior, within the objective's evaluations.

    first: the distribution over which residuals are linearised first. A step after which the mean is worse is halved.
    All points of an iteration are evaluated at the same time.
    """

    def evaluated(z: Vector) -> list[Vector]:
        return list(objective.residuals([space.from_unit(one) for one in z]))

    at, best, reached = first, None, prior
    for n in range(_MOST):
        if n and objective.n_evaluations + len(points.xi) >= objective.max_evaluations:
            break
        found = _finite(at, points, evaluated(at.places(points.xi)))
        if found is None:
            break
        xi, residuals, trial = found[0], found[1], _trial(prior, found[2], found[1][0])
        if best is None or trial.cost < best.cost:
            best = trial
            reached = _inside(posterior(prior, trial.at, points.linearised(xi, residuals)))
            at = reached
        else:
            at = Normal(0.5 * (at.mean + best.at.mean), at.root)
        if np.linalg.norm(reached.standardised(best.at.mean)) < _LITTLE:
            break
    if best is None:
        return Reached(prior, np.inf)
    (last,) = evaluated(at.mean[None])
    if len(last) == len(best.residual) and np.all(np.isfinite(last)):
        best = min(best, _trial(prior, at, last), key=lambda one: one.cost)
    return widened(Normal(best.at.mean, reached.root), prior, best.residual)


def _finite(at: Normal, points: Points, residuals: Sequence[Vector]) -> tuple[Vector, Vector, Normal] | None:
    """Return points xi (k, d) that did not fail, their residuals (k, D), and the distribution about the first.

    Where the mean itself failed, the best point takes its place. None where too few are left.
    """
    known = [i for i, r in enumerate(residuals) if np.all(np.isfinite(r))]
    if len(known) < len(at.mean) + 2:
        return None
    places, rows = at.places(points.xi), np.array([residuals[i] for i in known])
    if known[0] != 0:
        least = int(np.argmin(np.sum(rows**2, axis=1)))
        known, rows = [known[least], *known], np.vstack([rows[least], rows])
        at = Normal(places[known[0]], at.root)
    return at.standardised(places[known]), rows, at


def _trial(prior: Normal, at: Normal, residual: Vector) -> _Trial:
    away = prior.standardised(at.mean)
    return _Trial(at, residual, float(residual @ residual + away @ away))


def _inside(found: Normal) -> Normal:
    return Normal(np.clip(found.mean, 0.0, 1.0), found.root)


def widened(found: Normal, prior: Normal, residual: Vector) -> Reached:
    """Return the distribution, wider by the misfit where residuals (D,) are more than noise, but not than before."""
    cost, spare = float(residual @ residual), max(len(residual) - len(found.mean), 1)
    if is_explained(residual):
        return Reached(found, cost)
    wide = Normal(found.mean, found.root * np.sqrt(cost / spare))
    eye = np.eye(len(found.mean))
    information = solved(wide.covariance, eye) + solved(prior.covariance, eye)
    return Reached(Normal(found.mean, root_of(solved(information, eye))), cost)


Residuals = Callable[[Vector], Vector]
"""Residuals (k, c) of places (k, d) at one sample."""


def updated(prior: Normal, points: Points, residuals: Residuals) -> tuple[Normal, float]:
    """Return the distribution after one sample, and the sum of squares of its mean residual before.

    A sample at which a point has no value is left out. A point outside the bounds is moved to the nearest one.
    """
    xi = points.xi
    places = prior.mean + xi @ prior.root.T
    inside = np.clip(places, 0.0, 1.0)
    if not np.array_equal(inside, places):  # else the kink at a bound would be taken for curvature, by 1/alpha**2
        xi = prior.standardised(inside)
    with np.errstate(all="ignore"):  # where the model overflows
        rows = residuals(inside)
        if not np.all(np.isfinite(rows)):
            return prior, np.inf
        seen = points.linearised(xi, rows)
        after = posterior(prior, prior, seen)
    return (_inside(after) if np.all(np.isfinite(after.mean)) else prior), float(seen.value @ seen.value)
