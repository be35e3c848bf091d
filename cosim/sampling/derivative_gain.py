"""Gain of a derivative's sensor: whether the motion is another share of the integrated derivative, block after block.

So a wrong unit or calibration is seen of which no single block of samples shows enough.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Vector

_BLOCKS: Final = 5
"""Number of newest blocks, all of which must show a wrong gain in the same direction."""
_LEAST: Final = 0.1
"""Error of the gain below which it is of no account."""


@dataclass(frozen=True)
class DerivativeGain:
    """Sums of the newest blocks of samples, channel by channel."""

    limit: float
    """Size of the error, in standard deviations, that is one."""
    blocks: tuple[Vector, ...] = ()
    """Motion, integrated derivative and standard deviation of their difference, each (3, c)."""

    def take(self, moved: Vector, integrated: Vector, std: Vector) -> "DerivativeGain":
        """Return the sums with one more block: motion, integrated derivative, and std of their difference (c,)."""
        return DerivativeGain(self.limit, (*self.blocks, np.array([moved, integrated, std]))[-_BLOCKS:])

    @cached_property
    def is_wrong(self) -> NDArray[np.bool_] | bool:
        """For which channels (c,) the gain is not 1, by a regression of the motion on the integrated derivative.

        A constant offset is no gain: a model whose derivative changes too fast within a step leaves one.
        """
        if len(self.blocks) < _BLOCKS:
            return False
        moved, integrated, std = np.stack(self.blocks, axis=1)
        missed = moved - integrated
        aside = integrated - integrated.mean(axis=0)
        size = np.abs(np.sum(missed * aside, axis=0))
        is_large = size > self.limit * np.linalg.norm(std * aside, axis=0)
        is_of_account = size > _LEAST * np.sum(aside**2, axis=0)
        is_one_sided = np.abs(np.sign(missed * integrated).sum(axis=0)) == _BLOCKS
        return is_large & is_of_account & is_one_sided
