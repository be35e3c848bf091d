"""Gain of a derivative's sensor: whether the motion is another share of the integrated derivative, block after block.

So a wrong unit or calibration is seen of which no single block of samples shows enough.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Vector

_GROUPS: Final = 5
"""Number of newest groups of blocks, all of which must show a wrong gain in the same direction."""
_SIZES: Final = (1, 2, 4, 8)
"""Numbers of blocks in a group: where the state is noisy many are needed."""
_LEAST: Final = 0.1
"""Error of the gain below which it is of no account."""
_CLEAR: Final = 20.0
"""Least square of what is integrated, by that of its noise, which alone makes the gain appear too small."""


@dataclass(frozen=True)
class DerivativeGain:
    """Sums of the newest blocks of samples, channel by channel."""

    limit: float
    """Size of the error, in standard deviations, that is one."""
    blocks: tuple[Vector, ...] = ()
    """Motion, integrated derivative, standard deviations of their difference and of what is integrated, each (4, c)."""

    def take(self, moved: Vector, integrated: Vector, std: Vector, own: Vector) -> "DerivativeGain":
        """Return the sums with one more block.

        moved, integrated: motion and integrated derivative (c,); std, own: standard deviations of their difference and
        of the noise in what is integrated (c,).
        """
        block = np.array([moved, integrated, std, own])
        return DerivativeGain(self.limit, (*self.blocks, block)[-_GROUPS * _SIZES[-1] :])

    @cached_property
    def n_wrong(self) -> NDArray[np.intp] | int:
        """Number of newest blocks (c,) over which the gain is not 1; 0 where it is."""
        n_wrong: NDArray[np.intp] | int = 0
        for size in reversed(_SIZES):
            if len(self.blocks) >= _GROUPS * size:
                n_wrong = np.where(_are_wrong(self.limit, self.blocks[-_GROUPS * size :]), _GROUPS * size, n_wrong)
        return n_wrong


def _are_wrong(limit: float, blocks: tuple[Vector, ...]) -> NDArray[np.bool_]:
    """Return for which channels (c,) the gain is not 1, by a regression of the motion on the integrated derivative.

    A constant offset is no gain: a model whose derivative changes too fast within a step leaves one. What the
    regression does not explain is noise, too: of a coarse sensor, which declares none.
    """
    moved, integrated, std, own = np.stack(blocks, axis=1)
    missed = moved - integrated
    aside = integrated - integrated.mean(axis=0)
    size, power = np.sum(missed * aside, axis=0), np.sum(aside**2, axis=0)
    left = missed - missed.mean(axis=0) - aside * (size / np.where(power > 0.0, power, 1.0))
    scatter = np.sqrt(np.sum(left**2, axis=0) / (len(blocks) - 2))
    is_large = np.abs(size) > limit * np.linalg.norm(np.maximum(std, scatter) * aside, axis=0)
    is_of_account = (np.abs(size) > _LEAST * power) & (power > _CLEAR * np.sum(own**2, axis=0))
    by_group = (missed * integrated).reshape(_GROUPS, -1, missed.shape[1]).sum(axis=1)
    is_one_sided = np.abs(np.sign(by_group).sum(axis=0)) == _GROUPS
    return is_large & is_of_account & is_one_sided
