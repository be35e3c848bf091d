"""Record of a diagnosis: its events, counted by kind, and its summary."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..effects.lag import Lag
from ..events import Event, EventKind
from ..space import Vector
from .settings import MOST_NAMED
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState


class DiagnosisRecord:
    """Record in words and JSON values, with the channels' and the inputs' names."""

    def __init__(
        self, state: DiagnosisState, residuals: StandardisedResiduals, names: Sequence[str], inputs: Sequence[str]
    ) -> None:
        """names (c,): of the channels; inputs (p,): of the inputs, or none."""
        self._state, self._residuals = state, residuals
        self.names, self._inputs = tuple(names), tuple(inputs)

    def summary(self) -> dict[str, Any]:
        """Return what is known of each channel, and the number of events of each kind."""
        found = self._state.summary(self.names, self._residuals.sigma, self._input_names())
        return found | {"known_friction": self._known_friction()}

    def disturbance(
        self, t: float, offset: Vector, acts: NDArray[np.bool_], reason: str, *, is_known: bool = False
    ) -> Event:
        """Return the event of a disturbance (c,), in standard deviations of the declared noise; acts (c,): where.

        is_known: true where it goes on, and is taken off the samples; else it has passed, or is another one soon.
        """
        state = self._state
        size = {self.names[i]: float(offset[i] * self._residuals.sigma[i]) for i in np.flatnonzero(acts)}
        state.named = [*state.named, {"t": t, "size": size}][-MOST_NAMED:]
        return self._counted(t, "disturbance", {"size": size, "is_known": is_known, "reason": reason})

    def disturbance_over(self, t: float) -> Event:
        """Return the event of the end of a known disturbance, which is not counted."""
        return Event(t, "disturbance", {"size": {}, "reason": "the disturbance is over"})

    def lag(self, t: float, found: Lag) -> Event:
        """Return the event of a lag or limits of the inputs that are known now, or of their end."""
        how = "inputs that arrive late explain the samples" if found else "the inputs arrive as they are sent again"
        how = "inputs that are stuck, or at their limit, explain the samples" if found.limits else how
        return self._counted(t, "lag", {**self._state.inputs.describe(found, self._input_names()), "reason": how})

    def friction(self, t: float, ending: str = "the friction is over") -> Event:
        """Return the event of friction that is known now, or of its end."""
        how = "friction that the model lacks explains the samples, neither a disturbance nor parameters do"
        reason = how if self._state.friction else ending
        return self._counted(t, "friction", {"terms": self._known_friction(), "reason": reason})

    def unexplained(self, t: float, channels: NDArray[np.bool_], reason: str) -> Event:
        """Return the event of channels (c,) that no parameters explain; reason: with a place for their names."""
        names = self._names_of(channels)
        return self._counted(t, "unexplained", {"channels": names, "reason": reason.format(", ".join(names))})

    def rest(self, t: float, channels: NDArray[np.bool_], length: int) -> Event:
        """Return the event of a rest of channels (c,) for so many samples."""
        names = self._names_of(channels)
        reason = f"{self._state.n_failures} failed searches: {', '.join(names)} left out for {length} samples"
        return self._counted(t, "rest", {"channels": names, "n_samples": length, "reason": reason})

    def _counted(self, t: float, kind: EventKind, detail: dict[str, Any]) -> Event:
        self._state.counts[kind] += 1
        return Event(t, kind, detail)

    def _names_of(self, channels: NDArray[np.bool_]) -> list[str]:
        return [self.names[i] for i in np.flatnonzero(channels)]

    def _known_friction(self) -> list[dict[str, Any]]:
        return self._state.friction.summary(self.names, self._residuals.declared.channels, self._input_names())

    def _input_names(self) -> Sequence[str]:
        samples = self._state.samples
        return self._inputs or [f"input {j}" for j in range(len(samples[-1].u) if samples else 0)]
