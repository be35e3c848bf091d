"""Target-vector Bayesian optimisation: a GP for the residual vector, minimising its squared norm."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # its stats, which takes 0.3 s, is loaded when it is used
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from .acquisition import log_target_vector_improvement
from .contract import Estimate, NoEstimateError, scaled_estimate
from .gaussian_process import Posterior
from .identifiability import IDENTIFIABLE_BELOW, Information, information
from .search import best_that_differ, least_change, least_squares_of_mean, one_at_a_time, principal_components
from .space import ParameterSpace, Vector
from .surrogate import VectorSurrogate

_FAR = 50.0
"""Root mean square residual [standard deviations] above which old candidates, which lie where the optimum was, tell
little of the slopes: they are learnt anew."""
_MOST = 128
"""Candidates that are remembered, and judged anew at each sample, however long an episode lasts."""
_APART = 3e-4
"""Of the unit cube: distance between candidates that are asked for at once; nearer ones tell the same."""
_LOCAL_RADII = np.repeat([[0.2], [0.05], [0.01], [0.002]], 16, axis=0)
"""Of the unit cube: standard deviation of each candidate drawn round the incumbent."""
_SAME = 0.003
"""Of the unit cube: a candidate this near to where held directions lead, in each parameter, stands for it."""
_NEAR_RADII = np.repeat([[0.003], [0.0005]], 8, axis=0)
"""The same round the minimiser of the surrogate's mean."""


@dataclass(frozen=True)
class TargetSettings:
    """Settings of `TargetVector`; the defaults suit two to ten parameters."""

    initial_step: float = 0.2
    """Share of the scaled bounds, divided by d, by which each parameter is moved, alone, to learn the slopes."""
    n_modelled: int | None = None
    """Number of best candidates that the surrogate is fitted to, beside the newest d, and that are kept for the next
    episode; by default 3 d + 2. More would only distort it and slow it down."""
    n_outputs: int = 10
    """Number of principal components of the residual, at most, that are modelled by a GP."""
    significance: float = 3.0
    """Standard deviations by which the data must ask for a change in a direction; else that direction is held."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        for name in ("n_outputs", "significance", "identifiable_below"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}.")
        if not 0.0 < self.initial_step <= 1.0:
            raise ValueError(f"initial_step must be in (0, 1], got {self.initial_step}.")
        if self.n_modelled is not None and self.n_modelled < 2:
            raise ValueError(f"n_modelled must be at least 2, got {self.n_modelled}.")


class TargetVector:
    """Models the residual vector, not its norm, so that a small residual is not hidden by a large one.

    The residuals of n candidates (n, D) are projected on their principal components; each gets a GP of the common
    lengthscales, and the next candidate maximises the expected improvement of the sum of squares. On a smooth
    residual the posterior mean is followed like Gauss-Newton's model, on any other it explores.

    Uhrenholt and Jensen (2019), "Efficient Bayesian optimization for target vector estimation";
    Astudillo and Frazier (2019), "Bayesian optimization of composite functions".
    Residuals are in standard deviations of their noise.
    """

    is_whitened = True

    def __init__(
        self, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: TargetSettings | None = None
    ) -> None:
        self._space, self._rng, self._settings = space, rng, settings or TargetSettings()
        d = len(space)
        self._step = self._settings.initial_step / max(d, 2)
        self._n_modelled = self._settings.n_modelled or 3 * d + 2
        self._global = scipy.stats.qmc.Sobol(d, rng=rng).random(128)
        self._surrogate = VectorSurrogate(d)
        self._theta = np.empty((0, d))
        self._residuals: Vector | None = None
        self._model_now: _Model | None = None
        self._asks_since_fit = 0
        self.restart(start)

    @property
    def candidates(self) -> Vector:
        """Stored candidates (n, d), in the parameters' units."""
        return self._theta

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,): keep the first candidates, the best ones, and what GPs have learnt."""
        self._start = self._space.to_unit(start)
        self._n_evaluations = 0
        self._queue = [self._start]
        self._failed = np.empty((0, len(self._start)))
        self._forget()
        self._model_now = None

    def ask(self) -> Vector:
        """The initial design first, then the candidate of largest expected improvement.

        Where nothing is to be gained, directions are to be held, and nobody knows whether that explains the data, it is
        tried.
        """
        if self._queue:
            return self._space.from_unit(self._queue.pop(0))
        if self._residuals is None:  # every candidate has failed
            return self._space.from_unit(self._rng.random(len(self._space)))
        return self._space.from_unit(self._most_promising(self._fitted()))

    def ask_many(self, n: int) -> list[Vector]:
        """Candidates to be judged at the same time: of the initial design, else each as if those before it had turned
        out as the surrogate expects (the kriging believer of Ginsbourger, Le Riche, Carraro (2010))."""
        if self._queue or self._residuals is None:
            return [self.ask() for _ in range(min(n, max(len(self._queue), 1)))]
        model, places = self._fitted(), list[Vector]()
        for _ in range(n):
            places.append(self._most_promising(model, places))
            Z, mean = np.vstack([model.Z, places[-1]]), model.posterior.predict(places[-1][None])[0]
            Y = np.vstack([model.Y, mean])
            model = _Model(Z, Y, np.sum(Y * Y, axis=1), self._surrogate.condition(Z, Y))
        return [self._space.from_unit(z) for z in places]

    def tell(self, theta: Vector, residual: Vector) -> None:
        """The residual (D,) of a candidate. Where a non-finite one is nearest, nothing is asked in this episode."""
        self._n_evaluations += 1
        if not np.all(np.isfinite(residual)):
            self._failed = np.vstack([self._failed, self._space.to_unit(theta)])
            return
        told = np.atleast_2d(np.asarray(residual, dtype=float))
        is_known = len(self._theta) > len(theta) and _is_near(residual)
        if self._residuals is None or (self._n_evaluations == 1 and not is_known):
            self._queue = one_at_a_time(self._space.to_unit(theta), self._step)
        self._theta = np.vstack([self._theta, theta])
        self._residuals = told if self._residuals is None else np.vstack([self._residuals, told])
        if len(self._theta) > _MOST:
            self._forget()
        self._model_now = None

    def rescore(self, residuals: Vector) -> None:
        """Replace what was told of the stored candidates by residuals (n, D); failed candidates are dropped."""
        if not len(self._theta):
            return
        was_near = self._residuals is not None and _is_near(self._residuals[int(np.argmin(self._costs()))])
        finite = np.all(np.isfinite(residuals), axis=1)
        self._theta, self._residuals = self._theta[finite], residuals[finite]
        self._model_now = None
        if not len(self._theta):
            self._residuals = None
            return
        best = int(np.argmin(self._costs()))
        if was_near and not self._queue and not _is_near(self._residuals[best]):  # the truth has jumped
            self._queue = one_at_a_time(self._space.to_unit(self._theta[best]), self._step)
        if len(self._theta) > _MOST:
            self._forget()

    def estimate(self) -> Estimate:
        """The best candidate, with the directions that the data do not see held at the episode's start.

        std is the root mean square error: beside the data's own deviation it has how far the estimate is from the least
        squares of the linearised mean, because candidates are finite or because directions are held.
        """
        hold = self._hold(self._model())
        if not hold.n_held:
            z, cost, reason = hold.best, hold.least, "incumbent"
        else:
            z, cost = (hold.place, hold.expected) if hold.is_sure else self._nearest_that_fits(hold)
            reason = f"incumbent, {hold.n_held} of {len(z)} directions held"
        std = np.minimum(np.hypot(hold.information.std(), hold.least_squares - z), 1.0)
        return scaled_estimate(
            self._space, z, std, self._settings.identifiable_below, hold.information,
            cost=cost, n_evaluations=self._n_evaluations, reason=reason,
        )  # fmt: skip

    def _hold(self, model: "_Model") -> "_Hold":
        """Which of the best candidate's changes the data ask for, and where that leads."""
        best = int(np.argmin(model.costs))
        z, least = model.Z[best], float(model.costs[best])
        misfit = max(1.0, np.sqrt(least / max(self._told().shape[1] - len(z), 1)))
        mean, jacobian = model.posterior.mean_and_jacobian(z)
        seen_by_data = information(jacobian / misfit)
        least_squares = z + seen_by_data.step(jacobian.T @ mean / misfit**2)
        moved = seen_by_data.significant(z - self._start, self._settings.significance)
        place, expected = z, least
        if len(moved) < len(z):
            place = self._start
            if len(moved):
                place = least_change(model.posterior, place + moved.T @ moved @ (z - place), len(moved))
            mean, variance = model.posterior.predict(place[None])
            expected = float(np.sum(mean * mean + variance))
        allowed = least + (self._settings.significance * misfit) ** 2
        return _Hold(z, least, seen_by_data, least_squares, len(z) - len(moved), place, expected, allowed)

    def _nearest_that_fits(self, hold: "_Hold") -> tuple[Vector, float]:
        """Of the candidates that cost no more than allowed the one nearest to the start, and its cost."""
        costs = self._costs()
        fitting = np.flatnonzero(costs <= max(hold.allowed, float(costs.min())))
        Z = self._space.to_unit(self._theta[fitting])
        nearest = int(np.argmin(np.sum((Z - self._start) ** 2, axis=1)))
        return Z[nearest], float(costs[fitting[nearest]])

    def _is_to_be_tried(self, hold: "_Hold") -> bool:
        """Whether directions are to be held, and neither the surrogate nor a candidate tells that it can be done."""
        if not hold.n_held or hold.is_sure:
            return False
        if len(self._failed) and np.abs(self._failed - hold.place).max(axis=1).min() < _SAME:
            return False
        return bool(np.abs(self._nearest_that_fits(hold)[0] - hold.place).max() >= _SAME)

    def _forget(self) -> None:
        """Keep the first candidates, the best that differ, and the newest."""
        if self._residuals is not None:
            first = min(len(self._start) + 1, len(self._theta))
            kept = np.concatenate([np.arange(first), first + self._modelled(self._residuals[first:])])
            self._theta, self._residuals = self._theta[kept], self._residuals[kept]

    def _told(self) -> Vector:
        if self._residuals is None:
            raise NoEstimateError("no candidate has succeeded yet: tell the residual of one first.")
        return self._residuals

    def _costs(self) -> Vector:
        return np.sum(self._told() ** 2, axis=1)

    def _model(self) -> "_Model":
        if self._model_now is None:
            chosen = self._modelled(self._told())
            Z = self._space.to_unit(self._theta[chosen])
            Y = principal_components(self._told()[chosen], self._settings.n_outputs)
            self._model_now = _Model(Z, Y, self._costs()[chosen], self._surrogate.condition(Z, Y))
        return self._model_now

    def _fitted(self) -> "_Model":
        """The model, its lengthscales refitted every few asks."""
        self._asks_since_fit += 1
        if self._asks_since_fit >= max(2, len(self._theta) // 5):
            model = self._model()
            self._surrogate.fit(model.Z, model.Y)
            self._model_now, self._asks_since_fit = None, 0
        return self._model()

    def _most_promising(self, model: "_Model", others: Sequence[Vector] = ()) -> Vector:
        """The place (d,) of largest expected improvement, away from the others that are asked for with it."""
        costs = np.sum(model.Y * model.Y, axis=1)
        best = int(np.argmin(costs))
        pool = self._hopeful(self._pool(model.posterior, model.Z[best]), model.Z)
        if others:
            apart = pool[cdist(pool, np.array(others)).min(axis=1) > _APART]
            pool = apart if len(apart) else pool
        gain = log_target_vector_improvement(*model.posterior.predict(pool), max(float(costs[best]), 1e-12))
        if gain.max() < 0.0 and not others:  # less than a standard deviation is to be gained
            hold = self._hold(model)
            if self._is_to_be_tried(hold):
                return hold.place
        return pool[int(np.argmax(gain))]

    def _modelled(self, residuals: Vector) -> NDArray[np.intp]:
        """Places, in the order of telling, of the best candidates that differ and the newest: failures teach too."""
        newest = np.arange(len(residuals))[-len(self._start) :]
        return np.union1d(np.array(best_that_differ(residuals, self._n_modelled), dtype=np.intp), newest)

    def _hopeful(self, pool: Vector, Z: Vector) -> Vector:
        """Those of the pool that lie nearer to a candidate in Z (n, d) than to one that failed; all, if none does."""
        if not len(self._failed):
            return pool
        hopeful = pool[cdist(pool, Z).min(axis=1) <= cdist(pool, self._failed).min(axis=1)]
        return hopeful if len(hopeful) else pool

    def _pool(self, posterior: Posterior, best: Vector) -> Vector:
        """Candidates to choose from: all over the cube, round the incumbent, and round the mean's minimiser."""
        d = len(best)
        minimiser = least_squares_of_mean(posterior, best)
        draws = self._rng.standard_normal((len(_LOCAL_RADII) + len(_NEAR_RADII), d))
        local, near = draws[: len(_LOCAL_RADII)], draws[len(_LOCAL_RADII) :]
        pool = np.vstack([self._global, best + _LOCAL_RADII * local, minimiser, minimiser + _NEAR_RADII * near])
        return np.minimum(np.maximum(pool, 0.0), 1.0)


def _is_near(residual: Vector) -> bool:
    return float(residual @ residual) <= _FAR**2 * len(residual)


class _Model(NamedTuple):
    """The surrogate of the best of what has been told so far."""

    Z: Vector
    """Candidates (n, d), in the unit cube."""
    Y: Vector
    """Their residuals' principal components (n, k)."""
    costs: Vector
    """Their sums of squared residuals (n,)."""
    posterior: Posterior


class _Hold(NamedTuple):
    """What of the best candidate's change from the start the data ask for; the rest is held. Places (d,): unit cube."""

    best: Vector
    """The best candidate."""
    least: float
    """Its sum of squared residuals."""
    information: Information
    """There, in standard deviations of the misfit."""
    least_squares: Vector
    """Where the linearised mean is least: may lie outside the cube."""
    n_held: int
    """Number of directions that are held."""
    place: Vector
    """Where holding them leads; the best candidate where none is held."""
    expected: float
    """Sum of squared residuals that the surrogate expects there, its variances included."""
    allowed: float
    """More than this holding must not cost."""

    @property
    def is_sure(self) -> bool:
        """Whether the surrogate tells that the place explains the data."""
        return self.expected <= self.allowed
