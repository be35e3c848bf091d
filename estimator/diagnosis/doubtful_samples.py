"""Way back from samples that turn out to be doubtful, as the sensor of one of their values is found to be wrong."""

import numpy as np

from ..space import Vector
from .lasting import LastingParameters
from .residual_scale import NOISY, are_mostly_larger
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState
from .wandering import agree


class DoubtfulSamples:
    """Choice of the parameters to go back to, and of what the samples say of the noise."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals, lasting: LastingParameters) -> None:
        self._state, self._residuals, self._lasting = state, residuals, lasting

    def undone(self, n: int) -> Vector | None:
        """End the suspicion, as the newest n samples are doubtful; return the parameters (d,) to go back to.

        Those that lasted, where only doubtful samples have contradicted them, or noise that is larger than known does;
        else those in force before these. None where there is no suspicion, and they are in force still.
        """
        state, to_unit = self._state, self._residuals.space.to_unit
        state.n_doubts += 1
        if not state.in_force.changes:
            return None
        before, now = state.in_force.at(state.n_samples - n), state.in_force.changes[-1][1]
        if state.lasting is not None and state.n_samples < state.lasting_at + n:
            before = state.lasting
        lasting = before if state.lasting is None else state.lasting
        if self._lasting.accepted(before) is lasting and self._have_larger_noise(lasting, n):
            before = lasting
        elif not state.n_since and agree(to_unit(before), to_unit(now)):
            return None
        state.end_suspicion()
        return before

    def _have_larger_noise(self, theta: Vector, n: int) -> bool:
        """Take what theta (d,) leave unexplained of the newest n samples for noise, where most is more than known.

        Return whether there is a channel where it is.
        """
        n = min(n, len(self._state.samples))
        if n < NOISY:
            return False
        rows = self._residuals.of_newest(theta, n)
        return self._state.admit_usual(np.where(are_mostly_larger(rows), rows, 0.0))
