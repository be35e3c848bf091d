"""Gauss-Newton steps to the minimum of residuals that a simulation gives, and their sensitivity there.

Differences are taken over distances at which the residuals change by far more than the simulation's own noise.
"""

from typing import Final

import numpy as np

from ..identifiability import IDENTIFIABLE_BELOW, Information, information
from ..space import Vector
from .evaluated import CubeResidual, Evaluated

_ROUNDS: Final = 8
"""Largest number of Gauss-Newton steps."""
_DAMPINGS: Final = (1e-2, 1e2, 1e4, 1e6)
"""Dampings of the Gauss-Newton steps tried together, in variances of the misfit."""
_ABOVE_NOISE: Final = 50.0
"""Change of the residuals over a difference, in norms of the solver's noise."""
_VISIBLE: Final = 5.0
"""Change of the residuals, in norms of the noise in it, below which nothing is seen."""
_ALIKE: Final = 0.8
"""Cosine of the changes over a distance and over half of it, below which they are no slope."""
_REFINEMENTS: Final = 6
"""Largest number of times that the sensitivity is taken anew along its own singular vectors."""
_UNSEEN: Final = 0.3
"""Standard deviation, as a share of the cube, above which the data do not determine a direction."""


class Descent:
    """Minimum near the best place that was evaluated, with the residuals' sensitivity there.

    noise: norm of the solver's noise over all rows, which bounds what differences can show.
    """

    def __init__(self, seen: CubeResidual, best: Evaluated, noise: float) -> None:
        self._seen, self._noise = seen, noise
        steps = self._steps(self._jacobian(best, np.full(len(best.z), 1e-3)), best.misfit)
        self.place, self.jacobian = self._minimum(best, steps)
        self.refine()

    @property
    def information(self) -> Information:
        """Information from the Jacobian's triangular factor: its own left singular vectors would be (D, D)."""
        return information(np.linalg.qr(self.jacobian).R / self.place.misfit)

    def hold(self, nominal: Vector) -> None:
        """Move along undetermined directions back to nominal (d,), if that costs less than a standard deviation.

        Chord steps in the other directions follow a valley that is not straight.
        """
        flat = self.information.flat(_UNSEEN)
        if not len(flat):
            return
        kept = np.eye(len(nominal)) - flat.T @ flat
        inverse = np.linalg.pinv(self.jacobian @ kept, rcond=1e-9)
        before, z = self.place, self.place.z + flat.T @ flat @ (nominal - self.place.z)
        for _ in range(3):
            (back,) = self._seen.many([np.clip(z, 0.0, 1.0)])
            if back.cost <= before.cost + before.misfit**2 + self._scatter(before):
                self.place = back
                self.jacobian = self._jacobian(back, self._steps(self.jacobian, back.misfit))
                self.refine()
                return
            if not np.isfinite(back.cost):
                return
            z = back.z - inverse @ back.r

    def refine(self) -> None:
        """Take the Jacobian anew along its singular vectors, until the smallest singular value stays.

        Over the distance at which one parameter alone is seen, a direction in which several make up for one another
        drowns in what the large changes are wrong by; taken along that direction, over a distance of its own, it
        does not. Where the change stays in the solver's noise, or is another over half the distance, it is none.
        """
        least = self.information.singular_values[-1]
        for _ in range(_REFINEMENTS):
            found = self.information
            directions, s = found.directions, np.maximum(found.singular_values, 1e-12)
            steps = np.clip((1.0 + _ABOVE_NOISE * self._noise / self.place.misfit) / s, 1e-6, IDENTIFIABLE_BELOW)
            slopes, distances = self._slopes(self.place, directions, steps)
            halfway, _ = self._slopes(self.place, directions, 0.5 * steps)
            norms = np.linalg.norm(slopes, axis=0)
            likeness = np.sum(slopes * halfway, axis=0) / np.maximum(norms * np.linalg.norm(halfway, axis=0), 1e-300)
            changes = norms * distances / np.maximum(np.sqrt(2.0) * self._noise, 1e-300)
            drowned = (changes <= _VISIBLE) | ((likeness < _ALIKE) & (changes < _ABOVE_NOISE))
            slopes = np.where(drowned, 0.0, slopes)
            cornered = distances < 0.2 * steps  # bounds stop it on both sides
            self.jacobian = np.where(cornered, self.jacobian @ directions.T, slopes) @ directions
            before, least = least, self.information.singular_values[-1]
            if not 0.0 < least < 0.9 * before:
                break

    def _minimum(self, place: Evaluated, steps: Vector) -> tuple[Evaluated, Vector]:
        """Return the minimum and the Jacobian there.

        Of several dampings the best is taken: Levenberg (1944), Marquardt (1963). Differences are
        taken over about the standard deviation that each parameter alone would have.
        """
        jacobian = self._jacobian(place, steps)
        for _ in range(_ROUNDS):
            misfit = place.misfit
            finer = self._steps(jacobian, misfit)
            if np.any(np.abs(np.log(finer / steps)) > 1.1):
                steps = finer
                jacobian = self._jacobian(place, steps)
            trial = min(self._trials(place, jacobian), key=lambda one: one.cost)
            gain = place.cost - trial.cost
            if gain <= 0.0:
                break
            place = trial
            jacobian = self._jacobian(place, steps)
            if gain < max(1e-3 * misfit**2, self._scatter(place)):
                break
        return place, jacobian

    def _scatter(self, place: Evaluated) -> float:
        """Return the change of the sum of squares that the solver's noise makes, twice its standard deviation."""
        return 2.0 * float(np.sqrt(place.cost / len(place.r))) * 2.0 * self._noise

    def _trials(self, place: Evaluated, jacobian: Vector) -> list[Evaluated]:
        """Return the places after steps of different damping, in the parameters that no bound stops."""
        slope = jacobian.T @ place.r
        is_free = ~(((place.z <= 0.0) & (slope > 0.0)) | ((place.z >= 1.0) & (slope < 0.0)))
        trials: list[Vector] = []
        if np.any(is_free):
            U, s, directions = np.linalg.svd(jacobian[:, is_free], full_matrices=False)
            for damping in _DAMPINGS:
                step = np.zeros(len(place.z))
                step[is_free] = -directions.T @ (s / (s * s + damping * place.misfit**2) * (U.T @ place.r))
                trials.append(np.clip(place.z + step, 0.0, 1.0))
        return self._seen.many(trials) or [place]

    def _jacobian(self, place: Evaluated, steps: Vector) -> Vector:
        return self._slopes(place, np.eye(len(steps)), steps)[0]

    def _slopes(self, place: Evaluated, directions: Vector, steps: Vector) -> tuple[Vector, Vector]:
        """Return d r (D, m) along directions (m, d) by central differences, and the distances (m,) that they span.

        One-sided at a bound or beside a place that fails.
        """
        offsets = directions * steps[:, None]
        ends = [place.z + side * _room(place.z, side * offset) * offset for side in (1.0, -1.0) for offset in offsets]
        sides = self._seen.many([np.clip(z, 0.0, 1.0) for z in ends])
        slopes: list[Vector] = []
        distances: list[float] = []
        for v, above, below in zip(directions, sides[: len(steps)], sides[len(steps) :], strict=True):
            above, below = (one if np.isfinite(one.cost) else place for one in (above, below))
            distance = float(v @ (above.z - below.z))
            distances.append(distance)
            slopes.append((above.r - below.r) / distance if distance > 0.0 else np.zeros(len(place.r)))
        return np.column_stack(slopes), np.array(distances)

    def _steps(self, jacobian: Vector, misfit: float) -> Vector:
        """Return differences (d,) that change the residuals by about the misfit, and by far more than the noise."""
        change = misfit + _ABOVE_NOISE * self._noise
        return np.clip(change / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300), 1e-6, 1e-2)


def _room(z: Vector, offset: Vector) -> float:
    """Return the share of an offset (d,) from z (d,) that stays in the unit cube, at most 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(offset > 0.0, (1.0 - z) / offset, np.where(offset < 0.0, -z / offset, np.inf))
    return float(np.clip(reach.min(), 0.0, 1.0))
