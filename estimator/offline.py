"""Offline fit of parameters to residuals: an estimator's search, then Gauss-Newton steps to the minimum.

Returns the standard deviation of each parameter there too. Independent of logs and FMUs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import numpy as np
import scipy  # its stats, which takes 0.3 s, is loaded when it is used

from .contract import AskTell
from .identifiability import IDENTIFIABLE_BELOW, Information, information
from .methods import METHODS
from .space import ParameterSpace, Vector

OFFLINE: Final = ("target", "least-squares", "multi-start")
"""Methods for a whole log: those that take residual vectors in standard deviations."""
_UNSEEN: Final = 0.3
"""Standard deviation, as a share of the cube, above which the data do not determine a direction."""
_EXPLAINED: Final = 2.0
"""Root mean square residual [standard deviations of the noise] below which the search is not started again."""
_ROUNDS: Final = 8
"""Largest number of Gauss-Newton steps."""
_DAMPINGS: Final = (1e-2, 1e2, 1e4, 1e6)
"""Dampings of the Gauss-Newton steps tried together, in variances of the misfit."""
FitProgress = Callable[[int, float], None]
"""Function called with the evaluations so far and the least sum of squares."""


class Residual(Protocol):
    """Residuals (D,) of theta (d,), in standard deviations of the noise; NaN where there are none."""

    @property
    def n_evaluations(self) -> int: ...
    def __call__(self, theta: Vector) -> Vector: ...
    def many(self, thetas: Sequence[Vector]) -> list[Vector]: ...


class NoFitError(RuntimeError):
    """Raised when no candidate could be evaluated."""


@dataclass(frozen=True)
class OfflineFit:
    """Fitted values of the parameters, with their standard deviations."""

    theta: Vector
    """Values (d,), in each parameter's unit."""
    std: Vector
    """Standard deviations (d,), s^2 (J^T J)^-1; as wide as the bounds where the data say nothing."""
    misfit: float
    """s: root mean square residual, D - d degrees of freedom, in standard deviations of the noise."""
    autocorrelation: float
    """Correlation of the residuals from one row to the next."""
    information: Information
    """Sensitivity in the unit cube, in standard deviations of the misfit."""
    place: Vector
    """Place of theta in the unit cube (d,)."""

    @property
    def is_identifiable(self) -> tuple[bool, ...]:
        """True where the data determine the parameter (d,)."""
        return tuple(bool(s <= IDENTIFIABLE_BELOW) for s in self.information.std())

    @property
    def inflation(self) -> float:
        """Factor by which correlated residuals widen the standard deviations, sqrt((1 + a)/(1 - a)).

        For a first-order process: Bartlett (1946).
        """
        a = min(max(self.autocorrelation, 0.0), 0.999)
        return float(np.sqrt((1.0 + a) / (1.0 - a)))


@dataclass(frozen=True)
class _State:
    """Place in the unit cube, and the residuals there."""

    z: Vector
    r: Vector

    @property
    def cost(self) -> float:
        return float(self.r @ self.r) if np.all(np.isfinite(self.r)) else np.inf


def fit(
    residual: Residual,
    space: ParameterSpace,
    nominal: Vector,
    method: str = "target",
    n_evaluations: int = 60,
    rng: np.random.Generator | None = None,
    progress: FitProgress = lambda n, cost: None,
) -> OfflineFit:
    """Return the parameters that explain the data best.

    A third of the evaluations, at most ten a parameter, are spread over the bounds; the estimator continues from the
    best, and where it stops with residuals of twice the noise or more, it starts again from the next best.
    Gauss-Newton steps with central differences, not counted in n_evaluations, lead to the minimum. Directions that
    the data do not determine go back to nominal (d,) where that costs less than a standard deviation.
    Raises NoFitError where none of the places spread over the bounds can be evaluated.
    """
    rng = rng or np.random.default_rng(0)
    seen = _Best(residual, space, progress)
    n_scouts = min(n_evaluations // 3, 10 * len(space))
    scouts = scipy.stats.qmc.Halton(len(space), rng=rng).random(n_scouts)
    scouted = seen.many([space.to_unit(nominal), *scouts])
    for start in sorted(scouted, key=lambda state: state.cost):
        if not np.isfinite(start.cost) or seen.n_evaluations >= n_evaluations:
            break
        _search(seen, start.z, method, space, n_evaluations, rng)
        if seen.best is not None and _misfit(seen.best, len(space)) < _EXPLAINED:
            break
    state, misfit, jacobian = _descend(seen, len(space))
    seen_by_data = _information(jacobian, misfit)
    held = _held(seen, state, seen_by_data, space.to_unit(nominal), misfit)
    if held is not state:
        state = held
        misfit = _misfit(state, len(space))
        seen_by_data = _information(_jacobian(seen, state, _steps(jacobian, misfit)), misfit)
    theta = space.from_unit(state.z)
    power = float(state.r @ state.r)
    return OfflineFit(
        theta=theta,
        std=seen_by_data.std() * space.slope(theta),
        misfit=misfit,
        autocorrelation=float(state.r[1:] @ state.r[:-1]) / power if power else 0.0,
        information=seen_by_data,
        place=state.z,
    )


class _Best:
    """Residuals over the unit cube; remembers the best place."""

    difference_step = None
    max_evaluations = np.inf

    def __init__(self, residual: Residual, space: ParameterSpace, progress: FitProgress) -> None:
        self._residual, self._space, self._progress = residual, space, progress
        self.best: _State | None = None

    @property
    def n_evaluations(self) -> int:
        return self._residual.n_evaluations

    def many(self, places: Sequence[Vector]) -> list[_State]:
        """Return the states at places (d,)."""
        residuals = self._residual.many([self._space.from_unit(z) for z in places])
        states = [_State(np.asarray(z, dtype=float), r) for z, r in zip(places, residuals, strict=True)]
        for state in states:
            if np.isfinite(state.cost) and (self.best is None or state.cost < self.best.cost):
                self.best = state
        self._progress(self.n_evaluations, self.best.cost if self.best else np.inf)
        return states

    def at(self, theta: Vector) -> _State:
        """Return the state at theta (d,)."""
        return self.many([self._space.to_unit(theta)])[0]

    def residual(self, theta: Vector) -> Vector:
        """Return the residual (D,) at theta (d,), for solvers."""
        return self.at(theta).r

    def residuals(self, thetas: Sequence[Vector]) -> list[Vector]:
        """Return the residual (D,) at each theta (d,)."""
        return [self.residual(theta) for theta in thetas]


def _search(seen: _Best, z: Vector, method: str, space: ParameterSpace, n_evaluations: int, rng: Any) -> None:
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
        enough = max(_misfit(state, len(space)), 1.0) ** 2 if np.isfinite(state.cost) else 0.0
        idle, least = (0, state.cost) if state.cost < least - enough else (idle + 1, least)


def _descend(seen: _Best, d: int) -> tuple[_State, float, Vector]:
    """Return the minimum near the best place, the misfit there, and the Jacobian (D, d) in the unit cube.

    Of several dampings the best is taken: Levenberg (1944), Marquardt (1963). Differences are
    taken over about the standard deviation that each parameter alone would have.
    """
    state = seen.best
    if state is None:
        raise NoFitError
    steps = np.full(d, 1e-3)
    jacobian = _jacobian(seen, state, steps)
    for _ in range(_ROUNDS):
        misfit = _misfit(state, d)
        finer = _steps(jacobian, misfit)
        if np.any(np.abs(np.log(finer / steps)) > 1.1):
            steps = finer
            jacobian = _jacobian(seen, state, steps)
        trial = min(_trials(seen, state, jacobian, misfit), key=lambda s: s.cost)
        gain = state.cost - trial.cost
        if gain <= 0.0:
            break
        state = trial
        jacobian = _jacobian(seen, state, steps)
        if gain < 1e-3 * misfit**2:
            break
    return state, _misfit(state, d), jacobian


def _trials(seen: _Best, state: _State, jacobian: Vector, misfit: float) -> list[_State]:
    """Return the states after steps of different damping, in the parameters that no bound stops."""
    slope = jacobian.T @ state.r
    is_free = ~(((state.z <= 0.0) & (slope > 0.0)) | ((state.z >= 1.0) & (slope < 0.0)))
    trials: list[Vector] = []
    if np.any(is_free):
        U, s, directions = np.linalg.svd(jacobian[:, is_free], full_matrices=False)
        for damping in _DAMPINGS:
            step = np.zeros(len(state.z))
            step[is_free] = -directions.T @ (s / (s * s + damping * misfit**2) * (U.T @ state.r))
            trials.append(np.clip(state.z + step, 0.0, 1.0))
    return seen.many(trials) or [state]


def _jacobian(seen: _Best, state: _State, steps: Vector) -> Vector:
    """Return d r / d z (D, d) by central differences, one-sided at a bound or beside a place that fails."""
    offsets = np.diag(steps)
    sides = seen.many(list(np.clip(np.vstack([state.z + offsets, state.z - offsets]), 0.0, 1.0)))
    columns: list[Vector] = []
    for i, (above, below) in enumerate(zip(sides[: len(steps)], sides[len(steps) :], strict=True)):
        above, below = (s if np.isfinite(s.cost) else state for s in (above, below))
        distance = above.z[i] - below.z[i]
        columns.append((above.r - below.r) / distance if distance > 0.0 else np.zeros(len(state.r)))
    return np.column_stack(columns)


def _steps(jacobian: Vector, misfit: float) -> Vector:
    """Return differences (d,) that change the residuals by about the misfit: still linear, and above rounding."""
    return np.clip(misfit / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300), 1e-6, 1e-2)


def _misfit(state: _State, d: int) -> float:
    return max(float(np.sqrt(state.cost / max(len(state.r) - d, 1))), 1e-12)


def _information(jacobian: Vector, misfit: float) -> Information:
    """Return the information from the Jacobian's triangular factor: its own left singular vectors would be (D, D)."""
    return information(np.linalg.qr(jacobian).R / misfit)


def _held(seen: _Best, state: _State, seen_by_data: Information, nominal: Vector, misfit: float) -> _State:
    """Return the state with undetermined directions back at nominal, if that costs less than a standard deviation."""
    flat = seen_by_data.directions[seen_by_data.singular_values < 1.0 / _UNSEEN]
    if not len(flat):
        return state
    (back,) = seen.many([np.clip(state.z + flat.T @ flat @ (nominal - state.z), 0.0, 1.0)])
    return back if back.cost <= state.cost + misfit**2 else state
