"""Moving-horizon estimator on the newest samples and an arrival cost."""

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..belief import Belief, Measurement, measurement
from ..contract import Estimate, scaled_estimate
from ..differences import OfMany
from ..identifiability import IDENTIFIABLE_BELOW, information_of_covariance
from ..objective import Objective
from ..positive import must_be_positive
from ..samples import Sample
from ..space import ParameterSpace, Vector
from .counted_residual import FAILED, CountedResidual, NoValueError, SpentError
from .linearisation import Normal, identifiable_from, root_of, solved, widened

_LITTLE = 1e-3
"""Move, in standard deviations, at which the iteration ends."""
_STEP = 1e-4
"""Step of the differences of an episode's residuals, in the unit cube."""


@dataclass(frozen=True)
class MovingHorizonSettings:
    """Settings of `MovingHorizon`; lengths are shares of the scaled bounds."""

    horizon: int = 10
    """Number of newest samples whose residuals are evaluated anew; those before are in the arrival cost."""
    walk: float = 0.003
    """Standard deviation of a parameter's step from sample to sample."""
    spread: float = 0.05
    """Standard deviation of each parameter at the start."""
    iterations: int = 4
    """Largest number of Gauss-Newton steps a sample."""
    jump: float = 0.3
    """On roll-outs, standard deviation of each parameter's distance from the one in force when an episode begins."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        must_be_positive(self, "horizon", "walk", "spread", "iterations", "jump", "identifiable_below")


@dataclass(frozen=True)
class _Step:
    """Sample of the horizon, with the parameters at that time."""

    sample: Sample
    place: Vector
    """Present estimate (d,) in the unit cube."""


class MovingHorizon:
    """Moving-horizon estimator with the parameters as random walks in the unit cube.

    It minimises |z_1 - m|^2 / P + sum |r_k(z_k)|^2 + sum |z_k+1 - z_k|^2 / walk^2 over the newest samples; m and P, the
    arrival cost, are of the samples before: Rao, Rawlings, Lee (2001). A Gauss-Newton step is a Kalman smoother of
    the linearised residuals: Bell (1994), "The iterated Kalman smoother as a Gauss-Newton method". A sample that leaves
    the horizon is linearised at the newest parameters: those of its own time follow its noise, and a slope that knows
    the noise adds to the arrival cost, sample by sample, what never averages out.

    On roll-outs an episode is the horizon, of parameters that may have jumped when it began and are constant from then
    on: least squares of its residuals and of the distance from those in force, by SciPy's trust region.
    """

    is_whitened = True

    def __init__(
        self,
        space: ParameterSpace,
        start: Vector,
        rng: np.random.Generator,
        settings: MovingHorizonSettings | None = None,
    ) -> None:
        self._space, self._settings = space, settings or MovingHorizonSettings()
        self.restart(start)

    def restart(self, start: Vector) -> None:
        """Begin at theta (d,), with all samples forgotten."""
        z = self._space.to_unit(start)
        self._arrival = Belief(z, self._settings.spread**2 * np.eye(len(z)))
        self._now, self._steps = self._arrival, tuple[_Step, ...]()
        self._cost, self._n_evaluations = np.inf, 0

    def jump(self, estimate: Estimate) -> None:
        """Go on from an estimate that has its information."""
        assert estimate.information is not None
        covariance = estimate.information.covariance(self._settings.spread)
        self._arrival = Belief(self._space.to_unit(estimate.theta), covariance)
        self._now, self._steps = self._arrival, ()

    def solve(self, objective: Objective) -> None:
        """Take the newest sample, or an episode's. One sample at which the model has no value is left out."""
        if not objective.has_samples:
            self._take_episode(objective)
            return
        steps = (*self._steps, _Step(objective.newest, self._now.mean))
        if len(steps) > self._settings.horizon:
            oldest, *rest = steps
            left = self._measured(objective, replace(oldest, place=self._now.mean))
            self._arrival = self._later(_after(self._arrival, left))
            steps = tuple(rest)
        newest = self._measured(objective, steps[-1])
        self._cost = float(newest.value @ newest.value) if newest.has_value else np.inf
        for _ in range(self._settings.iterations):
            measured = [self._measured(objective, step) for step in steps]
            places, self._now = self._smoothed(measured)
            moved = np.abs(places - [step.place for step in steps])
            steps = tuple(replace(step, place=place) for step, place in zip(steps, places, strict=True))
            if np.all(moved <= _LITTLE * np.sqrt(self._now.covariance.diagonal())):
                break
        self._steps, self._n_evaluations = steps, self._n_evaluations + objective.n_evaluations

    def estimate(self) -> Estimate:
        """Return the parameters at the newest sample; cost: its sum of squared residuals at those before it."""
        known = information_of_covariance(self._now.covariance)
        below = identifiable_from(self._settings.identifiable_below, self._settings.spread)
        return scaled_estimate(
            self._space, self._now.mean, np.minimum(known.std(), 1.0), below, known,
            cost=self._cost, n_evaluations=self._n_evaluations, reason="moving-horizon estimate",
        )  # fmt: skip

    def _take_episode(self, objective: Objective) -> None:
        d, settings = len(self._space), self._settings
        prior = Normal(self._now.mean, settings.jump * np.eye(d))
        search = CountedResidual(self._space, objective, np.inf, prior.mean, settings.jump, _STEP)
        is_converged = False
        with suppress(SpentError, NoValueError):
            scipy.optimize.least_squares(
                search.residual, np.clip(prior.mean, 0.0, 1.0), jac=cast(Any, search.differences), bounds=(0.0, 1.0)
            )
            is_converged = True
        self._n_evaluations += objective.n_evaluations
        if search.linearised is None or search.cost >= FAILED:
            self._now, self._cost = Belief(prior.mean, prior.covariance), np.inf
            return
        at, r, slopes = search.linearised
        precision = slopes.T @ slopes
        z, residual = search.z, search.least
        step = solved(precision, slopes.T @ r)  # the last one, below SciPy's tolerance
        if is_converged and np.all((at > step) & (at < 1.0 + step)):
            z, residual = at - step, r - slopes @ step
        now, self._cost = widened(Normal(z, root_of(solved(precision, np.eye(d)))), prior, residual[:-d])
        self._now = Belief(now.mean, now.covariance)

    def _later(self, known: Belief) -> Belief:
        """Return a belief one sample later, with parameters that walk."""
        return known.walked(np.full(len(known.mean), self._settings.walk**2))

    def _measured(self, objective: Objective, step: _Step) -> Measurement:
        with np.errstate(all="ignore"):  # where the model overflows
            at = OfMany(lambda z: objective.residual_at(self._space.from_unit(z), step.sample))
            return measurement(at, step.place)

    def _smoothed(self, measured: list[Measurement]) -> tuple[Vector, Belief]:
        """Return the most likely places (n, d) of the linearised residuals, and the belief at the newest sample."""
        before, after = [self._arrival], list[Belief]()
        for found in measured:
            after.append(_after(before[-1], found))
            before.append(self._later(after[-1]))
        places = [after[-1].mean]
        for k in range(len(after) - 2, -1, -1):
            gain = np.linalg.solve(before[k + 1].covariance, after[k].covariance).T
            places.insert(0, after[k].mean + gain @ (places[0] - before[k + 1].mean))
        newest = Belief(np.clip(after[-1].mean, 0.0, 1.0), after[-1].covariance)
        return np.clip(np.array(places), 0.0, 1.0), newest


def _after(known: Belief, measured: Measurement) -> Belief:
    """Return a belief after a measurement, if that depends on a parameter."""
    return known.updated(measured)[0] if measured.is_informative else known
