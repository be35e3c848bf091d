"""Search for GPy's hyperparameters as `surrogate` does: by logarithms, inside bounds, from where they are.

GPy searches in coordinates of its own, where what a few iterations find is another thing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used
from numpy.typing import NDArray

from ..space import Vector
from .surrogate import ENOUGH

_POSITIVE: Final = (1e-6, 1e6)
"""Bounds of a positive hyperparameter that has none."""
_IMPOSSIBLE: Final = 1e10
"""Value returned to the minimiser where GPy finds no likelihood."""


@dataclass(frozen=True)
class FreeParameters:
    """Parameters (p,) of a GPy model that are not fixed, as coordinates x (p,): logarithms of positive ones."""

    places: NDArray[np.intp]
    """Their places among all parameters."""
    is_log: NDArray[np.bool_]
    """True where the coordinate is the logarithm."""
    bounds: Vector
    """Bounds (p, 2) of the coordinates."""

    @classmethod
    def of(cls, model: Any) -> Self:
        """Return those of a model, with the bounds that GPy has for them."""
        lower, upper = np.full(model.size, -np.inf), np.full(model.size, np.inf)
        is_free = np.ones(model.size, dtype=bool)
        for constraint, where in model.constraints.items():
            if constraint == "fixed":
                is_free[where] = False
            elif hasattr(constraint, "lower"):
                lower[where], upper[where] = constraint.lower, constraint.upper
            elif constraint.domain == "positive":
                lower[where], upper[where] = _POSITIVE
        places = np.flatnonzero(is_free)
        is_log = lower[places] > 0.0
        bounds = np.column_stack([lower[places], upper[places]])
        bounds[is_log] = np.log(bounds[is_log])
        return cls(places, is_log, bounds)

    def coordinates(self, model: Any) -> Vector:
        """Return the model's present x (p,)."""
        present: Vector = np.array(model.param_array)[self.places]
        return np.where(self.is_log, np.log(np.where(self.is_log, present, 1.0)), present)

    def parameters(self, x: Vector) -> Vector:
        """Return the parameters (p,) at x (p,)."""
        return np.where(self.is_log, np.exp(np.where(self.is_log, x, 0.0)), x)


def maximise(model: Any, log_likelihood: Callable[[], float], max_iterations: int) -> None:
    """Maximise likelihood times priors over GPy's free parameters. log_likelihood: called once the model has them."""
    free = FreeParameters.of(model)
    if not len(free.places):
        return

    def negative_log_posterior(x: Vector) -> tuple[float, Vector]:
        try:
            model[free.places] = free.parameters(x)
            value, gradient = -log_likelihood(), -np.array(model.gradient)
        except np.linalg.LinAlgError:
            return _IMPOSSIBLE, np.zeros_like(x)
        # On the parameters, where GPy's own sum has a Jacobian: so bounds do not change the optimum.
        for prior, where in model.priors.items():
            value -= float(prior.lnpdf(model.param_array[where]).sum())
            gradient[where] -= prior.lnpdf_grad(model.param_array[where])
        return value, gradient[free.places] * np.where(free.is_log, free.parameters(x), 1.0)

    found = scipy.optimize.minimize(
        negative_log_posterior,
        free.coordinates(model),
        jac=True,
        method="L-BFGS-B",
        bounds=free.bounds,
        options={"maxiter": max_iterations, "ftol": ENOUGH},
    )
    model[free.places] = free.parameters(found.x)
