"""Comparison of larger noise with what else may explain the samples since an onset."""

from collections.abc import Callable

import numpy as np

from ..differences import OfMany
from ..hypotheses import LARGEST_RATE, MARGIN, ChangedParameters, changed_parameters, disturbance_of, plain_fit
from ..space import Vector
from .residual_scale import (
    LARGER,
    LARGEST,
    MUCH_LARGER,
    NOISY,
    TOO_SMALL,
    is_rough,
    is_smooth,
    larger_noise,
    spread_of,
)
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState


class NoiseComparison:
    """Search for a noise that is larger than known, and its adoption."""

    def __init__(
        self, state: DiagnosisState, residuals: StandardisedResiduals, best: Callable[..., ChangedParameters]
    ) -> None:
        """best: `HypothesisComparison.best`."""
        self._state, self._residuals, self._space, self._best = state, residuals, residuals.space, best

    def if_noise(self, held: Vector) -> Vector | None:
        """Return the reference (d,) where noise of ten times the known size explains the samples since the onset.

        held (d,): in force, for want of a reference. None where they are no noise.
        """
        reference = self._state.reference_or(held)
        rows = self._residuals.of_newest(reference, self._state.n_since) / TOO_SMALL
        return reference if plain_fit(rows, 0).is_explained else None

    def adopt_white(self, held: Vector, reference: Vector) -> bool:
        """Adopt a larger noise where a white one explains a full window since the onset, and nothing else does as well.

        With the parameters from before it, the reference (d,), and up to twenty times as large. held (d,): in force.
        """
        state, n = self._state, self._state.n_since
        if n < WINDOW or state.verdict.is_warranted:
            return False
        rows = self._residuals.of_newest(reference, n)
        size = np.maximum(np.sqrt(np.mean(rows**2, axis=0)), 1.0)
        if size.max() >= LARGEST or not is_rough(rows.T) or is_smooth(rows):
            return False
        others = disturbance_of(rows).fit, self._best(held, n, may_drift=True).fit
        if larger_noise(rows).score + MARGIN > min(fit.score for fit in others):
            return False
        state.scale.enlarge(size)
        return True

    def adopt(self, held: Vector) -> bool:
        """Adopt a larger noise where that explains the samples since the onset, with those in force or the best ones.

        Noise is what differs from sample to sample by as much as in the whole: what a model lacks is smooth.
        """
        state = self._state
        if state.n_since < NOISY:
            return False
        few = min(state.n_since, WINDOW // 2)
        best = self._best(held, few, may_drift=False).z
        for n, z, least in ((state.n_since, self._space.to_unit(held), MUCH_LARGER), (few, best, LARGER)):
            rows_at = self._residuals.at_newest(n)
            rows = rows_at(z)
            larger = np.maximum(spread_of(rows), 1.0)
            if not np.all(np.isfinite(rows)) or np.all(larger < least):
                continue
            times = self._residuals.times_of_newest(n)
            found = changed_parameters(OfMany(lambda z, f=rows_at, larger=larger: f(z) / larger), z, times)
            left = found.rows * larger
            noise = np.maximum(spread_of(left), 1.0)
            is_noise = noise.max() < LARGEST and not is_smooth(left)
            if is_noise and found.rate <= LARGEST_RATE and found.fit.is_explained:
                state.scale.enlarge(noise)
                return True
        return False
