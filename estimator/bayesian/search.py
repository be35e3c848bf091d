"""Parts of the target-vector search: pure functions of residuals and posteriors."""

from typing import Protocol

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..identifiability import information
from ..space import Vector

_MEAN_STEPS = 8
"""Largest number of Gauss-Newton steps to a minimiser of the surrogate's mean."""
_ENOUGH = 1e-4
"""Change of the sum of squares, in variances of the noise, at which a minimisation ends."""


class VectorPosterior(Protocol):
    """Mean and variance of k outputs, and the mean's slope."""

    def predict(self, Q: Vector) -> tuple[Vector, Vector]: ...
    def mean_and_jacobian(self, z: Vector) -> tuple[Vector, Vector]: ...


def best_that_differ(residuals: Vector, n: int) -> list[int]:
    """Return the indices of the n least rows of residuals (m, D) that differ by a standard deviation or more.

    Rows that differ by less do not determine the slopes, and would add nothing to the surrogate.
    """
    products = residuals @ residuals.T
    costs = products.diagonal()
    differ = costs[:, None] + costs - 2.0 * products >= 1.0
    chosen: list[int] = []
    is_free = np.ones(len(costs), dtype=bool)
    for i in np.argsort(costs, kind="stable").tolist():
        if is_free[i]:
            chosen.append(i)
            is_free &= differ[i]
        if len(chosen) == n:
            break
    return chosen


def principal_components(residuals: Vector, n_outputs: int) -> Vector:
    """Return residuals (n, D) in their principal axes (n, k), k <= n_outputs; |row|^2 is kept but for noise.

    Uncentred, so that zero stays zero. Axes whose root mean square is below 0.1 are left out.
    """
    U, s, _ = np.linalg.svd(residuals, full_matrices=False)
    k = min(max(int((s > 0.1 * len(residuals) ** 0.5).sum()), 1), n_outputs)
    return U[:, :k] * s[:k]


def least_squares_of_mean(posterior: VectorPosterior, z: Vector) -> Vector:
    """Return a minimiser of |posterior mean|^2 in the unit cube, by damped Gauss-Newton steps from z (d,).

    Levenberg (1944), Marquardt (1963).
    """
    damping = 1e-3
    r, slope = posterior.mean_and_jacobian(z)
    for _ in range(_MEAN_STEPS):
        H = slope.T @ slope
        scale = H.diagonal() + 1e-9 * H.trace() + 1e-12
        H.reshape(-1)[:: len(z) + 1] += damping * scale
        _, step, failed = scipy.linalg.lapack.dposv(H, slope.T @ r)
        if failed:  # too flat for so little damping
            damping *= 10.0
            continue
        trial = np.minimum(np.maximum(z - step, 0.0), 1.0)
        r_trial, slope_trial = posterior.mean_and_jacobian(trial)
        gain = r @ r - r_trial @ r_trial
        if gain > 0.0:
            z, r, slope, damping = trial, r_trial, slope_trial, max(damping / 10.0, 1e-9)
        else:
            damping *= 10.0
        if abs(gain) < _ENOUGH:
            break
    return z


def least_change(posterior: VectorPosterior, z: Vector, n_moved: int) -> Vector:
    """Return the place of least |posterior mean|^2 reached from z (d,) by moving in n_moved directions only.

    At each step they are the directions of largest singular values: a flat direction may turn on the way.
    """
    for _ in range(8):
        r, slope = posterior.mean_and_jacobian(z)
        seen_by_data = information(slope)
        seen, s = seen_by_data.directions[:n_moved], seen_by_data.singular_values[:n_moved]
        s = np.maximum(s, 1e-7 * s[0] + 1e-150)  # directions without effect are not moved
        step = seen.T @ (seen @ (slope.T @ r) / (s * s))  # least squares: slope V_i = s_i U_i
        z = np.minimum(np.maximum(z - step, 0.0), 1.0)
        if np.abs(step).max() < 1e-8:
            break
    return z
