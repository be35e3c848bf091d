"""Offline fit of parameters to residuals: an estimator's search, then Gauss-Newton steps to the minimum.

Returns the standard deviation of each parameter there too. Independent of logs and FMUs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import scipy  # its stats, which takes 0.3 s, is loaded when it is used

from ..contract import AskTell
from ..identifiability import IDENTIFIABLE_BELOW, Information, information
from ..methods import METHODS
from ..space import ParameterSpace, Vector
from .correlated_residuals import information_of_correlated
from .descent import Descent
from .evaluated import CubeResidual, FitProgress, Residual
from .robust_loss import LinearEquivalent, Loss, ShrunkResidual, linear_equivalent
from .solver_noise import solver_noise

OFFLINE: Final = ("target", "least-squares", "multi-start")
"""Methods for a whole log: those that take residual vectors in standard deviations."""
_EXPLAINED: Final = 2.0
"""Root mean square residual [standard deviations of the noise] below which the search is not started again."""


class NoFitError(RuntimeError):
    """Raised when no candidate could be evaluated."""


@dataclass(frozen=True)
class OfflineFit:
    """Fitted values of the parameters, with their standard deviations."""

    theta: Vector
    """Values (d,), in each parameter's unit."""
    std: Vector
    """Standard deviations (d,), with the residuals' size, their correlation from row to row and the noise of start
    values; as wide as the bounds where the data say nothing."""
    white_std: Vector
    """Standard deviations (d,) if the residuals were white, s^2 (J^T J)^-1."""
    misfit: float
    """s: root mean square residual, D - d degrees of freedom, in standard deviations of the noise; under a loss that of
    psi over its mean slope."""
    autocorrelation: float
    """Correlation of the residuals from one row to the next."""
    information: Information
    """Sensitivity in the unit cube, in standard deviations of the misfit, its correlation and the start values' noise
    included."""
    place: Vector
    """Place of theta in the unit cube (d,)."""
    residual: Vector
    """Residuals (D,) at theta; under a loss their squares are the loss."""
    jacobian: Vector
    """Their slopes (D, d) in the unit cube."""
    solver_noise: float
    """Noise of the simulation's own solver: root mean square over the rows, in standard deviations of the noise."""
    loss: Loss
    """Loss whose sum is least at theta."""
    curvature: float
    """Curvature of the loss, as a share of that of the squares."""

    @property
    def is_identifiable(self) -> tuple[bool, ...]:
        """True where the data determine the parameter (d,)."""
        return tuple(bool(s <= IDENTIFIABLE_BELOW) for s in self.information.std())

    @property
    def inflation(self) -> Vector:
        """Factors (d,) by which correlated residuals and noisy start values widen the standard deviations."""
        return self.std / self.white_std


def fit(
    residual: Residual,
    space: ParameterSpace,
    nominal: Vector,
    method: str = "target",
    n_evaluations: int = 60,
    rng: np.random.Generator | None = None,
    progress: FitProgress = lambda n, cost: None,
    series: Sequence[int] = (),
    loss: Loss | None = None,
    start_noise: Callable[[Vector], Sequence[Vector]] = lambda theta: (),
) -> OfflineFit:
    """Return the parameters that explain the data best.

    A third of the evaluations, at most ten a parameter, are spread over the bounds; the estimator continues from the
    best, and where it stops with residuals of twice the noise or more, it starts again from the next best.
    Gauss-Newton steps with central differences above the noise of the solver, not counted in n_evaluations, lead to
    the minimum. Directions that the data do not determine go back to nominal (d,) where that costs less than a
    standard deviation.
    series: numbers of residuals that follow one another in time, D together; none: all do. loss: whose sum is made
    least; None: the squares. start_noise: function that returns what noisy start values do to the residual at theta
    (d,), as `information_of_correlated` takes it.
    Raises NoFitError where none of the places spread over the bounds can be evaluated.
    """
    rng, loss = rng or np.random.default_rng(0), loss or Loss()
    seen = CubeResidual(ShrunkResidual(residual, loss), space, progress)
    n_scouts = min(n_evaluations // 3, 10 * len(space))
    scouts = scipy.stats.qmc.Halton(len(space), rng=rng).random(n_scouts)
    scouted = seen.many([space.to_unit(nominal), *scouts])
    for start in sorted(scouted, key=lambda one: one.cost):
        if not np.isfinite(start.cost) or seen.n_evaluations >= n_evaluations:
            break
        _search(seen, start.z, method, space, n_evaluations, rng)
        if seen.best is not None and seen.best.misfit < _EXPLAINED:
            break
    if seen.best is None:
        raise NoFitError
    # of the residuals themselves: over its distances a loss bends far ones so much that it looks like noise
    noise = solver_noise(lambda places: residual.many([space.from_unit(z) for z in places]), seen.best.z)
    descent = Descent(seen, seen.best, noise)
    descent.hold(space.to_unit(nominal))
    place, theta = descent.place, space.from_unit(descent.place.z)
    least = LinearEquivalent(place.r, descent.jacobian, place.misfit, 1.0)
    if not loss.is_linear:
        least = linear_equivalent(loss, residual(theta), descent.jacobian)
    seen_by_data = information_of_correlated(
        least.jacobian, least.r, least.misfit, series or [len(place.r)], start_noise(theta)
    )
    white = information(np.linalg.qr(least.jacobian).R / least.misfit)
    return OfflineFit(
        theta=theta,
        std=seen_by_data.std() * space.slope(theta),
        white_std=white.std() * space.slope(theta),
        misfit=least.misfit,
        autocorrelation=float(place.r[1:] @ place.r[:-1]) / place.cost if place.cost else 0.0,
        information=seen_by_data,
        place=place.z,
        residual=place.r,
        jacobian=descent.jacobian,
        solver_noise=noise / np.sqrt(len(place.r)),
        loss=loss,
        curvature=least.curvature,
    )


def _search(seen: CubeResidual, z: Vector, method: str, space: ParameterSpace, n_evaluations: int, rng: Any) -> None:
    """Run the estimator of that name from z (d,) while it improves and evaluations are left."""
    known = METHODS[method]
    settings = known.settings()
    if method != "target":
        settings = replace(settings, **known.defaults, max_evaluations=n_evaluations - seen.n_evaluations)
    made: Any = known.estimator(space, space.from_unit(z), rng, settings)
    if not isinstance(made, AskTell):
        made.solve(seen)  # which counts and evaluates like an Objective
        return
    patience, idle, least = 3 * len(space) + 6, 0, np.inf
    while seen.n_evaluations < n_evaluations and idle < patience:
        theta = made.ask()
        state = seen.at(theta)
        made.tell(theta, state.r)
        enough = max(state.misfit, 1.0) ** 2 if np.isfinite(state.cost) else 0.0
        idle, least = (0, state.cost) if state.cost < least - enough else (idle + 1, least)
