"""Rest of re-tuning on sequences of samples after failed searches: for how long, and at which parameters."""

from typing import Final

import numpy as np

from ..episode_window import EpisodeWindow
from ..events import Event
from ..hypotheses import plain_fit
from ..space import Vector
from .episode_state import EpisodeState
from .evidence import Evidence
from .resting import RestingResiduals
from .settings import CALM, DiagnosisSettings

_FAR_LESS: Final = 0.05
"""Share of the squares of the parameters that lasted which those that a rest keeps may have."""


class EpisodeRest:
    """Rest of an `EpisodeDiagnosis`, whose state and window it shares."""

    def __init__(
        self,
        window: EpisodeWindow,
        outputs: tuple[str, ...],
        settings: DiagnosisSettings,
        state: EpisodeState,
        evidence: Evidence,
    ) -> None:
        """outputs: names of the channels; state: the diagnosis', which this changes."""
        self._window, self._outputs, self._settings = window, outputs, settings
        self._state, self._evidence = state, evidence

    @property
    def is_on(self) -> bool:
        """True while no search begins."""
        return self._state.n_samples < self._state.rests_until

    def begin(self, t: float) -> Event:
        """Begin a rest at t [s], the longer the more searches have failed; return the event."""
        state = self._state
        state.counts["rest"] += 1
        if len(state.rested) > 1:
            state.scale.admit(np.array(state.rested))
            self._window.weights = 1.0 / state.scale.effective
        length = self._settings.rest_length(state.n_failures)
        state.rests_until = state.n_samples + length
        state.rested.clear()
        state.resting = RestingResiduals()
        reason = f"{state.n_failures} failed searches: re-tuning rests for {length} samples"
        return Event(t, "rest", {"channels": list(self._outputs), "n_samples": length, "reason": reason})

    def parameters(self, before: Vector) -> Vector:
        """Return the parameters (d,) to rest at where a rest has just begun: those before it, or those that lasted.

        The latter where the others were written as what they left was adopted as noise, have not explained a window's
        samples since, and do not explain the sequence far better.
        """
        state = self._state
        if state.lasting is None or not state.is_provisional or not self.is_on:
            return before
        state.is_provisional = False
        of_lasting, of_before = (self._squares(theta) for theta in (state.lasting, before))
        return before if of_before < _FAR_LESS * of_lasting else state.lasting

    def take(self, newest: Vector) -> None:
        """Take the newest sample's residual (c,), and end the rest where that is over, early perhaps.

        What was unexplained has outgrown all before; or it has passed: residuals have been no more than noise for as
        long as they had been more.
        """
        state = self._state
        state.n_calm = 0
        if np.any(np.isfinite(newest)):
            state.rested.append(newest)
            state.resting = state.resting.take(newest, state.scale.values)
        if state.resting.is_calm(state.n_samples - state.restless_since - state.resting.n_calm):
            self._evidence.rest_ended(self._outputs, CALM)
            state.rests_until, state.n_calm = state.n_samples, state.resting.n_calm
            state.rested.clear()
        elif self._has_other_scale():
            self._window.weights = 1.0 / state.scale.effective

    def _has_other_scale(self) -> bool:
        """Return whether a rest ends with another scale of the residuals."""
        state = self._state
        if state.resting.is_outgrown:
            self._evidence.outgrown(self._outputs, state.resting)
            state.rests_until, state.unexplained = state.n_samples, None
            usual = np.array(state.rested[: state.resting.n_usual - state.resting.n_samples])
            state.rested.clear()
            return state.scale.admit(usual)
        if state.n_samples < state.rests_until - 1:
            return False
        state.unexplained = None
        return state.scale.wake(np.array(state.rested))

    def _squares(self, theta: Vector) -> float:
        residual = self._window.whitened(theta)
        return plain_fit(residual, 0, len(residual)).squares
