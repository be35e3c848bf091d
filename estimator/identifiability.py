"""Identifiability: the directions of theta that the residuals depend on, and how much."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from .space import Vector

IDENTIFIABLE_BELOW: Final = 0.05
"""Standard deviation, as a share of the scaled bounds, of a parameter that counts as identifiable."""


@dataclass(frozen=True)
class Information:
    """Sensitivity of the residuals at one theta: J = d r/d z = U diag(s) V^T, r in standard deviations of the noise.

    Along the direction V_i of the unit cube the data fix z with standard deviation 1/s_i (linearised).
    """

    singular_values: Vector
    """s (d,), from large to small."""
    directions: Vector
    """Rows V_i (d, d)."""

    def significant(self, change: Vector, n_std: float) -> Vector:
        """Return the directions (m, d), m <= d, in which change (d,) exceeds n_std standard deviations."""
        return self.directions[self.singular_values * np.abs(self.directions @ change) > n_std]

    def written(self, change: Vector, n_std: float, std: float) -> Vector:
        """Return the directions (m, d) in which change (d,) is significant, or known to a standard deviation of std."""
        s = self.singular_values
        return self.directions[(s * np.abs(change @ self.directions.T) > n_std) | (s * std > 1.0)]

    def least_moved(self, change: Vector, n_std: float) -> Vector:
        """Return the change (d,) without those parameters that it moves by less than n_std standard deviations.

        They are held one by one, from the least moved, as long as each raises the squared distance by no more than
        n_std squared: Wald (1943), "Tests of statistical hypotheses concerning several parameters". The others go to
        where they are most probable then.
        """
        prior = np.eye(len(change))  # as wide as the bounds
        rows = np.vstack([self.singular_values[:, None] * self.directions, prior])
        std = np.sqrt(self.covariance(1.0).diagonal())
        order = np.argsort(np.abs(change) / std, kind="stable")
        nearest, cost = change, 0.0
        for n in range(1, len(change) + 1):
            moved, found = order[n:], np.zeros(len(change))
            found[moved] = np.linalg.lstsq(rows[:, moved], rows @ change)[0]
            before, cost = cost, float(np.sum((rows @ (found - change)) ** 2))
            if cost - before > n_std**2:
                break
            nearest = found
        return nearest

    def distance(self, change: Vector) -> float:
        """Return the length of a change (d,) in standard deviations: Mahalanobis' distance."""
        return float(np.linalg.norm(self.singular_values * (self.directions @ change)))

    def flat(self, std: float) -> Vector:
        """Return the directions (m, d), m <= d, along which the data's standard deviation exceeds std."""
        return self.directions[self.singular_values * std < 1.0]

    def step(self, slope: Vector) -> Vector:
        """Return the Gauss-Newton step (d,) to the least sum of squares; slope (d,): J^T r. Zero where J is zero.

        Directions whose singular value is 1e7 times smaller than the largest are left out: rounding dominates there.
        """
        s = np.where(self.singular_values > 1e-7 * self.singular_values[0], self.singular_values, np.inf)
        return -self.directions.T @ (self.directions @ slope / (s * s))

    def covariance(self, spread: float) -> Vector:
        """Return the covariance (d, d) of z, whose standard deviation is `spread` in any direction without the data."""
        variances = 1.0 / (self.singular_values**2 + spread**-2)
        return (self.directions.T * variances) @ self.directions

    def std(self) -> Vector:
        """Return the standard deviation of each z (d,), at most 1: the bounds hold whatever the data."""
        variance = np.sum((self.directions / np.maximum(self.singular_values, 1e-12)[:, None]) ** 2, axis=0)
        return np.minimum(np.sqrt(variance), 1.0)


def information(jacobian: Vector) -> Information:
    """Return the information of residuals whose sensitivity to z is jacobian (D, d); D may be smaller than d."""
    d = jacobian.shape[1]
    _, s, directions = np.linalg.svd(jacobian, full_matrices=True)
    singular_values = np.zeros(d)
    singular_values[: len(s)] = s
    return Information(singular_values, directions)


def information_of_covariance(P: Vector) -> Information:
    """Return the information of an estimate with covariance P (d, d) in the unit cube, P = V^T diag(1/s^2) V."""
    variances, directions = np.linalg.eigh(P)  # from small to large: s from large to small
    return Information(1.0 / np.sqrt(np.maximum(variances, 1e-24)), directions.T)
