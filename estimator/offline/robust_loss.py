"""Losses under which an outlier counts for less than its square, in SciPy's terms: `least_squares`, loss and f_scale.

In place of r^2 there is C^2 rho((r / C)^2): Huber (1981), "Robust Statistics", chapter 7.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from ..space import Vector
from .evaluated import Residual

LOSSES: Final = ("linear", "huber", "soft_l1", "cauchy")
"""Names of the losses; linear is the square itself."""


@dataclass(frozen=True)
class Loss:
    """Loss of a residual r in standard deviations of the noise."""

    name: str = "linear"
    """One of `LOSSES`."""
    scale: float = 1.0
    """C, SciPy's f_scale: the residual from which on it counts for less."""

    def __post_init__(self) -> None:
        if self.name not in LOSSES:
            raise ValueError(f"no loss '{self.name}'; there are {', '.join(LOSSES)}")
        if not 0.0 < self.scale < np.inf:
            raise ValueError(f"the loss's scale must be positive, got {self.scale:g}")

    @property
    def is_linear(self) -> bool:
        """True where every residual counts by its square."""
        return self.name == "linear"

    def shrunk(self, r: Vector) -> Vector:
        """Return residuals (...,) whose squares are the loss, with the signs of r: sign(r) C sqrt(rho)."""
        a = np.abs(r) / self.scale
        with np.errstate(invalid="ignore", over="ignore"):
            size = {
                "linear": lambda: a,
                "huber": lambda: np.where(a <= 1.0, a, np.sqrt(np.maximum(2.0 * a - 1.0, 0.0))),
                "soft_l1": lambda: a * np.sqrt(2.0 / (1.0 + np.hypot(1.0, a))),
                "cauchy": lambda: np.sqrt(np.log1p(a * a)),
            }[self.name]()
        return np.sign(r) * self.scale * size

    def influence(self, r: Vector) -> Vector:
        """Return psi (...,) = r rho'((r / C)^2), half the slope of the loss."""
        a = np.abs(r) / self.scale
        return (
            r
            * {
                "linear": lambda: np.ones_like(a),
                "huber": lambda: 1.0 / np.maximum(a, 1.0),
                "soft_l1": lambda: 1.0 / np.hypot(1.0, a),
                "cauchy": lambda: 1.0 / (1.0 + a * a),
            }[self.name]()
        )

    def curvature(self, r: Vector) -> Vector:
        """Return the slope (...,) of psi."""
        z = (r / self.scale) ** 2
        return {
            "linear": lambda: np.ones_like(z),
            "huber": lambda: (z <= 1.0).astype(float),
            "soft_l1": lambda: (1.0 + z) ** -1.5,
            "cauchy": lambda: (1.0 - z) / (1.0 + z) ** 2,
        }[self.name]()

    def shrinkage(self, r: Vector) -> Vector:
        """Return the slope (...,) of `shrunk`."""
        size = self.shrunk(r)
        return np.where(size == 0.0, 1.0, self.influence(r) / np.where(size == 0.0, 1.0, size))


class LinearEquivalent(NamedTuple):
    """Least-squares problem whose estimate has the covariance that the loss's has."""

    r: Vector
    """Residuals (D,): psi over its mean slope."""
    jacobian: Vector
    """Slopes (D, d) of the model in standard deviations of the noise."""
    misfit: float
    """Root mean square of r, with D - d degrees of freedom."""
    curvature: float
    """Mean slope of psi, which the loss's own curvature is of the squares'."""


def linear_equivalent(loss: Loss, r: Vector, jacobian: Vector) -> LinearEquivalent:
    """Return it at a minimum with residuals r (D,); jacobian: slopes (D, d) of the shrunk ones.

    An M-estimate has covariance E[psi^2] / E[psi']^2 (J^T J)^-1, with the factor that few data for many parameters
    ask for: Huber (1981), equation 7.6.5. Psi is what is correlated from row to row.
    """
    D, d = jacobian.shape
    curvature, slopes = loss.curvature(r), jacobian / loss.shrinkage(r)[:, None]
    mean = max(float(np.mean(curvature)), 1e-12)
    few = 1.0 + d / D * float(np.var(curvature)) / mean**2
    psi = few * loss.influence(r) / mean
    return LinearEquivalent(psi, slopes, max(float(np.sqrt(psi @ psi / max(D - d, 1))), 1e-12), mean)


class ShrunkResidual:
    """Residuals whose sum of squares is the loss."""

    def __init__(self, residual: Residual, loss: Loss) -> None:
        self._residual, self._loss = residual, loss

    @property
    def n_evaluations(self) -> int:
        """Number of evaluations so far."""
        return self._residual.n_evaluations

    def __call__(self, theta: Vector) -> Vector:
        """Return the residual (D,) of theta (d,)."""
        return self.many([theta])[0]

    def many(self, thetas: Sequence[Vector]) -> list[Vector]:
        """Return the residual (D,) of each theta (d,)."""
        found = self._residual.many(thetas)
        return found if self._loss.is_linear else [self._loss.shrunk(r) for r in found]
