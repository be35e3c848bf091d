"""End of a suspicion as a disturbance explains the samples, or has passed."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import MARGIN, Disturbance, plain_fit
from ..significance import FALSE_ALARM, chi2_limit
from ..space import Vector
from .evidence import Evidence
from .failed_searches import FailedSearches
from .lasting import LastingParameters
from .record import DiagnosisRecord
from .settings import FEWEST, PASSED, QUIET, DiagnosisSettings
from .settled import Settled
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState
from .wandering import agree

_TOGETHER: Final = "a constant disturbance explains the samples together with changed parameters"
_STEADY: Final = 0.25
"""Largest move of parameters that stay, as a share of the way to them."""
_OVER: Final = 10
"""Number of newest samples that show that a known disturbance is over."""


class DisturbanceDiagnosis:
    """Diagnosis of disturbances: a constant one is known then, and whatever has passed is named."""

    def __init__(
        self,
        state: DiagnosisState,
        residuals: StandardisedResiduals,
        settings: DiagnosisSettings,
        lasting: LastingParameters,
        failed_searches: FailedSearches,
        record: DiagnosisRecord,
        evidence: Evidence,
    ) -> None:
        self._state, self._residuals, self._settings = state, residuals, settings
        self._lasting, self._failed_searches, self._record, self._evidence = lasting, failed_searches, record, evidence

    def adopt(self, t: float, found: Disturbance, before: Vector) -> Settled:
        """End a suspicion as a disturbance explains the samples, with the parameters before them (d,)."""
        state = self._state
        state.end_suspicion()
        offset = state.offset + found.newest * state.scale.effective
        acts = _acting(np.maximum(found.largest, np.abs(offset) / state.scale.effective))
        if found.is_constant:
            state.offset, state.undisturbed = offset, before
        else:  # it is another one in the next sample
            state.is_disturbed = True
        how = "constant" if found.is_constant else "changing"
        reason = f"a {how} disturbance explains the samples, changed parameters do not"
        named = self._record.disturbance(t, offset, acts, reason, is_known=found.is_constant)
        events = (named, *self._failed_searches.count(t, acts))
        return Settled(self._lasting.undone(before), events, True)  # a channel may have begun to rest

    def take_change(self, change: Disturbance | None) -> bool:
        """Take a change of the known disturbance that comes with changed parameters; return whether there is one."""
        if change is None:
            return False
        state = self._state
        state.offset = state.offset + change.newest * state.scale.effective
        acts = _acting(np.abs(state.offset) / state.scale.effective)
        t = state.samples[-1].t
        self._evidence.add(self._record.disturbance(t, state.offset, acts, _TOGETHER, is_known=True))
        return True

    def has_passed(self, of_held: Vector, of_reference: Vector, is_changed: bool, is_explained: bool) -> bool:
        """Return whether the reference explains the newest samples again, and those in force do not explain all.

        of_held, of_reference: residuals (n, c) since the onset of the parameters in force and of the reference.
        """
        without = self._undisturbed(of_reference)
        newest = slice(-QUIET, None) if is_changed else slice(None)
        before = plain_fit(without[newest], 0)
        if not before.is_explained:
            return False
        if is_explained:
            return is_changed and not plain_fit(of_held, 0).is_explained
        return len(of_held) >= FEWEST and before.score + MARGIN <= plain_fit(of_held[newest], 0).score

    def passed(self, t: float, before: Vector, rows: Vector, is_changed: bool) -> Settled:
        """End a suspicion as the parameters before it (d,), whose residuals are rows (n, c), explain the samples again.

        is_changed: true where others are in force. They are undone, and a disturbance that was not known is named.
        """
        state, lasting = self._state, self._state.lasting
        largest = _largest(rows)
        acts = _acting(np.abs(largest))
        newest = min(len(rows), QUIET)
        if lasting is not None and plain_fit(self._residuals.of_newest(lasting, newest), 0).is_explained:
            before = lasting
        events = ()
        if np.any(state.offset):
            events = (self._record.disturbance_over(t),)
        elif is_changed and self._settings.n_unusual(rows) >= FEWEST:
            events = (self._record.disturbance(t, largest * state.scale.effective, acts, PASSED),)
        if is_changed and not np.any(state.offset) and state.has_lasted(before):
            state.admit_usual(rows)  # a known disturbance has explained them, which is no noise
        state.offset, state.n_since = np.zeros(len(acts)), 0
        if not is_changed:
            return Settled(None, events, True)
        events = (*events, *self._failed_searches.count(t, acts))
        return Settled(self._lasting.undone(before), events, True)

    def over(self, t: float, held: Vector) -> Settled | None:
        """Return to the parameters before a known disturbance where they explain the newest samples without it.

        Those in force, held (d,), may have been written as it faded, and explain the difference.
        """
        state, before = self._state, self._state.undisturbed
        if before is None or not np.any(state.offset) or len(state.samples) < _OVER:
            return None
        to_unit = self._residuals.space.to_unit
        if agree(to_unit(before), to_unit(held)) or self._are_steady(held, before):
            return None
        of_before, of_held = self._residuals.of_newest(np.array([before, held]), _OVER)
        of_before = self._undisturbed(of_before)
        fit = plain_fit(of_before, 0)
        if not fit.is_explained or fit.score > plain_fit(of_held, len(held)).score:
            return None
        return self.passed(t, before, of_before, True)

    def _are_steady(self, held: Vector, before: Vector) -> bool:
        """Return whether parameters in force, held (d,), have stayed for long, and explain the newest samples.

        They have hardly moved in 40 samples, by the way to them from those before the known disturbance (d,).
        """
        state, to_unit = self._state, self._residuals.space.to_unit
        moved = np.abs(to_unit(state.in_force.at(state.n_samples - 2 * WINDOW)) - to_unit(held)).max()
        if moved > _STEADY * np.abs(to_unit(before) - to_unit(held)).max() or len(state.samples) < WINDOW:
            return False
        return plain_fit(self._residuals.of_newest(held, WINDOW), 0).is_explained

    def _undisturbed(self, rows: Vector) -> Vector:
        """Return residuals (n, c) as they are without the known disturbance."""
        state = self._state
        return rows + np.where(state.is_resting, 0.0, state.offset / state.scale.effective)

    def await_end(self, rows: Vector) -> None:
        """Take the residuals (n, c) that a failed search leaves: those of a disturbance, should they pass."""
        self._state.largest_unexplained = _largest(rows)

    def passed_since(self, t: float) -> Settled | None:
        """Name a disturbance, as the last search has failed and the parameters before it explain the samples again."""
        state, largest = self._state, self._state.largest_unexplained
        if largest is None or state.n_quiet < QUIET or np.any(state.offset):
            return None
        state.largest_unexplained = None
        event = self._record.disturbance(t, largest * state.scale.effective, _acting(np.abs(largest)), PASSED)
        return Settled(None, (event,), True)


def _largest(rows: Vector) -> Vector:
    """Return the value (c,) of largest size in each column of rows (n, c)."""
    return rows[np.abs(rows).argmax(axis=0), np.arange(rows.shape[1])]


def _acting(largest: Vector) -> NDArray[np.bool_]:
    """Return which channels (c,) a disturbance acts on, from its largest size (c,) there: one at least."""
    acts = largest > np.sqrt(chi2_limit(FALSE_ALARM, 1))
    return acts if acts.any() else largest >= largest.max()
