"""Failed searches, one soon after the other, and the rests of channels that follow."""

import numpy as np
from numpy.typing import NDArray

from ..events import Event
from .record import DiagnosisRecord
from .settings import PATIENCE, DiagnosisSettings
from .state import DiagnosisState


class FailedSearches:
    """Count of the failed searches; one too many lets channels rest."""

    def __init__(self, state: DiagnosisState, settings: DiagnosisSettings, record: DiagnosisRecord) -> None:
        self._state, self._settings, self._record = state, settings, record

    def count(self, t: float, channels: NDArray[np.bool_]) -> tuple[Event, ...]:
        """Count a failed search; return the event of the rest of these channels (c,), where it was one too many."""
        self._state.n_failures += 1
        return () if self._state.n_failures < PATIENCE else (self.rest(t, channels),)

    def rest(self, t: float, channels: NDArray[np.bool_]) -> Event:
        """Let the channels rest, all of them where some do already, longer each time; return the event."""
        state = self._state
        channels = ~state.is_resting if state.is_resting.any() else channels
        length = self._settings.rest_length(state.n_failures)
        state.rest(channels, length)
        state.largest_unexplained = None
        return self._record.rest(t, channels, length)
