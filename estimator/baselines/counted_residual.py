"""Residuals for SciPy's least squares: a limited number of evaluations, of which the best is remembered."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..objective import Objective
from ..space import ParameterSpace, Vector

_SMOOTH_STEP: Final = float(np.finfo(float).eps ** 0.5)
"""Step of differences in the unit cube, that of SciPy."""
FAILED: Final = 1e12
"""Residual of a candidate at which the model has no value: optimisers need a number."""


class SpentError(Exception):
    """Raised when the evaluations of a solve are spent: SciPy's own limit leaves out those for the Jacobian."""


class NoValueError(Exception):
    """Raised where a solve would begin at a place at which the model has no value: it has no slopes there."""


class CountedResidual:
    """Residuals in the unit cube for a limited number of evaluations; remembers the best.

    With a prior the distance from its mean is d residuals more, at the end.
    """

    def __init__(
        self,
        space: ParameterSpace,
        objective: Objective,
        max_evaluations: float,
        start: Vector,
        prior_std: float | None = None,
        smooth_step: float = _SMOOTH_STEP,
    ) -> None:
        """start (d,): the best place until there is one, and the prior's mean; prior_std: its standard deviation in
        the unit cube, None where there is no prior; smooth_step: of differences where the residual is smooth."""
        self._space, self._objective, self._smooth_step = space, objective, smooth_step
        self._remaining = min(max_evaluations, objective.max_evaluations)
        self._step = objective.difference_step
        self._mean, self._prior_std = start, prior_std
        self._newest = np.empty(0)
        self.z, self.cost, self.least = start, np.inf, np.empty(0)
        self.linearised: tuple[Vector, Vector, Vector] | None = None
        """Place (d,) of the last slopes, the residual (D,) there, and they (D, d)."""

    def residual(self, z: Vector) -> Vector:
        """Return the residual (D,) at z (d,). Raises SpentError when none are left, NoValueError at a first place."""
        (self._newest,) = self._residuals([z])
        return self._newest

    def differences(self, z: Vector) -> Vector:
        """Return slopes (D, d) at z (d,), the place evaluated last: the model's own, or differences, all at once.

        Forward ones where the residual is smooth, by default with SciPy's own step, and towards the cube's middle
        where not.
        """
        slopes = self._slopes(z)
        self.linearised = z.copy(), self._newest, slopes
        return slopes

    def _slopes(self, z: Vector) -> Vector:
        own = self._objective.slopes(self._space.from_unit(z)) if self._remaining >= 1 else None
        if own is not None:
            self._remaining -= 1
            return own if self._prior_std is None else np.vstack([own, np.eye(len(z)) / self._prior_std])
        step = self._step or self._smooth_step
        steps = np.where(z < 0.5 if self._step else z + step <= 1.0, step, -step)
        found = self._beside(z, steps, np.arange(len(z)))
        # The other side of those without a value; where that has none either, or is no place, nothing is known.
        failed = np.array([k for k, (r, _) in enumerate(found) if has_failed(r) and 0.0 <= z[k] - steps[k] <= 1.0], int)
        for k, other in zip(failed, self._beside(z, -steps, failed) if len(failed) else (), strict=True):
            found[k] = other
        return np.array([0.0 * r if has_failed(r) else (r - self._newest) / h for r, h in found]).T

    def _beside(self, z: Vector, steps: Vector, places: NDArray[np.intp]) -> list[tuple[Vector, float]]:
        """Return the residual beside z (d,), a step away in each of some coordinates, and how far that is."""
        beside = (z + np.diag(steps))[places]
        moved = beside[np.arange(len(places)), places] - z[places]
        return [*zip(self._residuals([*beside]), moved.tolist(), strict=True)]

    def _residuals(self, places: list[Vector]) -> list[Vector]:
        if self._remaining < len(places):
            if not self._step:  # roll-outs that lead to no slope are not worth it
                self._residuals(places[: int(self._remaining)])
            raise SpentError
        self._remaining -= len(places)
        return [
            self._taken(z, residual)
            for z, residual in zip(
                places, self._objective.residuals([self._space.from_unit(z) for z in places]), strict=True
            )
        ]

    def _taken(self, z: Vector, raw: Vector) -> Vector:
        residual = np.clip(np.nan_to_num(raw, nan=FAILED), -FAILED, FAILED)
        is_failed, n_prior = has_failed(residual), 0 if self._prior_std is None else len(z)
        if is_failed and not len(self._newest):
            raise NoValueError  # nor is there a length
        if is_failed:
            residual = np.full(len(self._newest) - n_prior, FAILED)  # a roll-out that has failed is one number
        if self._prior_std is not None:
            residual = np.append(residual, (z - self._mean) / self._prior_std)
        cost = float(residual @ residual)
        if not is_failed and cost < self.cost:
            self.z, self.cost, self.least = z.copy(), cost, residual
        return residual


def has_failed(residual: Vector) -> bool:
    """Return whether a residual (D,) is that of a candidate at which the model has no value."""
    return bool(np.any(np.abs(residual) >= FAILED))
