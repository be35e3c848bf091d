"""End of a suspicion as something that the model lacks explains the samples: a lag, friction, or a larger noise."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from .effect_comparison import Explanation
from .events import Event
from .friction import FoundFriction
from .hypotheses import MARGIN, NEVER, plain_fit
from .lasting import LastingParameters
from .space import Vector

_FRICTION: Final = "friction that the model lacks explains the samples, neither a disturbance nor parameters do"


@dataclass(frozen=True)
class Settled:
    """End of a suspicion."""

    undo: Vector | None
    """Parameters (d,) from before the onset, to return to; None where those in force stay."""
    events: tuple[Event, ...] = ()
    ends_search: bool = False
    """True where the search for parameters is at its end, too."""


class EffectDiagnosis(LastingParameters):
    """Diagnosis of what the model lacks, whose size is known then."""

    def _larger_noise(self, reference: Vector, held: Vector, n: int) -> Settled:
        """End a suspicion as the noise is larger than was known at the onset: nothing has happened since.

        What lasted returns where it explains the newest n samples, too; else the reference (d,), a search's own finding
        perhaps, where it explains them better than what is held (d,).
        """
        state, lasting = self._state, self._state.lasting
        state.end_suspicion()
        if lasting is not None and plain_fit(self.residuals.of_newest(lasting, n), 0).is_explained:
            return Settled(lasting, ends_search=True)
        here, there = (float(np.sum(self.residuals.of_newest(theta, n) ** 2)) for theta in (held, reference))
        return Settled(self._undone(reference) if there < here else None, ends_search=True)

    def _adopted(self, t: float, effect: Explanation) -> Settled:
        """End a suspicion as an effect that the model lacks explains the samples, or the end of one does."""
        state, found = self._state, effect.found
        state.offset = effect.offset
        if isinstance(found, FoundFriction):
            state.friction = found.friction
            return self._with_friction(t, effect.theta)
        state.end_suspicion()
        state.inputs.adopt(found)
        state.counts["lag"] += 1
        how = "inputs that arrive late explain the samples" if found.lag else "the inputs arrive in time again"
        event = Event(t, "lag", {**state.inputs.describe(found.lag), "reason": how})
        return Settled(self._undone(effect.theta), (event,), True)

    def _with_friction(self, t: float, theta: Vector | None) -> Settled:
        """End a suspicion, and all rests, as known friction explains the samples; return to theta (d,) where given."""
        state = self._state
        state.n_since, state.verdict, state.n_failures = 0, "refuted", 0
        state.wake_all()
        state.counts["friction"] += 1
        reason = _FRICTION if state.friction else "the friction is over"
        event = Event(t, "friction", {"terms": self._friction_summary(), "reason": reason})
        return Settled(None if theta is None else self._undone(theta), (event,), True)

    def _late_effect(self, t: float, held: Vector) -> Settled | None:
        """Return to the parameters that lasted where what the model lacks explains the samples since.

        Other parameters, held (d,), or a constant disturbance have followed it, or channels rest for it.
        """
        state = self._state
        if state.lasting is None or not self._is_effect_due():
            return None
        rests = bool(state.is_resting.any())
        is_followed = np.any(state.offset) or not np.array_equal(held, state.lasting)
        if not (rests or is_followed or state.n_since):
            return None
        followed = NEVER if rests else plain_fit(self.residuals.rows(held, state.every_since_lasting), self._n_free)
        if followed.is_explained:
            return None
        found = self._friction_long(state.lasting) if state.n_since else self._lacking(state.lasting)
        if found is None and self._take_friction_beside(held):
            state.way = state.way.begin(self._space.to_unit(held))
            return self._with_friction(t, None)
        return None if found is None or found.fit.score + MARGIN > followed.score else self._adopted(t, found)
