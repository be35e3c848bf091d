"""Profile likelihood: how far a parameter can move if all others follow as well as they can.

Raue et al. (2009), "Structural and practical identifiability analysis of partially observed dynamical models by
exploiting the profile likelihood", Bioinformatics 25(15).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..space import ParameterSpace, Vector
from .evaluated import CubeResidual, Evaluated, Residual
from .fit import OfflineFit
from .robust_loss import ShrunkResidual

LIMIT: Final = 3.841
"""Rise of the sum of squares, in variances, at the ends of a 95 % interval: chi squared with one degree of freedom."""
_FLAT: Final = 1.0
"""Rise up to both bounds below which a profile is flat."""
_POINTS: Final = 40
"""Largest number of points to one side, those that went too far included."""
_CORRECTIONS: Final = 5
"""Largest number of steps of the other parameters at a point."""
_TOO_FAR: Final = 4.0
"""Rise from point to point beyond which the distance is halved."""
_NEAR: Final = 1e-6
"""Least distance of two points, of the scaled bounds."""
_FAR: Final = 0.1
"""Largest distance of two points, of the scaled bounds."""


@dataclass(frozen=True)
class Profile:
    """Least sum of squares by the value of one parameter, all others fitted anew."""

    values: Vector
    """Values (n,) of the parameter, increasing."""
    rise: Vector
    """Rise (n,) of the sum of squares, or of the loss, from its least, in variances of the correlated residuals."""
    lower: float | None
    """Lower end of the 95 % interval; None: open to the bound."""
    upper: float | None
    """Upper end of the 95 % interval; None: open to the bound."""
    lower_set_by: tuple[int, ...]
    """Numbers of the other parameters whose bounds set the lower end: up to these they make up for any value."""
    upper_set_by: tuple[int, ...]
    """The same of the upper end."""

    @property
    def is_identifiable(self) -> bool:
        """True where the data end the 95 % interval on both sides, not bounds, its own or others'."""
        is_closed = self.lower is not None and self.upper is not None
        return is_closed and not self.lower_set_by and not self.upper_set_by

    @property
    def is_flat(self) -> bool:
        """True where the others make up for any value: structurally unidentifiable, as far as these data show."""
        return self.lower is None and self.upper is None and float(self.rise.max()) < _FLAT


def profile(residual: Residual, space: ParameterSpace, fit: OfflineFit, j: int) -> Profile:
    """Return the profile of parameter j near a fit, point by point to both sides, until the limit or the bound.

    Under a loss its rise has the same limit in units of E[psi^2] / E[psi']: Ronchetti (1982), the tau test.
    """
    seen = CubeResidual(ShrunkResidual(residual, fit.loss), space, lambda n, cost: None)
    unit = (fit.misfit * float(fit.inflation[j])) ** 2 * fit.curvature
    start = Evaluated(fit.place, fit.residual)
    sides = [list(_side(seen, start, fit, j, sign, unit)) for sign in (-1.0, 1.0)]
    row = [*reversed(sides[0]), start, *sides[1]]
    costs = np.array([one.cost for one in row])
    rise = (costs - costs.min()) / unit
    values = np.array([space.from_unit(one.z)[j] for one in row])
    least = int(np.argmin(costs))
    is_at_bound = np.array([(one.z <= 0.0) | (one.z >= 1.0) for one in row])
    is_at_bound[:, j] = False
    ways = slice(least, None, -1), slice(least, None)
    lower, upper = (_crossing(values[way], rise[way]) for way in ways)
    return Profile(values, rise, lower, upper, *(_set_by(is_at_bound[way], rise[way]) for way in ways))


def _side(
    seen: CubeResidual, start: Evaluated, fit: OfflineFit, j: int, sign: float, unit: float
) -> Iterator[Evaluated]:
    """Yield points from the fit outwards, until the limit is passed, the bound is met or the evaluation fails."""
    place, jacobian = start, fit.jacobian
    width = float(np.clip(0.5 * fit.information.std()[j], 1e-6, _FAR))
    for _ in range(_POINTS):
        target = float(np.clip(place.z[j] + sign * width, 0.0, 1.0))
        if target == place.z[j]:
            return
        there, slopes = _follow(seen, place, jacobian, j, target, unit)
        rise, gain = there.cost - start.cost, there.cost - place.cost
        if gain > _TOO_FAR * unit and width > _NEAR:  # too far to tell where the limit was passed
            width *= 0.5
            continue
        if not np.isfinite(there.cost):
            return
        yield there
        if rise > LIMIT * unit:
            return
        place, jacobian = there, slopes
        if gain < 0.5 * unit:
            width = min(1.5 * width, _FAR)


def _follow(
    seen: CubeResidual, place: Evaluated, jacobian: Vector, j: int, target: float, unit: float
) -> tuple[Evaluated, Vector]:
    """Return the least sum of squares with parameter j at target, and the Jacobian updated by what was evaluated.

    Gauss-Newton steps of the others; each evaluation corrects the Jacobian along its step: Broyden (1965).
    """
    z = place.z.copy()
    z[j] = target
    others = np.arange(len(z)) != j
    z[others] -= np.linalg.pinv(jacobian[:, others], rcond=1e-7) @ jacobian[:, j] * (target - place.z[j])
    best: Evaluated | None = None
    last = place
    for _ in range(_CORRECTIONS):
        (trial,) = seen.many([np.clip(z, 0.0, 1.0)])
        if not np.isfinite(trial.cost):
            return best or trial, jacobian
        step = trial.z - last.z
        if (size := float(step @ step)) > 0.0:
            jacobian = jacobian + np.outer((trial.r - last.r - jacobian @ step) / size, step)
        gain = np.inf if best is None else best.cost - trial.cost
        best, last = (trial if gain > 0.0 else best), trial
        if not len(z) > 1 or abs(gain) < 0.02 * unit:
            break
        z = trial.z.copy()
        z[others] -= np.linalg.pinv(jacobian[:, others], rcond=1e-7) @ trial.r
    return best or last, jacobian


def _set_by(is_at_bound: NDArray[np.bool_], rise: Vector) -> tuple[int, ...]:
    """Return the parameters that meet their bounds while the profile is still flat, and stay there up to the limit.

    is_at_bound: (n, d); rise: (n,), from the least outwards.
    """
    beyond = np.flatnonzero(rise > LIMIT)
    if not len(beyond):
        return ()
    free = [np.flatnonzero(~column) for column in is_at_bound[: beyond[0] + 1].T]
    last = [int(within[-1]) if len(within) else int(beyond[0]) for within in free]
    return tuple(k for k, i in enumerate(last) if i < beyond[0] and rise[i] < _FLAT)


def _crossing(values: Vector, rise: Vector) -> float | None:
    """Return the value at which the root of the rise, nearly straight, passes that of the limit; None if it does not.

    values, rise: (n,), from the least outwards.
    """
    beyond = np.flatnonzero(rise > LIMIT)
    if not len(beyond) or beyond[0] == 0:
        return None
    i, roots = int(beyond[0]), np.sqrt(np.maximum(rise, 0.0))
    share = (np.sqrt(LIMIT) - roots[i - 1]) / (roots[i] - roots[i - 1])
    return float(values[i - 1] + share * (values[i] - values[i - 1]))
