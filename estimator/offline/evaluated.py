"""Residuals over the unit cube, whose best place is remembered."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..space import ParameterSpace, Vector

FitProgress = Callable[[int, float], None]
"""Function called with the evaluations so far and the least sum of squares."""


class Residual(Protocol):
    """Residuals (D,) of theta (d,), in standard deviations of the noise; NaN where there are none."""

    @property
    def n_evaluations(self) -> int: ...
    def __call__(self, theta: Vector) -> Vector: ...
    def many(self, thetas: Sequence[Vector]) -> list[Vector]: ...


@dataclass(frozen=True)
class Evaluated:
    """Place in the unit cube, and the residuals there."""

    z: Vector
    r: Vector

    @property
    def cost(self) -> float:
        """The sum of squares; inf where the evaluation failed."""
        return float(self.r @ self.r) if np.all(np.isfinite(self.r)) else np.inf

    @property
    def misfit(self) -> float:
        """The root mean square residual with D - d degrees of freedom, at least 1e-12."""
        return max(float(np.sqrt(self.cost / max(len(self.r) - len(self.z), 1))), 1e-12)


class CubeResidual:
    """Residuals over the unit cube; remembers the best place. Counts and evaluates like an Objective."""

    difference_step = None
    max_evaluations = np.inf

    def __init__(self, residual: Residual, space: ParameterSpace, progress: FitProgress) -> None:
        self._residual, self._space, self._progress = residual, space, progress
        self.best: Evaluated | None = None

    @property
    def n_evaluations(self) -> int:
        """Number of evaluations so far."""
        return self._residual.n_evaluations

    def many(self, places: Sequence[Vector]) -> list[Evaluated]:
        """Return the residuals at places (d,)."""
        residuals = self._residual.many([self._space.from_unit(z) for z in places])
        found = [Evaluated(np.asarray(z, dtype=float), r) for z, r in zip(places, residuals, strict=True)]
        for one in found:
            if np.isfinite(one.cost) and (self.best is None or one.cost < self.best.cost):
                self.best = one
        self._progress(self.n_evaluations, self.best.cost if self.best else np.inf)
        return found

    def at(self, theta: Vector) -> Evaluated:
        """Return the residuals at theta (d,), with their place."""
        return self.many([self._space.to_unit(theta)])[0]

    def residual(self, theta: Vector) -> Vector:
        """Return the residual (D,) at theta (d,), for solvers."""
        return self.at(theta).r

    def slopes(self, theta: Vector) -> None:
        """Return None: simulated outputs have no slopes but differences."""

    def residuals(self, thetas: Sequence[Vector]) -> list[Vector]:
        """Return the residual (D,) at each theta (d,)."""
        return [one.r for one in self.many([self._space.to_unit(theta) for theta in thetas])]
