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
        of_held, of_lasting = (self._residuals.of_newest(theta, n) for theta in (held, lasting))
        if is_rough(of_lasting.T):  # the noise is larger
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

        That is since these were last in force, on the channels that do not rest or on all.
        """
        lasting, samples = self._state.lasting, self._state.since_last_in_force
        if lasting is None or len(samples) < _ENOUGH:
            return False
        known = self._residuals.known
        every = [known, known.on_all_channels()] if self._state.is_resting.any() else [known]
        for known in every:
            if _explains_far_more(self._residuals.scaled_rows(np.array([lasting, theta]), known.without_all(samples))):
                return True
        return False

    def accepted(self, reference: Vector) -> Vector:
        """Return the parameters (d,) that were accepted last: those that lasted, or a reference that does since."""
        lasting = self._state.lasting
        return reference if lasting is None or self._outlasts(reference) else lasting

    def undone(self, reference: Vector) -> Vector:
        """Return the parameters (d,) to go back to: the reference, or those accepted last where a channel rests."""
        return self.accepted(reference) if self._state.is_resting.any() else reference


def _explains_far_more(rows: Vector) -> bool:
    """Return whether the second of two residuals (2, n, c) is far smaller than the first, the noise in it apart.

    A constant disturbance is left out of both. Where noise that is larger than known remains, it must be much smaller
    so, and far smaller with that disturbance. Zeros are missing values.
    """
    n_values = np.count_nonzero(rows[1])
    usual, found = np.sum(np.where(rows, rows - np.median(rows, axis=1, keepdims=True), 0.0) ** 2, axis=(1, 2))
    if not usual - found >= 2.0 * MARGIN:
        return False
    if max(found - n_values, 0.0) < _FAR_LESS * (usual - n_values):
        return True
    all_usual, all_found = np.sum(rows**2, axis=(1, 2))
    return bool(found < BETTER * usual and all_found < _FAR_LESS * all_usual)
