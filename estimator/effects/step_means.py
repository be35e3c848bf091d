"""Means over several steps, which a filter's samples have in place of one step's values."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..space import Vector

_ROUNDING: Final = 1e-6
"""Share of the delay by which times may be rounded."""


@dataclass(frozen=True)
class StepMeans:
    """Weighted means over steps, as of inputs that are held over each; of the newest step alone by default."""

    weights: tuple[float, ...] = (1.0,)
    """Weights (m,) of the newest steps, the newest first; they sum to one."""
    delay: float = 0.0
    """Time from a sample to the end of its newest step [s]."""
    every: int = 1
    """Number of steps from one sample to the next."""

    def __bool__(self) -> bool:
        """True where samples are means over several steps."""
        return len(self.weights) > 1

    @property
    def n_before(self) -> int:
        """Number of steps before its newest at whose ends a value matters to a sample."""
        return len(self.weights) if self else 0

    @property
    def n_mixed(self) -> int:
        """Number of samples that may be means over the same jump; 0 where they are no means."""
        return -(-len(self.weights) // self.every) if self else 0

    @property
    def lead(self) -> float:
        """Least time from a sample to the end of its newest step, but for rounding [s]."""
        return self.delay * (1.0 + _ROUNDING)

    def of(self, values: Vector, places: NDArray[np.intp]) -> Vector:
        """Return the means (..., n, p) of values (..., N, p) by step; places (n,): of the samples' newest steps."""
        if not self:
            return values[..., places, :]
        return np.array(self.weights) @ values[..., places[:, None] - np.arange(len(self.weights)), :]
