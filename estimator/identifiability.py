"""Which directions of theta the data can see."""

from dataclasses import dataclass

import numpy as np

from .space import Vector


@dataclass(frozen=True)
class Information:
    """The data's sight at one theta: J = d r/d z = U diag(s) V^T, with r in standard deviations of the noise.

    Along the direction V_i of the unit cube the data fix z with standard deviation 1/s_i (linearised).
    """

    singular_values: Vector
    """s (d,), from large to small."""
    directions: Vector
    """Rows V_i (d, d)."""

    def significant(self, change: Vector, n_std: float) -> Vector:
        """The directions (m, d), m <= d, in which change (d,) exceeds n_std standard deviations."""
        return self.directions[self.singular_values * np.abs(self.directions @ change) > n_std]

    def std(self) -> Vector:
        """Standard deviation of each z (d,), at most 1: the bounds are known whatever the data."""
        variance = np.sum((self.directions / np.maximum(self.singular_values, 1e-12)[:, None]) ** 2, axis=0)
        return np.minimum(np.sqrt(variance), 1.0)


def information(jacobian: Vector) -> Information:
    """Sight of residuals whose sensitivity to z is jacobian (D, d); D may be smaller than d."""
    d = jacobian.shape[1]
    _, s, directions = np.linalg.svd(jacobian, full_matrices=True)
    singular_values = np.zeros(d)
    singular_values[: len(s)] = s
    return Information(singular_values, directions)
