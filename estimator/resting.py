"""Residuals of a rest: whether they have grown far beyond all before in it, so that something has happened."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from .space import Vector

NEWEST: Final = 5
"""Number of newest residuals whose median size is compared."""
_FEWEST: Final = 30
"""Least number of residuals before them: fewer are no measure of what the model lacks."""
_FAR: Final = 3.0
"""Ratio to the largest one before that is no course of what the model lacks."""


@dataclass(frozen=True)
class RestingResiduals:
    """Sizes of residuals (c,) at the parameters in force since the rest began."""

    n_samples: int = 0
    """Number of residuals."""
    largest: Vector | float = 0.0
    """Largest size (c,) of all but the newest."""
    newest: tuple[Vector, ...] = ()
    """Newest sizes, each (c,)."""

    def take(self, residual: Vector) -> "RestingResiduals":
        """Return the sizes with one more residual (c,); NaN is none."""
        newest = (*self.newest, np.nan_to_num(np.abs(residual), nan=0.0))
        largest = self.largest if len(newest) <= NEWEST else np.maximum(self.largest, newest[0])
        return RestingResiduals(self.n_samples + 1, largest, newest[-NEWEST:])

    @property
    def growth(self) -> Vector:
        """Ratio (c,) of the newest sizes' median to the largest before, or to a standard deviation if that is more."""
        return np.median(self.newest, axis=0) / np.maximum(self.largest, 1.0)

    @property
    def is_outgrown(self) -> bool:
        """True where a channel's newest residuals are far larger than any before in the rest."""
        return self.n_samples >= _FEWEST + NEWEST and bool(np.any(self.growth > _FAR))
