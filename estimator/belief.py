"""Normal distribution of the parameters, and the Kalman filter's update of it by a sample that measures them."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from .differences import value_and_slope
from .space import Vector

_STEP: Final = 1e-4
"""Step of the differences, in the unit cube."""


class Measurement(NamedTuple):
    """Residual of a sample, linearised about a place in the unit cube."""

    place: Vector
    """Place (d,)."""
    value: Vector
    """Residual (c,) there, in standard deviations."""
    slope: Vector
    """Its slope (c, d)."""

    @property
    def has_value(self) -> bool:
        """True where the model has a value and a slope there."""
        return bool(np.isfinite(self.value).all() and np.isfinite(self.slope).all())

    @property
    def is_informative(self) -> bool:
        """True where the model has a value that depends on a parameter."""
        return self.has_value and bool(np.count_nonzero(self.slope))


class Innovation(NamedTuple):
    """Residual of a sample that the samples before it did not foretell."""

    normalised: Vector
    """Residual (c,) at the mean before it, in its own standard deviations."""
    squared: float
    """Sum of their squares: the normalised innovation squared."""
    deviance: float
    """-2 log likelihood of the sample given those before, a constant aside: Schweppe (1965)."""


@dataclass(frozen=True)
class Belief:
    """Normal distribution of the parameters in the unit cube."""

    mean: Vector
    """Mean (d,)."""
    covariance: Vector
    """Covariance (d, d)."""

    def walked(self, variance: Vector) -> "Belief":
        """Return the belief a sample later, with parameters that change at random by this variance (d,)."""
        return Belief(self.mean, self.covariance + variance * identity(len(variance)))

    def updated(self, measured: Measurement) -> tuple["Belief", Innovation]:
        """Return the belief after a measurement, and the measurement's innovation."""
        before, H = self.covariance, measured.slope
        seen = H @ before
        spread = seen @ H.T + identity(len(H))
        value = measured.value + H @ (self.mean - measured.place)
        try:
            root, gain = np.linalg.cholesky(spread), np.linalg.solve(spread, seen).T
        except np.linalg.LinAlgError:
            before, root, gain = _by_roots(before, H)
        left = identity(len(before)) - gain @ H
        after: Vector = left @ before @ left.T + gain @ gain.T  # Joseph's form
        normalised = np.linalg.solve(root, value).astype(np.float64)
        squared = float(normalised @ normalised)
        deviance = squared + 2.0 * float(np.log(root.diagonal()).sum())
        return Belief(self.mean - gain @ value, after), Innovation(normalised, squared, deviance)


def innovation_roots(covariances: Vector, slope: Vector) -> Vector:
    """Return the Cholesky factors (k, c, c) of an innovation's covariance, by those of the parameters (k, d, d)."""
    try:
        return np.linalg.cholesky(slope @ covariances @ slope.T + identity(len(slope))).astype(np.float64)
    except np.linalg.LinAlgError:
        return np.array([_by_roots(P, slope)[1] for P in covariances])


def _by_roots(P: Vector, H: Vector) -> tuple[Vector, Vector, Vector]:
    """Return P (d, d) positive semidefinite, the Cholesky factor (c, c) of H P H' + I, and the gain (d, c).

    From square roots, which stay real where roundings of P, times a large slope H (c, d), are more than one.
    """
    variances, axes = np.linalg.eigh(P)
    factor: Vector = axes * np.sqrt(np.maximum(variances, 0.0))
    seen = H @ factor
    upper: Vector = np.linalg.qr(np.vstack([seen.T, identity(len(H))])).R.astype(np.float64)
    root = upper.T * np.sign(upper.diagonal())
    gain: Vector = np.linalg.solve(root.T, np.linalg.solve(root, seen @ factor.T)).T.astype(np.float64)
    return factor @ factor.T, root, gain


def measurement(residual: Callable[[Vector], Vector], z: Vector) -> Measurement:
    """Return a sample's residual (c,) linearised at z (d,), whether it has a value or not."""
    return Measurement(z, *value_and_slope(residual, z, _STEP))


def measurements(residual: Callable[[Vector], Vector], z: Vector) -> list[Measurement]:
    """Return the residuals (n, c) of n samples, linearised at z (d,), whether they have a value or not."""
    values, slopes = value_and_slope(residual, z, _STEP)
    return [Measurement(z, *of) for of in zip(values, slopes.reshape(*values.shape, len(z)), strict=True)]


@cache
def identity(n: int) -> Vector:
    """Return the identity matrix (n, n), always the same one."""
    matrix = np.eye(n)
    matrix.flags.writeable = False
    return matrix
