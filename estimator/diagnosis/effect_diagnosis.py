"""End of a suspicion as something that the model lacks explains the samples: a lag, friction, or a larger noise."""

from dataclasses import replace
from typing import Final

import numpy as np

from ..effects.friction import FoundFriction, Friction
from ..effects.known_effects import Explanation
from ..hypotheses import MARGIN, NEVER, plain_fit
from ..space import Vector
from .friction_comparison import FrictionComparison
from .lag_comparison import LagComparison
from .lasting import LastingParameters
from .record import DiagnosisRecord
from .settings import BETTER, FEWEST, LONG
from .settled import Settled
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState, FrictionTrial

_EARLIEST: Final = 16
"""Least number of samples since the parameters that lasted were contradicted, in which an effect is sought again."""


_NO_FRICTION: Final = "the friction that was found does not explain the samples after it"
_BESIDE: Final = "a constant disturbance, found together with friction, goes on"


class EffectDiagnosis:
    """Diagnosis of what the model lacks, whose size is known then."""

    def __init__(
        self,
        state: DiagnosisState,
        residuals: StandardisedResiduals,
        lag: LagComparison,
        friction: FrictionComparison,
        lasting: LastingParameters,
        record: DiagnosisRecord,
    ) -> None:
        self._state, self._residuals, self._record = state, residuals, record
        self._lag, self._friction, self._lasting = lag, friction, lasting

    def larger_noise(self, reference: Vector, held: Vector, n: int) -> Settled:
        """End a suspicion as the noise is larger than was known at the onset: nothing has happened since.

        What lasted returns where it explains the newest n samples, too; else the reference (d,), a search's own finding
        perhaps, where it explains them better than what is held (d,).
        """
        nothing = self.only_noise(n)
        if nothing is not None:
            return nothing
        of_newest = self._residuals.of_newest
        self._state.end_suspicion()
        with_held, with_reference = (float(np.sum(of_newest(theta, n) ** 2)) for theta in (held, reference))
        return Settled(self._lasting.undone(reference) if with_reference < with_held else None, ends_search=True)

    def only_noise(self, n: int) -> Settled | None:
        """Return to the parameters that lasted where they explain the newest n samples: nothing has happened."""
        lasting = self._state.lasting
        if lasting is None or not plain_fit(self._residuals.of_newest(lasting, n), 0).is_explained:
            return None
        self._state.end_suspicion()
        return Settled(lasting, ends_search=True)

    def lacking(self, reference: Vector) -> Explanation | None:
        """Return the lag or the friction that explains the samples since the parameters that lasted, or None."""
        late = self._lag.since_lasting(reference)
        return self._friction.since_lasting(reference) if late is None else late

    def late(self, reference: Vector) -> Explanation | None:
        """Return the lag that explains all samples since the onset, which must be many; reference (d,), or None."""
        n = self._state.n_since
        return self._lag.in_newest(reference, n) if n >= LONG else None

    def adopt(self, t: float, effect: Explanation) -> Settled:
        """End a suspicion as an effect that the model lacks explains the samples, or the end of one does.

        Parameters in force stay where they explain the samples much better with a lag than those that it was found for.
        """
        state, found, before = self._state, effect.found, self._state.offset
        state.offset = effect.offset
        if isinstance(found, FoundFriction):
            n, held = state.n_samples, state.in_force.at(state.n_samples)
            state.trial = None if state.friction else FrictionTrial(held, before, 2 * n - state.lasting_at)
            state.friction = found.friction
            return self.adopt_friction(t, effect.theta)
        state.end_suspicion()
        state.inputs.adopt(found)
        held = state.in_force.at(state.n_samples)
        left, of_held = (np.sum(self._residuals.of_newest(theta, effect.n) ** 2) for theta in (effect.theta, held))
        back = None if of_held < BETTER * left else self._lasting.undone(effect.theta)
        return Settled(back, (self._record.lag(t, found.lag),), True)

    def adopt_friction(self, t: float, theta: Vector | None) -> Settled:
        """End a suspicion, and all rests, as known friction explains the samples; return to theta (d,) where given."""
        state = self._state
        state.end_suspicion()
        state.n_failures = 0
        state.wake_all()
        events = [self._record.friction(t)]
        if not state.friction and np.any(state.offset):
            events.append(self._record.disturbance(t, state.offset, state.offset != 0.0, _BESIDE, is_known=True))
        return Settled(None if theta is None else self._lasting.undone(theta), tuple(events), True)

    def since_lasting(self, t: float, held: Vector) -> Settled | None:
        """Return to the parameters that lasted where what the model lacks explains the samples since.

        Other parameters, held (d,), or a constant disturbance have followed it, or channels rest for it.
        """
        state = self._state
        if state.lasting is None:
            return None
        if self._has_failed_trial():
            return self._take_back(t)
        if not self._is_due():
            return None
        rests = bool(state.is_resting.any())
        is_followed = np.any(state.offset) or not np.array_equal(held, state.lasting)
        if not (rests or is_followed or state.n_since):
            return None
        rows, space = self._residuals.rows, self._residuals.space
        followed = NEVER if rests else plain_fit(rows(held, state.every_since_lasting), len(space))
        if followed.is_explained:
            return None
        if self._friction.take_beside(held):
            state.path = state.path.begin(space.to_unit(held))
            return self.adopt_friction(t, None)
        found = self._friction.since_lasting(state.lasting) if state.n_since else self.lacking(state.lasting)
        if found is None or found.has_limits or found.fit.score + MARGIN > followed.score:
            return None  # parameters that drift may do the same as a limit
        return self.adopt(t, found)

    def _has_failed_trial(self) -> bool:
        """Return whether samples soon contradict friction that was found where parameters had followed them.

        Much more than what had followed them without it: else the parameters may have changed.
        """
        state, trial = self._state, self._state.trial
        if trial is None or state.n_samples > trial.n_samples or not state.friction:
            state.trial = None
            return False
        if state.n_since < FEWEST:
            return False
        residuals, samples = self._residuals, state.samples[-state.n_since :]
        before = replace(residuals.known, friction=Friction(), disturbance=trial.offset * residuals.sigma)
        with_friction = residuals.rows(state.reference_or(trial.theta), samples)
        without = residuals.scaled_rows(trial.theta, before.without_all(samples))
        return bool(np.sum(without**2) + MARGIN <= BETTER * np.sum(with_friction**2))

    def _take_back(self, t: float) -> Settled:
        """Forget friction that has not proven itself, and return to the parameters that had followed the samples."""
        state, trial = self._state, self._state.trial
        assert trial is not None
        state.friction, state.offset, state.trial = Friction(), trial.offset, None
        state.end_suspicion()
        state.path = state.path.begin(self._residuals.space.to_unit(trial.theta))
        return Settled(trial.theta, (self._record.friction(t, _NO_FRICTION),), True)

    def _is_due(self) -> bool:
        """Return whether an effect is to be sought in the samples since the parameters that lasted were contradicted.

        That is after 16 samples, and then each time after half as many more.
        """
        state = self._state
        n = state.n_samples - state.lasting_at
        if n < _EARLIEST or state.n_samples < state.next_effect:
            return False
        state.next_effect = state.n_samples + n // 2
        return True
