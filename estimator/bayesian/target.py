"""Target-vector Bayesian optimisation: a GP for the residual vector, minimising its squared norm."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..contract import Estimate, scaled_estimate
from ..hypotheses import USUAL_RATE
from ..identifiability import IDENTIFIABLE_BELOW
from ..parameter_filter import ParameterFilter
from ..positive import must_be_positive
from ..significance import FALSE_ALARM, chi2_limit
from ..space import ParameterSpace, Vector, one_at_a_time
from .acquisition import log_target_vector_improvement
from .candidates import Candidates, has_cost, is_near
from .gpy_surrogate import Surrogate, vector_surrogate
from .hold import Hold, Model, hold_directions
from .kernels import OwnKernel, check_kernel
from .leap import Leap, leap
from .search import VectorPosterior, least_squares_of_mean, principal_components
from .sobol import sobol_points

_APART = 3e-4
"""Distance in the unit cube between candidates of one batch; nearer ones are equivalent."""
_LOCAL_RADII = np.repeat([[0.2], [0.05], [0.01], [0.002]], 16, axis=0)
"""Standard deviation in the unit cube of each candidate drawn around the incumbent."""
_SAME = 0.003
"""Distance in the unit cube, a parameter, below which a candidate stands for the place with directions held."""
_NEAR_RADII = np.repeat([[0.003], [0.0005]], 8, axis=0)
"""Standard deviation in the unit cube of each candidate drawn around the minimiser of the surrogate's mean."""
_SURE = 0.01
"""Variance of what the surrogate expects, as a share of the least sum of squares, up to which it is sure."""
_MAJORITY = 15
"""Residuals a parameter above which those that fit outvote a few that do not."""
_AT_BOUND = 0.01
"""Distance from a bound, in the unit cube, that is none."""
_N_OUTPUTS = 10
"""Number of principal components that are modelled, of no more parameters than that."""
_LITTLE = float(np.log(0.1**2))
"""Logarithm of an expected decrease of the sum of squares that is not worth an evaluation."""


@dataclass(frozen=True)
class TargetSettings:
    """Settings of `TargetVector`; the defaults suit up to some twenty parameters."""

    initial_step: float = 0.2
    """Share of the scaled bounds, divided by d, by which each parameter is moved, alone, to find the slopes."""
    n_modelled: int | None = None
    """Number of best candidates that the surrogate is fitted to, beside the newest d, and that are kept for the next
    episode; by default 3 d + 2. More would only distort it and slow it down."""
    n_outputs: int | None = None
    """Number of principal components of the residual, at most, that are modelled by a GP; by default 10, or d + 1
    of more parameters than that: d slopes and what no parameter explains."""
    significance: float = 3.0
    """Standard deviations by which a change in a direction must exceed zero; else that direction is held."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""
    drift: float = USUAL_RATE
    """Standard deviation of a drifting parameter's change from sample to sample, as a share of the scaled bounds: what
    is larger is a jump."""
    surrogate: Surrogate = "auto"
    """The Gaussian processes: `auto` is this package's code where it knows the kernel, which is RBF, and GPy's where
    not; `gpy` is always GPy's, several times slower."""
    kernel: str = "RBF"
    """Kernel of GPy's, by name, or a sum and product of several: "Matern52 * StdPeriodic(period=0.5) + Linear"."""

    def __post_init__(self) -> None:
        if self.kernel != "RBF":
            check_kernel(self.kernel)
        must_be_positive(self, "significance", "identifiable_below", "drift")
        if not 0.0 < self.initial_step <= 1.0:
            raise ValueError(f"initial_step must be in (0, 1], got {self.initial_step}.")
        for name, least in (("n_modelled", 2), ("n_outputs", 1)):
            n = getattr(self, name)
            if n is not None and n < least:
                raise ValueError(f"{name} must be at least {least}, got {n}.")


class TargetVector:
    """Bayesian optimisation of the residual vector, not its norm, so that a large residual does not hide a small one.

    On a smooth residual it follows the posterior mean like Gauss-Newton's model, on any other it explores. Residuals
    are in standard deviations of their noise; z (d,) is theta in the unit cube, z0 the episode's start.

    1. Evaluate z0, then d candidates that move one parameter each by initial_step / max(d, 2). Later episodes skip
       these d while |r(z0)|^2 <= 50^2 D.
    2. Take the n_modelled best candidates whose residuals differ, |r_a - r_b| >= 1, and the newest d. Their residuals
       R = U diag(s) W^T (n, D), not centred, give Y = U_k diag(s_k) (n, k): |y|^2 = |r|^2 but for noise.
    3. Give each column a GP, cov(h_j(z), h_j(z')) = q_j exp(-sum_i (z_i - z'_i)^2 / (2 l_i^2)), with common
       lengthscales l (maximum a posteriori, refitted every few candidates) and q_j = y_j^T C^-1 y_j / n.
    4. The posterior h_j ~ N(mu_j, v_j) makes S = |h(z)|^2 a weighted sum of noncentral chi-square variables, with mean
       M = sum mu_j^2 + v_j and variance V = sum 2 v_j^2 + 4 mu_j^2 v_j. Match a log-normal variable to both:
       sigma^2 = log(1 + V/M^2), nu = log M - sigma^2/2.
    5. Evaluate the candidate that maximises log E[max(b - S, 0)] = log(b Phi(c) - M Phi(c - sigma)), with
       c = (log b - nu) / sigma and b the least |y|^2, over Sobol points, normal draws around the best candidate, and
       the minimiser of |mu|^2 (Gauss-Newton) with draws around it. Where no more than the misfit is to be gained, and
       the residual is not explained, a `leap` is tried: a jump of r is nothing that h expects. Repeat from 2.
    6. Estimate: at the best candidate z, d mu/dz / misfit = U diag(s) V^T, misfit^2 = max(1, |r|^2 / (D - d)).
       Directions V_i with s_i |V_i (z - z0)| <= significance are held at z0, if the sum of squares grows by no more
       than (significance misfit)^2; else the nearest candidate to z0 within that is taken. The error is
       std_j^2 = sum_i V_ij^2 / s_i^2 + (z_ls - z)_j^2, with z_ls the linear least squares; the sum counts D - d times
       where the residual is not explained, since as much as is seen of it may lie along the slopes.

    7. Between episodes `filter` takes each sample, an extended Kalman filter, which begins at the least squares of
       the episode's samples about the estimate: see `ParameterFilter`. It follows parameters that drift; a search is
       needed after a jump only, and ends where the loop's diagnosis has followed the parameters since then
       (`followed_jump`). An episode is done when the residual is explained and the expected improvement is below a
       tenth of a standard deviation, squared.

    Usage, after which target.estimate().theta is (1.75, 0.75) to 1e-4:

        space = ParameterSpace((Parameter("m", 0.1, 5.0, "kg"), Parameter("l", 0.1, 3.0, "m")))
        target = TargetVector(space, start=np.ones(2), rng=np.random.default_rng(0))
        for m, l in (target.ask() for _ in range(20)):
            target.tell(np.array([m, l]), np.array([m * l - 1.3125, 1.0 / l - 1.0 / 0.75]) / 0.01)

    Uhrenholt and Jensen (2019), "Efficient Bayesian optimization for target vector estimation";
    Astudillo and Frazier (2019), "Bayesian optimization of composite functions".
    """

    is_whitened = True

    def __init__(
        self,
        space: ParameterSpace,
        start: Vector,
        rng: np.random.Generator,
        settings: TargetSettings | None = None,
        kernel: OwnKernel | None = None,
    ) -> None:
        """kernel: a GPy.kern.Kern, or a function of d that makes one, in the place of the settings' kernel."""
        self._space, self._rng, self._settings = space, rng, settings or TargetSettings()
        d = len(space)
        self._step = self._settings.initial_step / max(d, 2)
        self._global = sobol_points(128, d, rng)
        self._surrogate = vector_surrogate(d, self._settings.surrogate, self._settings.kernel, kernel)
        self._candidates = Candidates(space, self._settings.n_modelled or 3 * d + 2)
        self._model_now: Model | None = None
        self._asks_since_fit = 0
        self.filter = ParameterFilter(
            space, self._settings.drift, self._settings.significance, self._settings.identifiable_below
        )
        """Filter that goes on with single samples between episodes."""
        self.restart(start)

    @property
    def candidates(self) -> Vector:
        """Stored candidates (n, d), in the parameters' units."""
        return self._candidates.theta

    @property
    def model(self) -> Any:
        """A GPy model of the residual's principal components over the unit cube, each in signal standard deviations.

        New each time, so that changing it changes nothing here.
        """
        model = self._model()
        return self._surrogate.model(model.Z, model.Y)

    @property
    def is_done(self) -> bool:
        """True where the residual is explained, and nothing worth a tenth of a standard deviation is to be gained."""
        stored = self._candidates
        if self._queue or stored.is_empty or self._gain > _LITTLE:
            return False
        return float(stored.costs.min()) <= chi2_limit(FALSE_ALARM, stored.residuals.shape[1])

    def restart(self, start: Vector) -> None:
        """Begin an episode at theta (d,): keep the first candidates, the best ones, and the GPs' lengthscales."""
        self._start = self._space.to_unit(start)
        self._known: Vector | None = None  # where the episode's samples were last explained and determined everything
        self._n_evaluations = 0
        self._gain = np.inf
        self._queue = [self._start]
        self._leap: Leap | None = None  # that is being evaluated
        self._candidates.begin_episode()
        self._model_now = None

    def ask(self) -> Vector:
        """Return the next candidate: of the initial design first, then that of largest expected improvement.

        Where less than a standard deviation is to be gained, and the surrogate is not sure that the data allow the
        directions to be held, the place with these directions held is tried.
        """
        if self._queue:
            return self._space.from_unit(self._queue.pop(0))
        if self._candidates.is_empty:  # all have failed
            return self._space.from_unit(self._rng.random(len(self._space)))
        return self._space.from_unit(self._most_promising(self._fitted()))

    def ask_many(self, n: int) -> list[Vector]:
        """Return candidates to evaluate at the same time: of the initial design, else of largest expected improvement.

        Each is chosen as if those before it had turned out as the surrogate expects (the kriging believer of
        Ginsbourger, Le Riche, Carraro (2010)).
        """
        if self._queue or self._candidates.is_empty:
            return [self.ask() for _ in range(min(n, max(len(self._queue), 1)))]
        model, places = self._fitted(), list[Vector]()
        for _ in range(n):
            places.append(self._most_promising(model, places))
            Z, mean = np.vstack([model.Z, places[-1]]), model.posterior.predict(places[-1][None])[0]
            Y = np.vstack([model.Y, mean])
            model = Model(Z, Y, np.sum(Y * Y, axis=1), self._surrogate.condition(Z, Y))
        return [self._space.from_unit(z) for z in places]

    def tell(self, theta: Vector, residual: Vector) -> None:
        """Record the residual (D,) of a candidate. Places nearer to a failed, non-finite one are not proposed."""
        self._n_evaluations += 1
        stored = self._candidates
        if not has_cost(residual):
            stored.fail(theta)
            return
        has_slopes = len(stored) > len(theta) and is_near(residual)
        if stored.is_empty or (self._n_evaluations == 1 and not has_slopes):
            self._queue = one_at_a_time(self._space.to_unit(theta), self._step)
        if self._leap is not None and self._leap.has_succeeded(self._space.to_unit(theta), residual):
            stored.clear()  # what lies on the other side of the jump says little of the slopes here
            self._queue, self._leap = self._leap.about, None
        stored.add(theta, residual)
        self._model_now = None

    def rescore(self, residuals: Vector) -> None:
        """Replace the residuals of the stored candidates by residuals (n, D); failed candidates are dropped."""
        stored = self._candidates
        if not len(stored):
            return
        if self._known is not None:
            self._start, self._known = self._known, None
        was_near = stored.are_near
        stored.rescore(residuals)
        self._model_now = None
        have_jumped = was_near and not stored.is_empty and not stored.are_near  # the plant's parameters
        if have_jumped and not self._queue:
            self._queue = one_at_a_time(stored.place(stored.best), self._step)

    def estimate(self) -> Estimate:
        """Return the best candidate, with the directions that the data do not determine held.

        They are held at the episode's start, or where the samples were last explained and determined all of them.
        std is the root mean square error: the data's standard deviation, and the distance of the estimate from the
        least squares of the linearised mean, because candidates are finite or because directions are held.
        """
        held = self._hold(self._model())
        if not held.n_held:
            z, cost, reason = held.best, held.least, "incumbent"
        else:
            near = (held.place, held.expected) if held.is_sure else self._candidates.nearest(self._start, held.allowed)
            z, cost = near
            reason = f"incumbent, {held.n_held} of {len(z)} directions held"
        n_spare = self._candidates.residuals.shape[1] - len(z)
        std, away = held.information.std(), held.least_squares - z
        is_known = n_spare > 0 and bool(np.all(np.hypot(std, away) <= self._settings.identifiable_below))
        if is_known and cost <= chi2_limit(FALSE_ALARM, n_spare):
            self._known = z
        if n_spare > 1 and held.least > chi2_limit(FALSE_ALARM, n_spare):
            std *= n_spare**0.5  # of what is not explained, as much may lie along the slopes: Cauchy and Schwarz
        std = np.minimum(np.hypot(std, away), 1.0)
        return scaled_estimate(
            self._space, z, std, self._settings.identifiable_below, held.information,
            cost=cost, n_evaluations=self._n_evaluations, reason=reason,
        )  # fmt: skip

    def _hold(self, model: Model) -> Hold:
        """Return the best candidate with directions held that the samples do not determine."""
        return hold_directions(model, self._start, self._candidates.residuals.shape[1], self._settings.significance)

    def _is_to_be_tried(self, held: Hold) -> bool:
        """Return whether the place with directions held needs an evaluation: the surrogate is unsure, none was near."""
        if not held.n_held or held.is_sure or self._candidates.has_failed_near(held.place, _SAME):
            return False
        nearest, _ = self._candidates.nearest(self._start, held.allowed)
        return bool(np.abs(nearest - held.place).max() >= _SAME)

    def _model(self) -> Model:
        if self._model_now is None:
            stored = self._candidates
            chosen = stored.modelled
            Z = stored.place(chosen)
            d = Z.shape[1]
            n_outputs = self._settings.n_outputs or (_N_OUTPUTS if d <= _N_OUTPUTS else d + 1)
            Y = principal_components(stored.residuals[chosen], n_outputs)
            is_cut = Y.shape[1] == n_outputs
            self._model_now = Model(Z, Y, stored.costs[chosen], self._surrogate.condition(Z, Y), is_cut)
        return self._model_now

    def _fitted(self) -> Model:
        """Return the model, with its lengthscales refitted every few asks."""
        self._asks_since_fit += 1
        if self._asks_since_fit >= max(2, len(self._candidates) // 5):
            model = self._model()
            self._surrogate.fit(model.Z, model.Y)
            self._model_now, self._asks_since_fit = None, 0
        return self._model()

    def _most_promising(self, model: Model, others: Sequence[Vector] = ()) -> Vector:
        """Return the place (d,) of largest expected improvement, away from the others of its batch."""
        costs = np.sum(model.Y * model.Y, axis=1)
        best = int(np.argmin(costs))
        pool = self._candidates.hopeful(self._pool(model.posterior, model.Z[best]), model.Z)
        if others:
            apart = pool[scipy.spatial.distance.cdist(pool, np.array(others)).min(axis=1) > _APART]
            pool = apart if len(apart) else pool
        gain = log_target_vector_improvement(*model.posterior.predict(pool), max(float(costs[best]), 1e-12))
        self._gain = float(gain.max())
        unexpected = None if others else self._unexpected(model)
        if unexpected is not None:
            self._gain = np.inf
            return unexpected
        return pool[int(np.argmax(gain))]

    def _unexpected(self, model: Model) -> Vector | None:
        """Return the place (d,) whose evaluation decides what the surrogate does not know; None where none does.

        Where less than a standard deviation is to be gained, that is the place with directions held; else one beyond a
        jump of the model.
        """
        if self._gain < 0.0:
            held = self._hold(model)
            if self._is_to_be_tried(held):
                return held.place
        self._leap = self._possible_leap(model)
        return None if self._leap is None else self._leap.place

    def _possible_leap(self, model: Model) -> Leap | None:
        """Return a leap where the best candidate does not explain the samples, and the surrogate knows none that does.

        The surrogate has to be sure of the place; where it is not, that is for the acquisition to weigh.
        """
        residuals, best = self._candidates.residuals, model.best
        cost, n = float(model.costs[best]), residuals.shape[1]
        is_stuck = cost > chi2_limit(FALSE_ALARM, n) and self._gain <= np.log(cost / n)
        if not is_stuck or n <= _MAJORITY * len(self._start):
            return None
        chosen = residuals[self._candidates.modelled]
        _, slope = model.posterior.mean_and_jacobian(model.Z[best])
        axes = np.linalg.lstsq(model.Y, chosen)[0]  # principal components (k, D)
        found = leap(model.Z[best], chosen[best], axes.T @ slope)
        if np.any(np.abs(np.array([found.place, model.Z[best]]) - 0.5) > 0.5 - _AT_BOUND):
            return None  # it is the bound that hinders, not a jump
        _, variance = model.posterior.predict(found.place[None])
        is_new = self._candidates.is_new(found.place, _SAME)
        return found if is_new and variance.sum() < _SURE * cost else None

    def _pool(self, posterior: VectorPosterior, best: Vector) -> Vector:
        """Return candidates to choose from: over the whole cube, around the incumbent, around the mean's minimiser."""
        d = len(best)
        minimiser = least_squares_of_mean(posterior, best)
        draws = self._rng.standard_normal((len(_LOCAL_RADII) + len(_NEAR_RADII), d))
        local, near = draws[: len(_LOCAL_RADII)], draws[len(_LOCAL_RADII) :]
        pool = np.vstack([self._global, best + _LOCAL_RADII * local, minimiser, minimiser + _NEAR_RADII * near])
        return np.minimum(np.maximum(pool, 0.0), 1.0)
