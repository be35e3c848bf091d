"""Residuals of a rest: whether they have grown far beyond what they long were, or have long been no more than noise."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ..space import Vector

_NEWEST: Final = 5
"""Number of newest residuals whose median size is compared."""
_FEWEST: Final = 30
"""Least number of residuals before them: fewer are no measure of what the model lacks."""
_LONGER: Final = 1.25
"""Ratio of the numbers of residuals at which their largest one is taken over."""
_FAR: Final = 3.0
"""Ratio to the largest one before that is no course of what the model lacks."""
_CALM: Final = 2.0
"""Median size of the newest residuals, in standard deviations, that may be noise: of that it is 0.7."""


@dataclass(frozen=True)
class RestingResiduals:
    """Sizes of residuals (c,) at the parameters in force since the rest began.

    The newest are compared with the first two thirds or so: what has happened may have grown slowly.
    """

    n_samples: int = 0
    """Number of residuals."""
    n_usual: int = _FEWEST
    """Number of the first ones, which the newest are compared with."""
    n_later: int = int(_LONGER * _FEWEST)
    """Number of the first ones at some later time."""
    usual: Vector | float = 0.0
    """Largest size (c,) of the first ones."""
    later: Vector | float = 0.0
    """Largest size (c,) of those that will be among them next."""
    since: Vector | float = 0.0
    """Largest size (c,) after these."""
    newest: tuple[Vector, ...] = ()
    """Newest sizes, each (c,)."""
    n_calm: int = 0
    """Number of newest residuals that may be noise."""

    def take(self, residual: Vector, noise: Vector | float = 1.0) -> "RestingResiduals":
        """Return the sizes with one more residual (c,); noise (c,): its known standard deviation.

        NaN, where nothing was measured, is as large as the one before.
        """
        size = np.abs(residual)
        size = np.where(np.isnan(size), self.newest[-1] if self.newest else 0.0, size)
        n, newest = self.n_samples + 1, (*self.newest, size)[-_NEWEST:]
        is_calm = bool(np.all(np.median(newest, axis=0) < _CALM * np.asarray(noise)))
        known = replace(self, n_samples=n, newest=newest, n_calm=self.n_calm + 1 if is_calm else 0)
        if n <= self.n_usual:
            return replace(known, usual=np.maximum(self.usual, size))
        if n <= self.n_later:
            return replace(known, later=np.maximum(self.later, size))
        since = np.maximum(self.since, size)
        n_next = int(_LONGER * self.n_later)
        if n < n_next:
            return replace(known, since=since)
        usual = np.maximum(self.usual, self.later)
        return replace(known, n_usual=self.n_later, n_later=n_next, usual=usual, later=since, since=0.0)

    @property
    def growth(self) -> Vector:
        """Ratio (c,) of the newest sizes' median to the largest usual one, or to a standard deviation."""
        return np.median(self.newest, axis=0) / np.maximum(self.usual, 1.0)

    @property
    def is_outgrown(self) -> bool:
        """True where a channel's newest residuals are far larger than the usual ones."""
        return self.n_samples >= _FEWEST + _NEWEST and bool(np.any(self.growth > _FAR))

    def is_calm(self, n_restless: int) -> bool:
        """Return whether residuals have been no more than noise for as long as they were more, n_restless samples."""
        return self.n_calm >= max(_FEWEST, n_restless)
