"""Residuals of the samples as a function of the parameters: the loop's `Window` and the solver's `Objective`."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Final, Protocol

import numpy as np

from .samples import Sample
from .sliding_window import ResidualWindow
from .space import ParameterSpace, Vector

DIFFERENCE_STEP: Final = 1e-3
"""Finite-difference step in the unit cube for simulated outputs, which an integrator with error control makes rough."""


class Window(Protocol):
    """Samples on which candidates are evaluated: a ResidualWindow, which slides, or an EpisodeWindow, which waits."""

    n_model_calls: int
    """Number of samples at which a candidate was evaluated."""

    @property
    def is_rescoring_cheap(self) -> bool:
        """True where earlier candidates may be evaluated again at every sample."""
        ...

    @property
    def is_ready(self) -> bool:
        """True where candidates can be evaluated in an episode that has begun."""
        ...

    @property
    def newest(self) -> Sample: ...
    def append(self, sample: Sample) -> None: ...
    def begin(self, theta: Vector) -> str | None: ...
    def explain(self, theta: Vector, patient: bool = True) -> None: ...
    def end(self, theta: Vector) -> None: ...
    def revert(self, theta: Vector) -> None: ...
    def residual(self, theta: Vector) -> Vector: ...
    def residuals(self, candidates: Iterable[Vector]) -> Sequence[Vector] | Vector: ...
    def why_failed(self, theta: Vector) -> str | None: ...
    def keep(self, candidates: Iterable[Vector]) -> None: ...


@dataclass(frozen=True)
class LinearForm:
    """Model written as rows psi(theta) = targets, linear in the coefficients psi though not in theta."""

    space: ParameterSpace
    """Parameters that `coefficients_of` is called with, by name."""
    rows_of: Callable[..., tuple[Sequence[Sequence[float]], Sequence[float]]]
    """(rows (r, p), targets (r,)) = rows_of(x, u, xdot): state (n,), held input, sampled derivatives (c,).

    xdot has one number a channel, in the order of `sampling.derivatives`, and NaN where a sample lacks one.
    """
    coefficients_of: Callable[..., Sequence[float]]
    """psi (p,) = coefficients_of(**theta)."""

    def rows(self, sample: Sample) -> tuple[Vector, Vector]:
        """Return the rows (r, p) and targets (r,) of one sample.

        Raises ValueError, which says what the sample holds, where they cannot be made of it.
        """
        try:
            rows, targets = self.rows_of(sample.x, sample.u, sample.xdot)
            found = np.array(rows, dtype=float), np.array(targets, dtype=float)
            if found[0].ndim != 2 or found[1].shape != found[0].shape[:1]:
                raise ValueError(f"rows {found[0].shape} and targets {found[1].shape} do not match")
        except (IndexError, TypeError, ValueError) as e:
            held = (
                f"x has {len(sample.x)} states, u {len(sample.u)} inputs, xdot {len(sample.xdot)} sampled derivatives"
            )
            raise ValueError(f"linear form, rows(x, u, xdot): {e}; {held}, in the order of sampling.derivatives") from e
        return found

    def coefficients(self, theta: Vector) -> Vector:
        """Return the coefficients psi (p,) at theta (d,)."""
        return np.array(self.coefficients_of(**self.space.named(theta)), dtype=float)


class Objective:
    """Residuals of any theta on the window as it is now, every evaluation counted."""

    def __init__(self, window: Window, linear: LinearForm | None = None, max_evaluations: float = inf) -> None:
        """max_evaluations: after so many every candidate counts as failed, and costs nothing."""
        self._window = window
        self.linear = linear
        """The model's linear form, where it has one and the scenario names it."""
        self.n_evaluations = 0
        """Number of candidates evaluated through this objective."""
        self.max_evaluations = max_evaluations
        """Largest allowed number of evaluations."""

    @property
    def newest(self) -> Sample:
        """The newest sample."""
        return self._window.newest

    @property
    def has_samples(self) -> bool:
        """True where each sample has residuals of its own; else a solve is on the samples of an episode."""
        return isinstance(self._window, ResidualWindow)

    @property
    def difference_step(self) -> float | None:
        """Step for gradients in the unit cube; None where residuals are smooth and cheap: the solver's own will do."""
        return None if self._window.is_rescoring_cheap else DIFFERENCE_STEP

    @property
    def is_spent(self) -> bool:
        """True where the evaluations are used up."""
        return self.n_evaluations >= self.max_evaluations

    def residual(self, theta: Vector) -> Vector:
        """Return the residual (D,) over the window; NaN where the model has no value."""
        if self.is_spent:
            return np.array([np.nan])
        self.n_evaluations += 1
        return self._window.residual(theta)

    def residuals(self, thetas: Sequence[Vector]) -> Sequence[Vector]:
        """Return the residual (D,) of each theta, several evaluated at a time where that is faster."""
        if len(thetas) == 1 or self.n_evaluations + len(thetas) > self.max_evaluations:
            return [self.residual(theta) for theta in thetas]
        self.n_evaluations += len(thetas)
        return list(self._window.residuals(thetas))

    def slopes(self, theta: Vector) -> Vector | None:
        """Return the slopes (D, d) of the residual at theta (d,) in the unit cube, one evaluation; None without any."""
        if self.is_spent or not isinstance(self._window, ResidualWindow):
            return None
        found = self._window.slopes(theta)
        self.n_evaluations += found is not None
        return found

    def newest_residual(self, theta: Vector) -> Vector:
        """Return the residual (..., c) at the newest sample, as `residual_at`."""
        return self.residual_at(theta, self.newest)

    def residual_at(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (..., c) of candidates (..., d) at one sample; NaN where the model has no value.

        Raises ValueError where the window has no residual of a single sample.
        """
        if not isinstance(self._window, ResidualWindow):
            raise ValueError("only derivatives give a residual at one sample.")
        self.n_evaluations += theta.size // theta.shape[-1]
        return self._window.residual_at(theta, sample)
