"""Recursive least squares, which processes each sample once: an adapter to filterpy's Kalman filter."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..contract import Estimate, scaled_estimate
from ..identifiability import IDENTIFIABLE_BELOW, information
from ..objective import LinearForm, Objective
from ..positive import must_be_positive
from ..space import ParameterSpace, Vector

if TYPE_CHECKING:  # filterpy imports scipy.stats
    from filterpy.kalman import KalmanFilter


_ROUNDING: Final = 1e-14
"""Share of the largest variance of a covariance, or of a coefficient, that rounding may make of none."""
_KNOWN: Final = 1e-6
"""Standard deviation of a coefficient that is known, as a share of its size."""


@dataclass(frozen=True)
class RecursiveSettings:
    """Settings of `RecursiveLeastSquares`."""

    forgetting: float = 0.8
    """Forgetting factor lambda: a sample's weight is multiplied by it at each later sample."""
    noise: float = 0.01
    """Standard deviation of a row's target, in its unit; it weighs the first samples against the start."""
    spread: float = 1.0
    """Standard deviation of the coefficients at the start, relative to that over the bounds."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        if not 0.0 < self.forgetting <= 1.0:
            raise ValueError(f"forgetting must be in (0, 1], got {self.forgetting}.")
        must_be_positive(self, "noise", "spread", "identifiable_below")


class RecursiveLeastSquares:
    """Recursive least squares with exponential forgetting, on a model's linear form.

    The linear form is called with (x, u, xdot) of each sample. xdot holds the sampled derivatives, one a channel in the
    order of `sampling.derivatives`, not one a state; where there is a filter, x, u and xdot are filtered.

    The Kalman filter of constant coefficients whose covariance is divided by lambda at each sample: Ljung (1999),
    section 11.2. In no direction does the covariance exceed its start, so that it does not wind up where nothing is
    excited (Åström and Wittenmark (1995), section 11.5). The parameters are those whose coefficients lie nearest
    to the filter's, in its covariance: where there are more coefficients than parameters, a projection.
    """

    is_whitened = True

    def __init__(
        self, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: RecursiveSettings | None = None
    ) -> None:
        self._space, self._settings = space, settings or RecursiveSettings()
        self.restart(start)

    def restart(self, start: Vector) -> None:
        """Begin at theta (d,), with all samples forgotten."""
        self._z, self._information = self._space.to_unit(start), information(np.eye(len(self._space)))
        self._misfit, self._n_evaluations = np.inf, 0
        self._coefficients: tuple[Vector, Vector] | None = None  # and their covariance

    def solve(self, objective: Objective) -> None:
        """Process the newest sample. Raises ValueError where the model's linear form is unknown."""
        linear = objective.linear
        if linear is None:
            raise ValueError("recursive least squares needs the model's linear form, rows(x, u, xdot) psi = targets.")
        rows, targets = linear.rows(objective.newest)
        is_known = np.isfinite(targets) & np.isfinite(rows).all(axis=1)
        if not is_known.any():
            return
        rows, targets = rows[is_known], targets[is_known]
        kalman = self._kalman(*(self._coefficients or self._begin(linear)))
        kalman.P = _at_most(self._start_std, kalman.P / self._settings.forgetting)
        kalman.update(targets, R=self._settings.noise**2 * np.eye(len(targets)), H=rows)
        self._coefficients = kalman.x, kalman.P
        self._project(linear, kalman.x, kalman.P)
        self._n_evaluations += 1
        self._misfit = float(np.sum(objective.newest_residual(self._space.from_unit(self._z)) ** 2))

    def estimate(self) -> Estimate:
        """Return the parameters of the present coefficients; cost: sum of squared residuals of the newest sample."""
        return scaled_estimate(
            self._space, self._z, self._information.std(), self._settings.identifiable_below, self._information,
            cost=self._misfit, n_evaluations=self._n_evaluations, reason="recursive least squares",
        )  # fmt: skip

    def _begin(self, linear: LinearForm) -> tuple[Vector, Vector]:
        psi = linear.coefficients(self._space.from_unit(self._z))
        cube = scipy.stats.qmc.Halton(len(self._space), scramble=False).random(64)
        anywhere = np.array([linear.coefficients(self._space.from_unit(z)) for z in cube])
        std, size = self._settings.spread * np.std(anywhere, axis=0), np.abs(psi)
        is_constant = std <= _ROUNDING * size  # over the bounds: it is known
        self._start_std = np.where(is_constant, _KNOWN * np.where(size > 0.0, size, 1.0), std)
        return psi, np.diag(np.where(is_constant, 0.0, std**2))

    def _kalman(self, psi: Vector, P: Vector) -> "KalmanFilter":
        from filterpy.kalman import KalmanFilter

        kalman = KalmanFilter(dim_x=len(psi), dim_z=1)
        kalman.x, kalman.P = psi, P
        return kalman

    def _project(self, linear: LinearForm, psi: Vector, P: Vector) -> None:
        values, directions = _principal(self._start_std, P)
        weight = (directions / np.sqrt(values)).T / self._start_std

        def misfit(z: Vector) -> Vector:
            return weight @ (linear.coefficients(self._space.from_unit(z)) - psi)

        result = scipy.optimize.least_squares(misfit, self._z, bounds=(0.0, 1.0))
        self._z = result.x
        self._information = information(np.vstack([result.jac, np.eye(len(self._z))]))  # bounds: one row


def _at_most(std: Vector, P: Vector) -> Vector:
    """Return the covariance P (p, p) with no direction wider than at the start, where it was diag(std^2)."""
    values, directions = _principal(std, P)
    return (directions * np.minimum(values, 1.0)) @ directions.T * std * std[:, None]


def _principal(std: Vector, P: Vector) -> tuple[Vector, Vector]:
    """Return variances (p,) and directions (p, p) of the covariance P (p, p) in units of std (p,).

    Rounding leaves no variance below its own share of the largest: rows a thousand times too large would.
    """
    values, directions = np.linalg.eigh(P / std / std[:, None])
    return np.maximum(values, max(_ROUNDING * values[-1], np.finfo(float).tiny)), directions
