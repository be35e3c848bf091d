"""The newest samples as a function of the parameters, which is what a solver gets."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .space import ParameterSpace, Vector
from .telemetry import ResidualWindow, Sample


@dataclass(frozen=True)
class LinearForm:
    """A model written as rows psi(theta) = targets, linear in coefficients psi where it is not in theta."""

    space: ParameterSpace
    """Names the parameters that `coefficients_of` is called with."""
    rows_of: Callable[..., tuple[Sequence[Sequence[float]], Sequence[float]]]
    """(rows (r, p), targets (r,)) = rows_of(x, u, xdot): state (n,), held input, sampled derivatives (c,)."""
    coefficients_of: Callable[..., Sequence[float]]
    """psi (p,) = coefficients_of(**theta)."""

    def rows(self, sample: Sample) -> tuple[Vector, Vector]:
        """Rows (r, p) and targets (r,) of one sample."""
        rows, targets = self.rows_of(sample.x, sample.u, sample.xdot)
        return np.array(rows, dtype=float), np.array(targets, dtype=float)

    def coefficients(self, theta: Vector) -> Vector:
        """psi (p,) at theta (d,)."""
        return np.array(self.coefficients_of(**self.space.named(theta)), dtype=float)


class Objective:
    """Residuals of any theta on the window as it is now, every evaluation counted."""

    def __init__(self, window: ResidualWindow, linear: LinearForm | None = None) -> None:
        self._window = window
        self.linear = linear
        """The model's linear form, where it has one and the scenario names it."""
        self.n_evaluations = 0
        """Candidates evaluated through this objective."""

    @property
    def newest(self) -> Sample:
        """The newest sample."""
        return self._window.newest

    def residual(self, theta: Vector) -> Vector:
        """Residual (D,) over the window; NaN where the model has no value."""
        self.n_evaluations += 1
        return self._window.residual(theta)

    def newest_residual(self, theta: Vector) -> Vector:
        """Residual (c,) at the newest sample; NaN where the model has no value."""
        self.n_evaluations += 1
        return self._window.newest_residual(theta)
