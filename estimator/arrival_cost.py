"""Arrival cost: what all samples since the last change say of the parameters, sample by sample.

Between searches the parameters are a random walk in the unit cube, and each sample measures them: an extended Kalman
filter, whose mean and covariance are the arrival cost of the samples to come: Rao, Rawlings, Lee (2001), "Constrained
linear state estimation: a moving horizon approach"; Jazwinski (1970), section 8.3.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from .belief import Belief, Measurement, identity, innovation_roots, measurement, measurements
from .differences import value_and_slope
from .identifiability import Information, information_of_covariance
from .significance import FALSE_ALARM, chi2_limit
from .space import Vector
from .whiteness import Whiteness

_BLOCK: Final = 10
"""Number of samples whose corrections are compared with their variance."""
_TOO_LARGE: Final = 9.0
"""Square of a correction, in variances, that shows a drift: three standard deviations."""
_DIFFERENT: Final = 0.2
"""Probability that older samples of the same parameters seem to be of others."""
_CONSTANT: Final = 4.0
"""Lead in -2 log likelihood that shows constant parameters: positive evidence, Kass and Raftery (1995)."""
_FADING: Final = 0.25
"""Factor of the walk's variance after a block whose correction is less than a standard deviation."""
_BESIDE: Final = 0.03
"""Share of a drifting parameter's rate by which the others may drift beside it, unseen."""
_FEW: Final = 2
"""Number of parameters that may drift faster before their drift is refuted: more of them follow whatever happens."""
_RELINEARISED_AT: Final = (20, 40, 80)
"""Numbers of samples at which all of them are linearised anew: about a mean that is far better known than before."""
_STEP: Final = 1e-4
"""Step of the differences over a window, in the unit cube."""
_MOST: Final = 5
"""Largest number of Gauss-Newton steps to the least sum of squares of a window."""
_LITTLE: Final = 0.01
"""Difference of sums of squares that is none: a tenth of a standard deviation, squared."""
_HASTENED: Final = (0.03, 0.1, 0.3)
"""Shares of the rate at which all parameters drift in turn where a filter is too slow for what it follows."""
_FASTER: Final = 1.5
"""Factor by which they must drift faster than any does already."""
_ROUNDING: Final = 1e-12
"""Share of a variance that is none."""
_WIDEST: Final = 0.5
"""Standard deviation of a parameter of which nothing is known, in the unit cube."""


@dataclass(frozen=True)
class ArrivalCost:
    """Mean and covariance of the parameters given the samples so far, in the unit cube, and their random walk.

    The walk is learnt from the filter's own corrections, which are larger than it expects where parameters drift:
    Myers and Tapley (1976), "Adaptive sequential estimation with unknown noise statistics".
    """

    mean: Vector
    """Mean (d,)."""
    covariance: Vector
    """Covariance (d, d)."""
    walk: Vector
    """Variance (d,) of each parameter's change from sample to sample."""
    correction: Vector
    """Sum (d,) of the corrections of the present block of samples."""
    expected: Vector
    """Variance (d,) of that sum, if the walk is right."""
    rate: float
    """Standard deviation of a drifting parameter's change from sample to sample, at most."""
    whiteness: Whiteness
    """Correlation of the innovations since the parameters walk as they do."""
    constant: Belief | None = None
    """What the samples since a jump say of parameters that are constant since then; None where they walk."""
    lead: float = 0.0
    """-2 log likelihood of these samples with parameters that walk, less that with constant ones."""
    n_known: int = 0
    """Number of samples that it knows, the newest ones."""
    n_samples: int = 0
    """Number of samples in the present block."""
    cost: float = 0.0
    """Sum of squared residuals of the newest sample, at the mean before it."""
    innovation_squared: float = 0.0
    """Normalised innovation squared of the newest sample."""
    deviance: float = 0.0
    """-2 log likelihood of the newest sample given those before, a constant aside."""

    @classmethod
    def of_estimate(cls, z: Vector, known: Information, rate: float) -> Self:
        """Return the arrival cost of an estimate z (d,) with its information; rate: of a drift, at most."""
        s = np.maximum(known.singular_values, 1.0 / _WIDEST)
        zero = np.zeros(len(z))
        return cls(z, (known.directions.T / s**2) @ known.directions, zero, zero, zero, rate, Whiteness(np.empty(0)))

    @classmethod
    def of_window(cls, z: Vector, residual: Callable[[Vector], Vector], rate: float) -> Self:
        """Return the arrival cost of a window of samples, about its least sum of squares close to an estimate z (d,).

        residual: (D,) over the window, in standard deviations, at a place (d,); rate: of a drift, at most. About z a
        parameter of which the samples say nothing has a standard deviation of half the bounds. Gauss-Newton steps with
        that prior: Bell and Cathey (1993), "The iterated Kalman filter update as a Gauss-Newton method".
        """
        prior = identity(len(z)) / _WIDEST**2
        at, best, precision, cost = z, z, prior, np.inf
        for _ in range(_MOST):
            value, slope = value_and_slope(residual, at, _STEP)
            away = at - z
            now = float(value @ value + away @ prior @ away)
            if not (now < cost and np.isfinite(slope).all()):
                break
            gain, best, cost = cost - now, at, now
            precision = slope.T @ slope / max(1.0, float(value @ value) / max(len(value) - len(z), 1)) + prior
            at = np.clip(at - np.linalg.solve(slope.T @ slope + prior, slope.T @ value + prior @ away), 0.0, 1.0)
            if gain < _LITTLE:
                break
        covariance = np.linalg.inv(precision).astype(np.float64)
        return cls.of_estimate(best, information_of_covariance(covariance), rate)

    def reaching_back(self, residual: Callable[[Vector], Vector]) -> Self:
        """Return the arrival cost with older samples, from the newest of them back to the first that contradicts it.

        They are taken in blocks, each twice as long as the one before, up to one that moves a parameter by more than
        chance does: then it has not been constant for so long. residual: (n, c) at a place (d,), in standard
        deviations, from old to new.
        """
        samples = measurements(residual, self.mean)[::-1]
        different = chi2_limit(_DIFFERENT / len(self.mean), 1)
        known, n, length = self.belief, 0, _BLOCK
        while n < len(samples):
            longer, n_taken = _with_explained(known, samples[n : n + length])
            gained = (known.covariance - longer.covariance).diagonal() + _ROUNDING * known.covariance.diagonal()
            if np.any((longer.mean - known.mean) ** 2 > different * gained):
                break
            known, n = longer, n + n_taken
            if n_taken < length:
                break
            length *= 2
        mean = np.clip(known.mean, 0.0, 1.0)
        return replace(self, mean=mean, covariance=known.covariance, n_known=self.n_known + n)

    def relinearised(self, residual: Callable[[Vector], Vector]) -> Self:
        """Return the arrival cost with all that it knows linearised anew, about its mean, where that explains all.

        A filter linearises each sample about what was known then, which biases it where little was: Bell (1994), "The
        iterated Kalman smoother as a Gauss-Newton method". residual: (n, c) at a place (d,), in standard deviations,
        from old to new, of the samples that it knows.
        """
        samples = measurements(residual, self.mean)
        known, n = _with_explained(Belief(self.mean, _WIDEST**2 * identity(len(self.mean))), samples)
        mean = np.clip(known.mean, 0.0, 1.0)
        before, after = np.array([sample.value for sample in samples]), residual(mean[None])[0]
        if n < len(samples) or not np.sum(after**2) <= np.sum(before**2) + _LITTLE:
            return self
        return replace(self, mean=mean, covariance=known.covariance)

    @property
    def is_to_be_relinearised(self) -> bool:
        """True where constant parameters are known from so many samples more that `relinearised` is worth its time."""
        return self.n_known in _RELINEARISED_AT and self.constant is None and not self.walk.any()

    @property
    def belief(self) -> Belief:
        """Distribution of the parameters at the newest sample."""
        return Belief(self.mean, self.covariance)

    @property
    def information(self) -> Information:
        """Information that gives this covariance."""
        return information_of_covariance(self.covariance)

    def distance(self, z: Vector) -> float:
        """Return the squared distance of z (d,) from the mean, in standard deviations: Mahalanobis'."""
        moved = z - self.mean
        return float(moved @ np.linalg.solve(self.covariance, moved))

    @property
    def is_refuted(self) -> bool:
        """True where drifting parameters do not explain the samples: their innovations are not white (Mehra, 1970)."""
        if not self.whiteness.is_refuted:
            return False
        walking = self.walk[self._is_drifting]
        is_too_slow = len(walking) <= _FEW and bool(np.any(walking < self.rate**2))
        return len(walking) > 0 and not is_too_slow

    def hastened(self) -> Self | None:
        """Return the arrival cost with parameters that all drift faster than any does now; None where they may not."""
        now = float(self.walk.max()) ** 0.5 / self.rate if self.rate else np.inf
        share = next((share for share in _HASTENED if share > _FASTER * now), None)
        return None if share is None else self._walking(np.full(len(self.walk), (share * self.rate) ** 2))

    @property
    def _is_drifting(self) -> NDArray[np.bool_]:
        """True for each parameter (d,) that drifts by itself, not beside another."""
        return self.walk > 1.01 * (_BESIDE * self.rate) ** 2

    def expects(self, residual: Callable[[Vector], Vector]) -> bool:
        """Return whether constant parameters, as uncertain as they are known, explain a sample.

        residual: (c,) in standard deviations at a place (d,).
        """
        measured = measurement(residual, self.mean)
        if self.walk.any() or not measured.has_value:
            return False
        limit = chi2_limit(FALSE_ALARM, len(measured.value))
        return float(self._squared(np.zeros((1, len(self.mean))), measured)[0]) <= limit

    def updated(self, residual: Callable[[Vector], Vector]) -> Self:
        """Return the arrival cost with one more sample; residual: (c,) in standard deviations at a place (d,).

        A sample at which the model has no value, or that depends on no parameter, is left out.
        """
        return self._with(measurement(residual, self.mean))

    def _with(self, measured: Measurement) -> Self:
        if not measured.is_informative:
            squared = float(measured.value @ measured.value) if measured.has_value else 0.0
            known = replace(self, cost=squared, innovation_squared=squared, deviance=squared)
            return replace(known, n_known=self.n_known + 1)
        before = self.belief.walked(self.walk)
        after, innovation = before.updated(measured)
        constant, lead = self.constant, self.lead
        if constant is not None:
            constant, of_constant = constant.updated(measured)
            lead += innovation.deviance - of_constant.deviance
        mean = np.minimum(np.maximum(after.mean, 0.0), 1.0)
        block = replace(
            self,
            mean=mean,
            covariance=after.covariance,
            correction=self.correction + mean - before.mean,
            expected=self.expected + (before.covariance - after.covariance).diagonal(),
            n_samples=self.n_samples + 1,
            whiteness=self.whiteness.updated(innovation.normalised),
            cost=float(measured.value @ measured.value),
            innovation_squared=innovation.squared,
            deviance=innovation.deviance,
            constant=constant,
            lead=lead,
            n_known=self.n_known + 1,
        )
        if block.whiteness.is_refuted and np.any(block._is_drifting) and not block.is_refuted:
            block = block._walking(np.where(block._is_drifting, self.rate**2, 0.0))
        return block if block.n_samples < _BLOCK else block._learnt()

    def drifted(self, residual: Callable[[Vector], Vector]) -> Self | None:
        """Return the arrival cost with a sample that may contradict it; None where a drift does not explain it.

        The one parameter that explains the sample best drifts from now on, all of them where one is not enough.
        """
        measured = measurement(residual, self.mean)
        if not measured.has_value:
            return None
        limit, d = chi2_limit(FALSE_ALARM, len(measured.value)), len(self.mean)
        if self._squared(np.zeros((1, d)), measured)[0] <= limit:
            return self._with(measured)
        walks = self.rate**2 * np.vstack([np.maximum(np.eye(d), _BESIDE**2), np.ones(d)])
        squared = self._squared(walks, measured)
        for i in (int(np.argmin(squared[:d])), d):
            if squared[i] <= limit:
                return self._walking(walks[i])._with(measured)
        return None

    def _walking(self, walk: Vector) -> Self:
        """Return the arrival cost with a walk of these variances (d,) at least."""
        if np.all(walk <= self.walk):
            return self
        walk = np.maximum(self.walk, walk)
        return replace(self, walk=walk, whiteness=Whiteness(np.empty(0)), constant=None, lead=0.0)

    def _squared(self, walks: Vector, measured: Measurement) -> Vector:
        """Return the normalised innovation squared (k,) of a sample where the parameters walk by variances (k, d)."""
        before, H = self.covariance + walks[:, None] * identity(len(self.mean)), measured.slope
        innovations = np.linalg.solve(innovation_roots(before, H), measured.value[:, None])[..., 0]
        return np.array([innovation @ innovation for innovation in innovations])

    def _learnt(self) -> Self:
        """Return the arrival cost at a block's end, with the walk that its corrections show.

        Where constant parameters explain all samples since a jump better, it goes on from these, without a walk.
        """
        zero = np.zeros(len(self.walk))
        begun = replace(self, correction=zero, expected=zero, n_samples=0)
        if self.constant is not None and self.lead >= _CONSTANT:
            mean, covariance = np.clip(self.constant.mean, 0.0, 1.0), self.constant.covariance
            return replace(begun, mean=mean, covariance=covariance, walk=zero, constant=None, lead=0.0)
        squared, known = self.correction**2, self.covariance.diagonal()
        shown = (squared - self.expected) / _BLOCK + self.walk
        walk = np.where(squared > _TOO_LARGE * self.expected, shown, self.walk)
        walk = np.where(squared < self.expected, _FADING * walk, walk)
        return replace(begun, walk=np.where(walk < 1e-6 * known, 0.0, walk))


def _with_explained(known: Belief, samples: Sequence[Measurement]) -> tuple[Belief, int]:
    """Return the belief with samples, up to one that contradicts it, and their number."""
    for n, sample in enumerate(samples):
        if not sample.has_value:
            return known, n
        after, innovation = known.updated(sample)
        if innovation.squared > chi2_limit(FALSE_ALARM, len(sample.value)):
            return known, n
        known = after
    return known, len(samples)
