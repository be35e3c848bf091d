"""Common alternatives to Bayesian optimisation: adapters to SciPy and Ipopt."""

import warnings
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..contract import Estimate, scaled_estimate
from ..identifiability import IDENTIFIABLE_BELOW, information
from ..objective import Objective
from ..positive import must_be_positive
from ..space import ParameterSpace, Vector, one_at_a_time
from .counted_residual import FAILED, CountedResidual, NoValueError, SpentError

_BESIDE = 0.1
"""Distance in the unit cube of the places that are tried where there is no value at the first."""
Minimizer = Literal["ipopt", "trust-constr", "SLSQP"]


@dataclass(frozen=True)
class NormSettings:
    """Settings of `NoisyNorm`."""

    minimizer: Minimizer = "SLSQP"
    """Ipopt (an interior-point method; needs cyipopt), SciPy's interior-point method or its sequential QP."""
    noise: float = 3.2e-3
    """Standard deviation of the noise added to the norm at each evaluation, in the residual's unit."""
    difference_step: float = 0.0
    """Finite-difference step for the gradient, as a share of each parameter's bounds; 0: the minimizer's own, 1e-8."""
    max_iterations: int = 50
    """Iterations in a solve."""

    def __post_init__(self) -> None:
        if self.noise < 0.0:
            raise ValueError(f"noise must not be negative, got {self.noise}.")
        if not 0.0 <= self.difference_step <= 0.5:
            raise ValueError(f"difference_step must be in [0, 0.5], got {self.difference_step}.")
        if self.max_iterations < 1:
            raise ValueError(f"max_iterations must be positive, got {self.max_iterations}.")


class NoisyNorm:
    """Gradient method on the paper's objective: the norm of the residual, with fresh noise at each evaluation.

    It starts each time from the nominal parameters, and takes its gradient by finite differences, which see the noise
    divided by the step. Khan and Chatterjee (2020), section IV: the solvers that they compare with.
    Residuals are in physical units.
    """

    is_whitened = False

    def __init__(
        self, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: NormSettings | None = None
    ) -> None:
        self._space, self._rng, self._settings = space, rng, settings or NormSettings()
        self._bounds = [(p.lower, p.upper) for p in space]
        self._nominal = self._theta = self._clipped(start)
        self._cost, self._n_evaluations = np.inf, 0

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,): the last result is forgotten, and nothing else is kept between solves."""
        self._theta, self._cost, self._n_evaluations = self._clipped(start), np.inf, 0

    def solve(self, objective: Objective) -> None:
        """Minimise the noisy norm over the present samples."""

        least, best = np.inf, self._nominal

        def norm(theta: Vector) -> float:
            nonlocal least, best
            value = float(np.linalg.norm(objective.residual(theta)))
            value = (value if np.isfinite(value) else FAILED) + self._settings.noise * self._rng.standard_normal()
            if value < least:
                least, best = value, theta.copy()
            return value

        result = _minimize(norm, self._nominal, self._bounds, self._settings)
        is_cut = objective.is_spent and least < FAILED / 2  # its last steps saw no values
        self._theta = self._clipped(best if is_cut else result.x)
        self._cost = least if is_cut else float(result.fun)
        self._n_evaluations += objective.n_evaluations

    def estimate(self) -> Estimate:
        """Return the last result; std is as wide as the bounds, because the minimum of one number has none."""
        width, none = self._space.slope(self._theta), (False,) * len(self._theta)
        return Estimate(self._theta, width, none, self._cost, self._n_evaluations, self._settings.minimizer)

    def _clipped(self, theta: Vector) -> Vector:
        return np.clip(np.asarray(theta, dtype=float), *np.array(self._bounds).T)


def _minimize(function: Any, x0: Vector, bounds: list[tuple[float, float]], settings: NormSettings) -> Any:
    """Return the minimizer's result; a difference step sets that of the gradient, taken inside the bounds."""
    options: dict[str, Any] = {"maxiter": settings.max_iterations}
    lower, upper = np.array(bounds).T
    step = settings.difference_step * (upper - lower)

    def slope(theta: Vector) -> Any:
        return scipy.optimize.approx_fprime(theta, function, np.where(theta + step > upper, -step, step))

    gradient = slope if settings.difference_step else None
    if settings.minimizer == "ipopt":
        from cyipopt import minimize_ipopt  # optional

        options |= {"print_level": 0, "sb": "yes"}
        return minimize_ipopt(function, x0, jac=gradient, bounds=bounds, options=options)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # trust-constr, of a gradient that does not change
        return scipy.optimize.minimize(
            function, x0, jac=gradient, bounds=bounds, method=settings.minimizer, options=options
        )


@dataclass(frozen=True)
class LeastSquaresSettings:
    """Settings of `LeastSquares`."""

    max_evaluations: int = 200
    """Evaluations in a solve, those for the Jacobian included."""
    n_starts: int = 1
    """Starting points: the last estimate, then random ones, as long as evaluations are left."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        must_be_positive(self, "max_evaluations", "n_starts", "identifiable_below")


class LeastSquares:
    """Trust-region least squares (SciPy's) on the residual vector over the window, in the unit cube.

    Branch, Coleman, Li (1999). Residuals are in standard deviations of their noise.
    """

    is_whitened = True

    def __init__(
        self,
        space: ParameterSpace,
        start: Vector,
        rng: np.random.Generator,
        settings: LeastSquaresSettings | None = None,
    ) -> None:
        self._space, self._rng, self._settings = space, rng, settings or LeastSquaresSettings()
        self.restart(start)

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,)."""
        self._z, self._information = self._space.to_unit(start), information(np.zeros((0, len(self._space))))
        self._cost, self._n_evaluations = np.inf, 0

    def solve(self, objective: Objective) -> None:
        """Minimise the sum of squares over the present samples, from each start until the evaluations are spent."""
        search = CountedResidual(self._space, objective, self._settings.max_evaluations, self._z)
        unknown = information(np.zeros((0, len(self._space))))
        seen_by_data, converged = unknown, np.inf
        starts = [self._z, *self._rng.random((self._settings.n_starts - 1, len(self._space)))]
        beside = one_at_a_time(self._z, _BESIDE)
        while starts:
            z = starts.pop(0)
            try:
                result = scipy.optimize.least_squares(
                    search.residual, np.clip(z, 0.0, 1.0), jac=cast(Any, search.differences), bounds=(0.0, 1.0)
                )
            except SpentError:
                break
            except NoValueError:  # one that is near may have one
                starts += beside
                beside = []
                continue
            if 2.0 * result.cost <= search.cost * (1.0 + 1e-9):
                misfit = max(1.0, np.sqrt(2.0 * result.cost / max(len(result.fun) - len(z), 1)))
                seen_by_data, converged = information(result.jac / misfit), search.cost
        is_converged = search.cost >= converged * (1.0 - 1e-9)
        self._z, self._cost, self._information = search.z, search.cost, seen_by_data if is_converged else unknown
        self._n_evaluations += objective.n_evaluations

    def estimate(self) -> Estimate:
        """Return the best candidate of the last solve."""
        return scaled_estimate(
            self._space, self._z, self._information.std(), self._settings.identifiable_below, self._information,
            cost=self._cost, n_evaluations=self._n_evaluations, reason="least squares",
        )  # fmt: skip
