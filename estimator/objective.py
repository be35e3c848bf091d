"""Samples as a function of the parameters: what the loop needs of a window, and what a solver gets."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final, Protocol

import numpy as np

from .samples import Sample
from .sliding_window import ResidualWindow
from .space import ParameterSpace, Vector

DIFFERENCE_STEP: Final = 1e-3
"""Of the unit cube, for differences of simulated outputs, which an integrator with error control makes ragged."""


class Window(Protocol):
    """The samples that candidates are judged on: a ResidualWindow, which slides, or an EpisodeWindow, which waits."""

    n_model_calls: int
    """Samples at which a candidate was judged."""

    @property
    def is_rescoring_cheap(self) -> bool:
        """Whether candidates that were judged before may be judged anew at every sample."""
        ...

    @property
    def is_ready(self) -> bool:
        """Whether candidates can be judged in an episode that has begun."""
        ...

    @property
    def newest(self) -> Sample: ...
    def append(self, sample: Sample) -> None: ...
    def begin(self, theta: Vector) -> str | None: ...
    def explain(self, theta: Vector, patient: bool = True) -> None: ...
    def end(self, theta: Vector) -> None: ...
    def residual(self, theta: Vector) -> Vector: ...
    def residuals(self, candidates: Iterable[Vector]) -> Sequence[Vector] | Vector: ...
    def why_failed(self, theta: Vector) -> str | None: ...
    def keep(self, candidates: Iterable[Vector]) -> None: ...


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

    def __init__(self, window: Window, linear: LinearForm | None = None, max_evaluations: float = inf) -> None:
        """max_evaluations: after so many every candidate counts as failed, and costs nothing."""
        self._window = window
        self.linear = linear
        """The model's linear form, where it has one and the scenario names it."""
        self.n_evaluations = 0
        """Candidates evaluated through this objective."""
        self.max_evaluations = max_evaluations
        """Candidates that may be."""

    @property
    def newest(self) -> Sample:
        """The newest sample."""
        return self._window.newest

    @property
    def difference_step(self) -> float | None:
        """For gradients, of the unit cube; None where residuals are smooth and cheap: a solver's own will do."""
        return None if self._window.is_rescoring_cheap else DIFFERENCE_STEP

    @property
    def is_spent(self) -> bool:
        """Whether no candidate more is evaluated."""
        return self.n_evaluations >= self.max_evaluations

    def residual(self, theta: Vector) -> Vector:
        """Residual (D,) over the window; NaN where the model has no value."""
        if self.is_spent:
            return np.array([np.nan])
        self.n_evaluations += 1
        return self._window.residual(theta)

    def residuals(self, thetas: Sequence[Vector]) -> Sequence[Vector]:
        """The residual (D,) of each theta, several at a time where that is faster."""
        if self._window.is_rescoring_cheap or self.n_evaluations + len(thetas) > self.max_evaluations:
            return [self.residual(theta) for theta in thetas]
        self.n_evaluations += len(thetas)
        return list(self._window.residuals(thetas))

    def newest_residual(self, theta: Vector) -> Vector:
        """Residual (c,) at the newest sample; NaN where the model has no value. Raises ValueError where it has none."""
        if not isinstance(self._window, ResidualWindow):
            raise ValueError("only derivatives give a residual at one sample.")
        self.n_evaluations += 1
        return self._window.newest_residual(theta)
