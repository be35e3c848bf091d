"""Kalman filters whose states are the parameters: on sigma points, and on an ensemble."""

from dataclasses import dataclass

import numpy as np

from ..contract import Estimate, scaled_estimate
from ..identifiability import IDENTIFIABLE_BELOW, information_of_covariance
from ..objective import Objective
from ..positive import must_be_positive
from ..space import ParameterSpace, Vector
from .linearisation import (
    EnsemblePoints,
    Normal,
    Points,
    Reached,
    SigmaPoints,
    ensemble,
    identifiable_from,
    iterated,
    root_of,
    updated,
)


@dataclass(frozen=True)
class UnscentedSettings:
    """Settings of `UnscentedKalman`; lengths are shares of the scaled bounds."""

    walk: float = 0.003
    """Standard deviation of a parameter's step from sample to sample; on roll-outs there is none."""
    spread: float = 0.05
    """Standard deviation of each parameter at the start; sigma points far from it may reach where no model holds."""
    alpha: float = 0.1
    """Spread of the sigma points round the mean, sample by sample; on roll-outs 1."""
    jump: float = 0.3
    """On roll-outs, standard deviation of each parameter's distance from the one in force when an episode begins."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        must_be_positive(self, "walk", "spread", "alpha", "jump", "identifiable_below")


class UnscentedKalman:
    """Unscented Kalman filter whose states are the parameters, as random walks in the unit cube.

    The measurement is the sampled derivative, or, the same, the whitened residual, which should be zero with unit
    variance. Julier and Uhlmann (2004); van der Merwe (2004).

    On roll-outs an episode is one measurement, of parameters that may have jumped when it began: its sigma points are
    evaluated at the same time, and again about each result. States that roll-outs begin in and that are measured with
    noise are states of the filter, too, already integrated out of the residuals that it is given.
    """

    is_whitened = True

    def __init__(
        self, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: UnscentedSettings | None = None
    ) -> None:
        self._space, self._settings = space, settings or UnscentedSettings()
        self.restart(start)

    def restart(self, start: Vector) -> None:
        """Begin at theta (d,), with all samples forgotten."""
        z = self._space.to_unit(start)
        self._now, self._begun = Normal(z, np.eye(len(z))), False
        self._cost, self._n_evaluations = np.inf, 0

    def jump(self, estimate: Estimate) -> None:
        """Go on from an estimate that has its information."""
        self._now, self._begun = _after_jump(estimate, self._space, self._settings.spread), True

    def solve(self, objective: Objective) -> None:
        """Process the newest sample, or an episode's. One sample at which a sigma point has no value is left out."""
        d, settings = len(self._space), self._settings
        if not objective.has_samples:
            self._now, self._cost = _after_episode(
                self._now.mean, SigmaPoints(d), settings.spread, settings.jump, objective, self._space
            )
        else:
            before = self._now if self._begun else Normal(self._now.mean, settings.spread * np.eye(d))
            points = SigmaPoints(d, settings.alpha)
            self._now, self._cost = updated(
                before.walked(settings.walk), points, lambda z: objective.newest_residual(self._space.from_unit(z))
            )
        self._begun = True
        self._n_evaluations += objective.n_evaluations

    def estimate(self) -> Estimate:
        """Return the mean; cost: sum of squared residuals of the newest sample before it, or of an episode's."""
        below = identifiable_from(self._settings.identifiable_below, self._settings.spread)
        return _estimate(self._space, self._now, below, self._cost, self._n_evaluations, "unscented Kalman filter")


@dataclass(frozen=True)
class EnsembleSettings:
    """Settings of `EnsembleKalman`; lengths are shares of the scaled bounds."""

    members: int = 50
    """Number of members, each evaluated at every sample."""
    members_of_episode: int = 8
    """Number of members on roll-outs, each a roll-out in every iteration; at least two more than parameters."""
    walk: float = 0.003
    """Standard deviation of a parameter's step from sample to sample; on roll-outs there is none."""
    spread: float = 0.05
    """Standard deviation of each parameter at the start; members far from it may reach where no model holds."""
    jump: float = 0.3
    """On roll-outs, standard deviation of each parameter's distance from the one in force when an episode begins."""
    identifiable_below: float = IDENTIFIABLE_BELOW
    """A parameter counts as identifiable when its standard deviation is below this share of the scaled bounds."""

    def __post_init__(self) -> None:
        must_be_positive(self, "members", "members_of_episode", "walk", "spread", "jump", "identifiable_below")


class EnsembleKalman:
    """Ensemble Kalman filter whose states are the parameters, as random walks in the unit cube.

    Each sample moves the members by a gain from their own covariances, each towards measurements with other noise:
    Evensen (1994); Burgers, van Leeuwen, Evensen (1998). For parameters: Iglesias, Law, Stuart (2013).

    On roll-outs an episode is one measurement: an ensemble round the parameters in force is evaluated at the same
    time, and another round each result, in Gauss-Newton steps: Sakov, Oliver, Bertino (2012). Noise of the states that
    roll-outs begin in is in the residuals, as for `UnscentedKalman`.
    """

    is_whitened = True

    def __init__(
        self, space: ParameterSpace, start: Vector, rng: np.random.Generator, settings: EnsembleSettings | None = None
    ) -> None:
        self._space, self._rng, self._settings = space, rng, settings or EnsembleSettings()
        self.restart(start)

    def restart(self, start: Vector) -> None:
        """Begin at theta (d,), with all samples forgotten."""
        z = self._space.to_unit(start)
        self._now, self._members = Normal(z, np.eye(len(z))), np.empty((0, len(z)))
        self._cost, self._n_evaluations = np.inf, 0

    def jump(self, estimate: Estimate) -> None:
        """Go on from an estimate that has its information."""
        self._now = _after_jump(estimate, self._space, self._settings.spread)
        d = len(self._space)
        self._members = self._now.places(ensemble(max(self._settings.members, d + 2), d, self._rng))

    def solve(self, objective: Objective) -> None:
        """Process the newest sample, or an episode's. One sample at which a member has no value is left out."""
        d, settings = len(self._space), self._settings
        if objective.has_samples:
            if not len(self._members):
                drawn = ensemble(max(settings.members, d + 2), d, self._rng)
                self._members = self._now.mean + settings.spread * drawn
            self._take(objective)
        else:
            points = EnsemblePoints(ensemble(max(settings.members_of_episode, d + 2), d, self._rng))
            self._now, self._cost = _after_episode(
                self._now.mean, points, settings.spread, settings.jump, objective, self._space
            )
        self._n_evaluations += objective.n_evaluations

    def estimate(self) -> Estimate:
        """Return the mean; cost: sum of squares of the members' mean residual before the sample, or of an episode's."""
        below = identifiable_from(self._settings.identifiable_below, self._settings.spread)
        return _estimate(self._space, self._now, below, self._cost, self._n_evaluations, "ensemble Kalman filter")

    def _take(self, objective: Objective) -> None:
        """Move the members by the newest sample."""
        n, d = self._members.shape
        self._members = self._members + self._settings.walk * self._rng.standard_normal((n, d))
        with np.errstate(all="ignore"):  # where the model overflows
            r = objective.newest_residual(self._space.from_unit(self._members))
        if np.all(np.isfinite(r)):
            mean = r.mean(axis=0)
            noise = ensemble_noise(n, r.shape[1], self._rng)
            away, off = self._members - self._members.mean(axis=0), r - mean
            gain = np.linalg.solve(off.T @ off / (n - 1) + np.eye(r.shape[1]), off.T @ away / (n - 1))
            self._members, self._cost = np.clip(self._members - (r + noise) @ gain, 0.0, 1.0), float(mean @ mean)
        spread = np.cov(self._members.T).reshape(d, d) + 1e-12 * np.eye(d)
        self._now = Normal(self._members.mean(axis=0), root_of(spread))


def ensemble_noise(n: int, c: int, rng: np.random.Generator) -> Vector:
    """Return noise (n, c) of the measurements, of mean zero: the mean of the members is not moved by it."""
    drawn = rng.standard_normal((n, c))
    return drawn - drawn.mean(axis=0)


def _after_episode(
    mean: Vector, points: Points, spread: float, jump: float, objective: Objective, space: ParameterSpace
) -> Reached:
    """Return what an episode makes of parameters in force at a mean (d,), which may have jumped when it began.

    spread, jump: standard deviations in the unit cube over which residuals are linearised first, and of the jump.
    """
    one = np.eye(len(space))
    return iterated(Normal(mean, jump * one), Normal(mean, spread * one), points, objective, space)


def _after_jump(estimate: Estimate, space: ParameterSpace, spread: float) -> Normal:
    """Return the distribution after a jump to an estimate; spread: standard deviation where the data say nothing."""
    assert estimate.information is not None
    return Normal(space.to_unit(estimate.theta), root_of(estimate.information.covariance(spread)))


def _estimate(
    space: ParameterSpace, now: Normal, below: float, cost: float, n_evaluations: int, reason: str
) -> Estimate:
    std = np.minimum(np.sqrt(now.covariance.diagonal()), 1.0)
    return scaled_estimate(
        space, now.mean, std, below, information_of_covariance(now.covariance),
        cost=cost, n_evaluations=n_evaluations, reason=reason,
    )  # fmt: skip
