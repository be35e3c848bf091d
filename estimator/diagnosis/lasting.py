"""Parameters to go back to: those that lasted, or newer ones that have long explained far more."""

from typing import Final

import numpy as np

from ..hypotheses import MARGIN, disturbance_of, plain_fit
from ..space import Vector
from .residual_scale import is_rough
from .settings import BETTER, LONG
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState

_ENOUGH: Final = 8
"""Least number of samples, of every fifth one, that show which parameters explain for long."""
_FAR_LESS: Final = 0.05
"""Share of the sum of squares of the parameters that lasted which better ones may have."""


class LastingParameters:
    """Choice of the parameters to go back to."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals) -> None:
        self._state, self._residuals = state, residuals

    def are_better(self, held: Vector, of_held: Vector) -> bool:
        """Return whether those that lasted contradict the newest samples much less than the ones in force, held (d,).

        Both the newest n, with those that the ones in force have explained before the onset, and the very newest.
        of_held: residuals (n, c) of the ones in force.
        """
        lasting = self._state.lasting
        if lasting is None or np.array_equal(lasting, held) or plain_fit(of_held[-LONG:], 0).is_explained:
            return False
        n = min(len(of_held) + self._state.n_calm, len(self._state.samples))
        of_held, of_lasting = self._residuals.of_newest(np.array([held, lasting]), n)
        if is_rough(of_lasting):  # the noise is larger
            return False
        return all(
            not plain_fit(of_held[-m:], 0).is_explained
            and np.sum(of_lasting[-m:] ** 2) + MARGIN <= BETTER * np.sum(of_held[-m:] ** 2)
            for m in (n, LONG)
        )

    def before(self, reference: Vector, n: int) -> Vector:
        """Return the parameters (d,) from before the newest n samples: those that lasted, or the reference.

        The reference, which a search has found since, only where it explains these, with a disturbance, and those since
        the suspicion before much better.
        """
        lasting = self._state.lasting
        if lasting is None or np.array_equal(lasting, reference) or self._outlasts(reference):
            return reference
        if not disturbance_of(self._residuals.of_newest(reference, n)).fit.is_explained:
            return lasting
        n = min(n + self._state.n_calm, len(self._state.samples))
        found, other = (disturbance_of(self._residuals.of_newest(theta, n)).fit for theta in (reference, lasting))
        return reference if found.score + MARGIN <= other.score else lasting

    def _outlasts(self, theta: Vector) -> bool:
        """Return whether parameters (d,) have long explained far more than those that lasted.

        A constant disturbance, which may have acted since then, is left out of both.
        """
        lasting, samples = self._state.lasting, self._state.since_lasting
        if lasting is None or len(samples) < _ENOUGH:
            return False
        rows = np.array([self._residuals.rows(lasting, samples), self._residuals.rows(theta, samples)])
        usual, found = np.sum((rows - np.median(rows, axis=1, keepdims=True)) ** 2, axis=(1, 2))
        return bool(found < _FAR_LESS * usual)

    def accepted(self, reference: Vector) -> Vector:
        """Return the parameters (d,) that were accepted last: those that lasted, or a reference that does since."""
        lasting = self._state.lasting
        return reference if lasting is None or self._outlasts(reference) else lasting

    def undone(self, reference: Vector) -> Vector:
        """Return the parameters (d,) to go back to: the reference, or those accepted last where a channel rests."""
        return self.accepted(reference) if self._state.is_resting.any() else reference
