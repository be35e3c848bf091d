"""Candidates of a target-vector search with their residuals, and the places at which the model had no value."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used
from numpy.typing import NDArray

from ..contract import NoEstimateError
from ..space import ParameterSpace, Vector
from .search import best_that_differ

_FAR: Final = 50.0
"""Root mean square residual [standard deviations] above which old candidates, which lie where the optimum was, say
little of the slopes: they are found again."""
_BEYOND: Final = 1e4
"""Size of a residual, as a multiple of the best one's, from which on the surrogate's jitter, a share of 1e-8 of the
variance, hides what it knows of the good ones."""
_MOST: Final = 128
"""Largest number of stored candidates, evaluated again at each sample, however long an episode lasts."""


class Candidates:
    """Candidates in the order in which they were told, and the failed ones. Places (d,) are in the unit cube."""

    def __init__(self, space: ParameterSpace, n_modelled: int) -> None:
        """n_modelled: number of best candidates that the surrogate is fitted to, beside the newest d."""
        self._space, self._n_modelled = space, n_modelled
        self.theta: Vector = np.empty((0, len(space)))
        """Candidates (n, d), in the parameters' units."""
        self._residuals: Vector | None = None
        self._failed: Vector = np.empty((0, len(space)))

    def __len__(self) -> int:
        return len(self.theta)

    @property
    def residuals(self) -> Vector:
        """Residuals (n, D) of the candidates. Raises NoEstimateError where there is none."""
        if self._residuals is None:
            raise NoEstimateError("no candidate has succeeded yet: tell the residual of one first.")
        return self._residuals

    @property
    def is_empty(self) -> bool:
        """True where no candidate has a residual."""
        return self._residuals is None

    @property
    def costs(self) -> Vector:
        """Sums of squared residuals (n,)."""
        return np.sum(self.residuals**2, axis=1)

    @property
    def best(self) -> int:
        """Index of the candidate of least cost."""
        return int(np.argmin(self.costs))

    @property
    def are_near(self) -> bool:
        """True where the best candidate is so good that the others say something of the slopes there."""
        return not self.is_empty and is_near(self.residuals[self.best])

    @property
    def modelled(self) -> NDArray[np.intp]:
        """Sorted indices of the best candidates that differ, and of the newest, bad ones included.

        Without those at which the model has diverged, where the others are enough for the slopes.
        """
        chosen = self._chosen(self.residuals)
        near = chosen[~self._are_beyond[chosen]]
        return near if len(near) > len(self._space) else chosen

    def place(self, index: int | NDArray[np.intp]) -> Vector:
        """Return the places (..., d) of candidates."""
        return self._space.to_unit(self.theta[index])

    def begin_episode(self) -> None:
        """Keep the first candidates, the best that differ, and the newest; forget the failed ones."""
        self._failed = self._failed[:0]
        self._shrink()

    def clear(self) -> None:
        """Forget all candidates, but the failed ones."""
        self.theta, self._residuals = self.theta[:0], None

    def add(self, theta: Vector, residual: Vector) -> None:
        """Add a candidate theta (d,) with its residual (D,); the worst go where there are too many."""
        row = np.atleast_2d(np.asarray(residual, dtype=float))
        self.theta = np.vstack([self.theta, theta])
        self._residuals = row if self._residuals is None else np.vstack([self._residuals, row])
        self._limit()

    def fail(self, theta: Vector) -> None:
        """Take a candidate theta (d,) at which the model had no value."""
        self._failed = np.vstack([self._failed, self._space.to_unit(theta)])

    def rescore(self, residuals: Vector) -> None:
        """Replace the residuals by residuals (n, D); candidates without finite ones are dropped."""
        finite = has_cost(residuals)
        self.theta = self.theta[finite]
        self._residuals = residuals[finite] if len(self.theta) else None
        self._limit()

    def nearest(self, z: Vector, allowed: float) -> tuple[Vector, float]:
        """Return the place nearest to z (d,) of those that cost no more than allowed, or the best, and its cost."""
        costs = self.costs
        fitting = np.flatnonzero(costs <= max(allowed, float(costs.min())))
        places = self.place(fitting)
        nearest = int(np.argmin(np.sum((places - z) ** 2, axis=1)))
        return places[nearest], float(costs[fitting[nearest]])

    def has_failed_near(self, z: Vector, distance: float) -> bool:
        """Return whether a candidate has failed within a distance of z (d,), in every parameter."""
        return len(self._failed) > 0 and bool(np.abs(self._failed - z).max(axis=1).min() < distance)

    def is_new(self, z: Vector, distance: float) -> bool:
        """Return whether no candidate, failed or not, is within a distance of z (d,), in every parameter."""
        known = np.vstack([self._space.to_unit(self.theta), self._failed])
        return bool(np.abs(known - z).max(axis=1).min() >= distance)

    def hopeful(self, pool: Vector, places: Vector | Sequence[Vector]) -> Vector:
        """Return those of a pool (m, d) that are nearer to one of the places than to a failed one; all, if none is.

        A candidate at which the model has diverged counts as failed.
        """
        failed = self._failed
        if (are_beyond := self._are_beyond).any():
            failed = np.vstack([failed, self.place(np.flatnonzero(are_beyond))])
        if not len(failed):
            return pool
        distance = scipy.spatial.distance.cdist
        hopeful = pool[distance(pool, places).min(axis=1) <= distance(pool, failed).min(axis=1)]
        return hopeful if len(hopeful) else pool

    @property
    def _are_beyond(self) -> NDArray[np.bool_]:
        """True (n,) for each candidate whose residual is of no use beside the best one's: the model has diverged."""
        if self.is_empty:
            return np.zeros(0, dtype=bool)
        costs = self.costs
        return costs > _BEYOND**2 * max(float(costs.min()), self.residuals.shape[1])

    def _chosen(self, residuals: Vector) -> NDArray[np.intp]:
        newest = np.arange(len(residuals))[-len(self._space) :]
        return np.union1d(np.array(best_that_differ(residuals, self._n_modelled), dtype=np.intp), newest)

    def _limit(self) -> None:
        if len(self) > _MOST:
            self._shrink()

    def _shrink(self) -> None:
        if self._residuals is not None:
            first = min(len(self._space) + 1, len(self))
            kept = np.concatenate([np.arange(first), first + self._chosen(self._residuals[first:])])
            self.theta, self._residuals = self.theta[kept], self._residuals[kept]


def has_cost(residuals: Vector) -> Any:
    """Return whether residuals (..., D) are finite, and the sums of their squares are."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.isfinite(np.sum(residuals**2, axis=-1))


def is_near(residual: Vector) -> bool:
    """Return whether a residual (D,) is so small that others say something of the slopes there."""
    return float(residual @ residual) <= _FAR**2 * len(residual)
