"""Gain and delay of a derivative's sensor, by a regression of the motion on the integrated derivative.

Block after block: so a wrong unit, calibration or delay is seen of which no single block of samples shows enough.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator import Vector

_GROUPS: Final = 5
"""Number of newest groups of blocks, all of which must show the same error in the same direction."""
_SIZES: Final = (1, 2, 4, 8)
"""Numbers of blocks in a group: where the state is noisy many are needed."""
_LEAST: Final = 0.1
"""Error of the gain below which it is of no account."""
_LATE: Final = 1.5
"""Delay, in samples, up to which it is of no account: a solver of one step between samples errs by as much."""
_OF_ACCOUNT: Final = np.array([_LEAST, _LATE])
"""Errors of gain and delay that are of account."""
_RANK: Final = 1e-6
"""Share of the larger below which gain and delay are not told apart."""
_CLEAR: Final = 20.0
"""Least square of what is integrated, by that of its noise, which alone makes the gain appear too small."""


@dataclass(frozen=True)
class DerivativeGain:
    """Sums of the newest blocks of samples, channel by channel."""

    limit: float
    """Size of the error, in standard deviations, that is one."""
    blocks: tuple[Vector, ...] = ()
    """The values (6, c) of each block, as `take` has them."""

    def take(
        self, moved: Vector, integrated: Vector, change: Vector, drift: Vector, std: Vector, own: Vector
    ) -> "DerivativeGain":
        """Return the sums with one more block.

        moved, integrated: motion and integrated derivative (c,); change, drift: of the derivative from the beginning to
        the end, and what of it the modelled states make, times the time from one sample to the next (c,); std, own:
        standard deviations of the difference of the first two and of the noise in what is integrated (c,).
        """
        block = np.array([moved, integrated, change, drift, std, own])
        return DerivativeGain(self.limit, (*self.blocks, block)[-_GROUPS * _SIZES[-1] :])

    @cached_property
    def n_wrong(self) -> NDArray[np.intp] | int:
        """Number of newest blocks (c,) over which the gain is not 1 or the delay not 0; 0 where they are."""
        n_wrong: NDArray[np.intp] | int = 0
        for n, errors in self._errors.items():
            n_wrong = np.where(errors.any(axis=0), n, n_wrong)
        return n_wrong

    @property
    def is_state_late(self) -> NDArray[np.bool_] | bool:
        """For which channels (c,) it is the state that is late, so that its derivative is early."""
        is_late: NDArray[np.bool_] | bool = False
        for errors in self._errors.values():
            is_late |= errors[1] < 0.0
        return is_late

    @cached_property
    def _errors(self) -> dict[int, Vector]:
        """Errors of gain and delay (2, c), 0 where there is none, by the number of newest blocks, the largest first."""
        numbers = [_GROUPS * size for size in reversed(_SIZES)]
        if len(self.blocks) < numbers[-1]:
            return {}
        blocks = np.stack(self.blocks, axis=1)
        return {n: _errors_of(self.limit, blocks[:, -n:]) for n in numbers if len(self.blocks) >= n}


def _errors_of(limit: float, blocks: Vector) -> Vector:
    """Return the errors of the gain and of the delay [samples] (2, c), 0 where there is none, by a regression.

    Of the motion on what is integrated, on the change of the derivative, by which a delay of one sample is off, and on
    a constant offset, which is neither: a model whose derivative changes too fast within a step leaves one. What the
    regression does not explain is noise, too: of a coarse sensor, which declares none. An actuator that lags does not
    hold the input over a step, so that an error must show whether its effect is taken at the step's end or beginning.
    blocks (6, n, c): values of each, as `DerivativeGain.take` has them.
    """
    moved, integrated, change, drift, std, own = blocks
    at_end, at_beginning = moved - integrated, moved - integrated + change - drift
    by_block = np.stack([integrated, change], axis=-1)  # (n, c, 2)
    is_shown = _are_one_sided(at_end, by_block) & _are_one_sided(at_beginning, by_block)
    is_shown[0] &= np.sum((integrated - integrated.mean(axis=0)) ** 2, axis=0) > _CLEAR * np.sum(own**2, axis=0)
    found, channels = np.zeros(is_shown.shape), is_shown.any(axis=0)
    if channels.any():
        both = np.stack([at_end, at_beginning])[:, :, channels]
        errors, others = _regressions(limit, both, by_block[:, channels], std[:, channels])
        found[:, channels] = np.where((errors * others > 0.0) & is_shown[:, channels], errors, 0.0)
    return found


def _are_one_sided(missed: Vector, by_block: Vector) -> NDArray[np.bool_]:
    """Return whether errors of gain and delay (2, c) have the same sign in all groups of missed (n, c)."""
    groups = (missed[..., None] * by_block).reshape(_GROUPS, -1, *by_block.shape[1:]).sum(axis=1)
    is_one_sided: NDArray[np.bool_] = np.abs(np.sign(groups).sum(axis=0)) == _GROUPS
    return is_one_sided.T


def _regressions(limit: float, missed: Vector, by_block: Vector, std: Vector) -> list[Vector]:
    """Return the errors of gain and delay (2, c), 0 where there is none, of each of missed (k, n, c); std (n, c).

    by_block (n, c, 2): what is integrated, and the change of the derivative.
    """
    n, by_block = len(std), by_block.transpose(1, 0, 2)  # (c, n, 2)
    aside = by_block - by_block.mean(axis=1, keepdims=True)
    least = np.linalg.pinv(aside, rcond=_RANK)  # (c, 2, n)
    found: list[Vector] = []
    for one in missed.transpose(0, 2, 1):  # (c, n)
        missed_aside = one - one.mean(axis=1, keepdims=True)
        errors = (least @ missed_aside[..., None])[..., 0]  # (c, 2)
        if not np.any(np.abs(errors) > _OF_ACCOUNT):
            found.append(np.zeros(errors.T.shape))
            continue
        left = missed_aside - (aside @ errors[..., None])[..., 0]
        scatter = np.sqrt(np.sum(left**2, axis=1, keepdims=True) / (n - 3))
        stds = np.linalg.norm(least * np.maximum(std.T, scatter)[:, None, :], axis=2)
        is_error = np.abs(errors) > np.maximum(limit * stds, _OF_ACCOUNT)
        found.append(np.where(is_error, errors, 0.0).T)
    return found
