"""Signs that parameters follow something that the model lacks: they go to and fro, or never stay where they are found.

No change of the plant's does that. Beside these, which parameters were in force at which sample. Places (d,) are in the
scaled bounds; values are frozen, and a step gives the next.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import USUAL_RATE
from ..space import Vector
from .settings import FORGOTTEN, PATIENCE

_TO_AND_FRO: Final = 0.5
"""Distance by which parameters may be moved in excess of the way there."""
_FAR: Final = 0.1
"""Distance that counts as a move: noise that is larger than declared makes many small ones."""
_REMEMBERED: Final = 5
"""Number of searches, one soon after the other, that are compared with each other."""
_MOST_CHANGES: Final = 500
"""Largest number of changes of the parameters in force that are remembered."""
_AGREE: Final = 0.02
"""Distance of parameters that agree, beside their drift."""
_N_STD: Final = 3.0
"""Standard deviations by which parameters that differ must do so."""


def agree(z: Vector, other: Vector) -> bool:
    """Return whether two places are the same parameters."""
    return bool(np.all(np.abs(z - other) <= _AGREE))


@dataclass(frozen=True)
class ParameterPath:
    """Path of the parameters in force, as far as the samples determined their moves."""

    start: Vector | None = None
    """Place before the first move; None before any."""
    now: Vector | None = None
    """Place at the newest sample."""
    length: Vector | float = 0.0
    """Length of the path (d,)."""
    awaited: NDArray[np.bool_] | None = None
    """True for each parameter that the last proposal determines; None where nothing is proposed."""

    def begin(self, z: Vector | None) -> "ParameterPath":
        """Return the path that begins at z."""
        return replace(self, start=z, length=0.0)

    def expect(self, is_determined: NDArray[np.bool_] | None) -> "ParameterPath":
        """Return the path with a proposal that the controller may take; None where there is none."""
        return ParameterPath(self.start, self.now, self.length, is_determined)

    def moved_to(self, z: Vector) -> "ParameterPath":
        """Return the path to z, where the controller has been taken."""
        if self.awaited is None or self.now is None:
            return ParameterPath(self.start, z, self.length)
        moved = np.abs(z - self.now)
        length = self.length + np.where(self.awaited & (moved > _FAR), moved, 0.0)
        return ParameterPath(self.start, z, length)

    def is_to_and_fro(self, z: Vector) -> bool:
        """Return whether it is longer, by half of the bounds, than from its start to z."""
        return self.start is not None and bool(np.any(self.length - np.abs(z - self.start) > _TO_AND_FRO))


@dataclass(frozen=True)
class Findings:
    """Parameters that searches have found, one soon after the other."""

    n_samples: int = -FORGOTTEN
    """Number of the sample at which the last ones were found."""
    last: Vector | None = None
    """Their place; None before the first."""
    std: Vector | float = 0.0
    """Standard deviation (d,) to which the samples determined it."""
    moves: tuple[bool, ...] = ()
    """True for each of the last searches that has found other parameters than the one before."""

    def take(self, n_samples: int, z: Vector, std: Vector) -> "Findings":
        """Return the findings with parameters that are found at sample n_samples, determined to a std (d,)."""
        n_passed = n_samples - self.n_samples
        if self.last is None or n_passed >= FORGOTTEN:
            return Findings(n_samples, z, std)
        allowed = _AGREE + USUAL_RATE * n_passed + _N_STD * np.hypot(std, self.std)
        has_moved = bool(np.any(np.abs(z - self.last) > allowed))
        return Findings(n_samples, z, std, (*self.moves, has_moved)[-_REMEMBERED:])

    def forget(self) -> "Findings":
        """Return the findings without the moves so far."""
        return replace(self, moves=())

    @property
    def has_moved(self) -> bool:
        """True where the last search has found other parameters than the one before."""
        return any(self.moves[-1:])

    @property
    def are_restless(self) -> bool:
        """True where several of the last searches have found other parameters."""
        return sum(self.moves) >= PATIENCE


@dataclass(frozen=True)
class InForce:
    """Parameters in force at the newest samples, since earlier ones last returned."""

    changes: tuple[tuple[int, Vector], ...] = ()
    """Number of the first sample at which parameters (d,) were in force, and these, from old to new."""

    def take(self, n: int, theta: Vector) -> "InForce":
        """Return what was in force up to sample n, at which theta (d,) is."""
        if self.changes and np.array_equal(theta, self.changes[-1][1]):
            return self
        return InForce((*self.changes, (n, theta))[-_MOST_CHANGES:])

    @property
    def have_changed(self) -> bool:
        """True where others than the first ones, or than those that last returned, have been in force."""
        return len(self.changes) > 1

    def left_at(self, theta: Vector) -> int:
        """Return the number of the first sample at which others were in force after theta (d,), as far as is known."""
        after = [n for (_, before), (n, _) in pairwise(self.changes) if np.array_equal(before, theta)]
        return after[-1] if after else next((n for n, _ in self.changes), 0)

    def at(self, n: int) -> Vector:
        """Return the parameters (d,) in force at sample n, or the earliest that are known."""
        return next((theta for first, theta in reversed(self.changes) if first <= n), self.changes[0][1])
