"""Diagnosis of samples that contradict the parameters in force: changed parameters, a disturbance, or neither.

quiet        the parameters in force explain the samples; the residuals' true size is learnt
suspicious   they do not, from an onset on; new parameters are warranted where they explain the samples since then

A suspicion ends when the parameters in force, new ones perhaps, explain the samples again; or with a search for
parameters that has found none: then either a constant disturbance explains them, and is subtracted from now on, or
nothing does, and the channels concerned rest. See `comparison` for how that is found.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .comparison import FEWEST, LONG, QUIET, WINDOW, HypothesisComparison
from .diagnosis_record import DiagnosisRecord
from .diagnosis_settings import FORGOTTEN, PATIENCE, DiagnosisSettings, is_at_unseen_bound
from .diagnosis_state import DiagnosisState
from .effect_diagnosis import EffectDiagnosis
from .events import Event
from .evidence import Evidence
from .friction_comparison import FrictionComparison
from .hypotheses import FALSE_ALARM, MARGIN, Disturbance, disturbance_of, n_channels_of, plain_fit
from .lag_comparison import LagComparison
from .lasting import LastingParameters
from .samples import DerivativeResidual, Sample
from .settled import Settled
from .significance import chi2_limit
from .space import Vector
from .standardised_residuals import StandardisedResiduals
from .wandering import agree

_SURE: Final = 10
"""Number of samples on which a lag need not explain better than changed parameters, which have more values."""
_PASSED: Final = "a disturbance has passed: the parameters before it explain the samples again"
_SPARE: Final = 10
"""Least number of explained values in excess of the fitted ones that makes good for a search in vain."""


class Diagnosis:
    """Diagnosis on sampled derivatives: onset and end of a suspicion, disturbances and rests."""

    def __init__(
        self,
        declared: DerivativeResidual,
        names: Sequence[str],
        settings: DiagnosisSettings,
        may_lag: Sequence[int] | None = None,
        inputs: Sequence[str] = (),
    ) -> None:
        """declared: residual (c,) in standard deviations of the declared noise; names (c,): of the channels; settings:
        of false alarms and rests; may_lag: places in the input of what actuators may delay, by default all; inputs
        (p,): names."""
        self._settings, self._space = settings, declared.space
        self._state = state = DiagnosisState.at_start(len(names), may_lag)
        self.residuals = residuals = StandardisedResiduals(declared, state)
        self.evidence = evidence = Evidence()
        self.comparison = HypothesisComparison(state, residuals, evidence)
        self._lag = LagComparison(state, residuals, evidence)
        self._friction = FrictionComparison(state, residuals, evidence)
        self._lasting = LastingParameters(state, residuals)
        self._record = DiagnosisRecord(state, residuals, names, inputs)
        self._effects = EffectDiagnosis(state, residuals, self._lag, self._friction, self._lasting, self._record)

    @property
    def is_suspicious(self) -> bool:
        """True where the samples contradict the parameters in force."""
        return self._state.n_since > 0

    @property
    def is_resting(self) -> bool:
        """True where every channel rests."""
        return bool(self._state.is_resting.all())

    @property
    def n_since(self) -> int:
        """Number of samples since the onset of the suspicion, at most 20; 0 while quiet."""
        return self._state.n_since

    def snapshot(self) -> DiagnosisState:
        """Return the present state, for `restore`."""
        return self._state.copy()

    def restore(self, state: DiagnosisState) -> None:
        """Go back to a snapshot, which is used up."""
        self._state.restore(state)

    def summary(self) -> dict[str, Any]:
        """Return what is known of each channel, and the number of events of each kind, as JSON values."""
        return self._record.summary()

    def observe(self, sample: Sample, held: Vector) -> bool:
        """Take a sample, with the parameters in force (d,); return whether residuals are to be computed anew."""
        state = self._state
        state.n_samples += 1
        state.inputs.take(sample)
        state.way = state.way.go(self._space.to_unit(held))
        has_woken = state.wake()
        corrected = self.residuals.corrected(sample)
        declared = self.residuals.declared(held, corrected)
        if state.is_resting.any():
            state.rested.append(self.residuals.declared(held, state.friction.without(sample)))
            state.resting = state.resting.take(np.where(state.is_resting, state.rested[-1] - state.offset, 0.0))
            if state.resting.is_outgrown:
                self.evidence.outgrown(self._record.names, state.resting)
                state.wake_early()
                has_woken = True
        missing = int(np.count_nonzero(state.is_resting | np.isnan(corrected.xdot)))
        is_contradictory = not self._is_usual(declared / state.scale.values, len(declared) - missing)
        state.keep(sample, WINDOW)
        state.keep_since_lasting(sample)
        if is_contradictory and not state.n_since and (self._lag.take_again(held) or self._friction.take_again(held)):
            is_contradictory, has_woken = False, True
        if state.n_since or is_contradictory:
            if not state.n_since:
                state.reference, state.verdict, state.changed, state.has_moved = held, "refuted", None, False
                state.largest_in_vain = None
                if state.lasting is None or state.n_samples >= state.suspected_at + FORGOTTEN:
                    state.lasting, state.lasting_at, state.since_lasting = held, state.n_samples, []
                    state.next_effect = 0
                state.n_calm = state.n_samples - state.suspected_at - 1
                if state.n_samples >= state.suspected_at + WINDOW:
                    state.restless_since, state.next_lag = state.n_samples, 0
                    state.way = state.way.begin(self._space.to_unit(held))
            state.n_since, state.n_quiet = min(state.n_since + 1, len(state.samples)), 0
            state.suspected_at = state.n_samples
            state.has_moved |= state.reference is None or not np.array_equal(held, state.reference)
            return has_woken
        state.n_quiet += not state.is_resting.any()
        if state.n_quiet >= FORGOTTEN:
            state.n_quiet, state.n_failures = 0, max(state.n_failures - 1, 0)
        return (not missing and state.scale.learn(declared)) or has_woken

    def settle(self, t: float, held: Vector) -> Settled | None:
        """End the suspicion where one hypothesis has won, from the samples since the onset; None where it goes on."""
        state = self._state
        n = state.n_since
        settled = self._effects.late(t, held)
        if settled is not None:
            state.largest_in_vain = None  # it was this
            return settled
        if not n:
            return self._passed_since(t)
        reference = state.reference_or(held)
        if self._friction.end(reference, min(n, QUIET)):
            return self._effects.adopt_friction(t, None)
        is_changed = not np.array_equal(reference, held)
        here = self.residuals.of_newest(held, n)
        is_explained = n >= QUIET and plain_fit(here[-QUIET:], 0).is_explained
        if is_explained and not is_changed:
            return self._explained(t, held, n)
        there = self.residuals.of_newest(reference, n) if is_changed else here
        if self._is_over(here, there, is_changed, is_explained) and not (
            is_explained and self.comparison.is_changing(held, n)
        ):
            return self._passed(t, reference, there, is_changed)
        if n < LONG:
            return None
        if self._lasting.are_better(held, here):
            return self.give_up(t)
        disturbance = disturbance_of(there, may_drift=False)
        parameters, nothing = plain_fit(here, len(self._space)), plain_fit(there, 0)
        self.evidence.note(n, nothing=nothing, disturbance=disturbance.fit)
        if is_changed and nothing.is_explained and nothing.score <= min(parameters.score, disturbance.fit.score):
            return self._effects.larger_noise(reference, held, n)
        if is_changed and is_explained and parameters.is_explained:
            self.evidence.note(n, parameters=parameters)
            return self._changed(t, held) if disturbance.fit.score >= parameters.score + MARGIN else None
        late = self._lag.newest(reference, n) if self._lag.is_due else None
        if late is not None:
            best = self.comparison.best(held, late.n, may_drift=True).fit
            if late.fit.score + (MARGIN if late.n < _SURE else 0.0) <= best.score:
                return self._effects.adopt(t, late)
        is_named = disturbance.fit.is_explained and disturbance.fit.score + MARGIN <= nothing.score
        if is_named and n % 2 == 0 and not self.comparison.is_changing(held, n):
            before = self._lasting.before(reference, n)
            events = self._name(t, disturbance_of(self.residuals.of_newest(before, n), may_drift=False))
            return Settled(self._lasting.undone(before), events, True)
        return None

    def _explained(self, t: float, held: Vector, n: int) -> Settled:
        """End a suspicion, n samples long, as the parameters in force explain the samples again.

        Where searches have gone from those that lasted and have come back to them, a disturbance has passed. Where
        several samples contradicted those in force, and nothing else was tried, that counts as a search in vain.
        """
        state, lasting = self._state, self._state.lasting
        if state.has_moved and lasting is not None and agree(self._space.to_unit(lasting), self._space.to_unit(held)):
            there = self.residuals.of_newest(lasting, n)
            if plain_fit(there[-QUIET:], 0).is_explained:
                return self._passed(t, lasting, there, True)
        state.n_since = 0
        rows = self.residuals.of_newest(held, n)
        if not state.has_moved and sum(not self._is_usual(row, n_channels_of(rows)) for row in rows) >= FEWEST:
            state.n_failures += 1
        return Settled(None)

    def _is_over(self, here: Vector, there: Vector, is_changed: bool, is_explained: bool) -> bool:
        """Return whether the reference explains the newest samples again, and those in force do not explain all.

        here, there: residuals (n, c) since the onset of the parameters in force and of the reference.
        """
        state = self._state
        without = there + np.where(state.is_resting, 0.0, state.offset / state.scale.effective)
        newest = slice(-QUIET, None) if is_changed else slice(None)
        before = plain_fit(without[newest], 0)
        if not before.is_explained:
            return False
        if is_explained:
            return is_changed and not plain_fit(here, 0).is_explained
        return len(here) >= FEWEST and before.score + MARGIN <= plain_fit(here[newest], 0).score

    def _changed(self, t: float, held: Vector) -> Settled:
        """End a suspicion that changed parameters, those in force, have won."""
        if self._is_restless(held):
            return self.give_up(t, rests=True)
        self._state.n_since, self._state.reference = 0, held
        return Settled(None)

    def give_up(self, t: float, *, rests: bool = False) -> Settled:
        """Return to the parameters that lasted, as others explain the samples for a while only.

        The third time, or where it rests at once, all channels rest.
        """
        state = self._state
        before = state.lasting if state.reference is None else self._lasting.accepted(state.reference)
        found = None if before is None else self._effects.lacking(before)
        if found is None and before is not None and state.n_since >= LONG:
            found = self._lag.newest(before, state.n_since)
        if found is not None:
            return self._effects.adopt(t, found)
        state.end_suspicion()
        state.way = state.way.begin(None if before is None else self._space.to_unit(before))
        if before is not None:
            self._friction.doubt(before)
        every = ~state.is_resting
        event = self._record.unexplained(t, every, "parameters explain {} for a few samples only")
        state.n_failures = max(state.n_failures + 1, PATIENCE if rests else 0)
        if state.n_failures < PATIENCE:
            return Settled(before, (event,), True)
        state.findings = state.findings.forget()
        return Settled(before, (event, self._rest(t, every)), True)

    def accept(self, theta: Vector) -> None:
        """Take parameters (d,) that are warranted and in force for those that the next ones are compared with."""
        if self._state.n_since:
            self._state.reference, self._state.n_calm = theta, 0

    def expect(self, is_identifiable: Sequence[bool]) -> None:
        """Take a proposal that is passed on, with which of its parameters (d,) the samples determine."""
        state = self._state
        state.way = state.way.expect(np.array(is_identifiable) if state.n_since else None)

    def is_wandering(self, held: Vector) -> bool:
        """Return whether parameters have gone to and fro on the way to those in force (d,).

        By half of their bounds in excess of that way, each time determined by the samples: no change of the plant's
        does that.
        """
        return self._state.n_since > 0 and self._state.way.is_to_and_fro(self._space.to_unit(held))

    def is_at_unseen_bound(self, theta: Vector, std: Vector, held: Vector) -> bool:
        """Return whether a parameter would move to a bound although its standard deviation is as wide as the bounds.

        Or anywhere, while channels rest.
        """
        return is_at_unseen_bound(self._space, theta, std, held, not self._state.is_resting.any())

    def suspend(self) -> Vector | None:
        """End the suspicion, whose samples are doubtful; return the parameters (d,) to go back to, None without one."""
        state = self._state
        if not state.n_since:
            return None
        state.end_suspicion()
        return state.reference

    def fail(self, t: float, theta: Vector | None, held: Vector) -> Settled | None:
        """Take the end of a search that has found no parameters, theta (d,) being the best; None for a false alarm.

        A disturbance is named where a constant one explains the samples. After the third time, one soon after the
        other, the channels that neither explains rest, longer each time.
        """
        state = self._state
        n = min(state.n_since, QUIET)
        reference = state.reference_or(held)
        rows = self.residuals.of_newest(reference, n)
        found = disturbance_of(rows)
        self.evidence.note(n, nothing=plain_fit(rows, 0), disturbance=found.fit)
        if plain_fit(rows, 0).score <= found.fit.score:  # a false alarm
            state.end_suspicion()
            return None
        late = self._lag.newest(reference, state.n_since) if state.n_since >= LONG else None
        if late is not None:
            return self._effects.adopt(t, late)
        if (self.comparison.is_changing(held, n) and not state.is_resting.any()) or self.comparison.adopt_noise(held):
            return None
        explaining = [
            d for d in (found, self.comparison.with_disturbance(held, n)) if d is not None and d.fit.is_explained
        ]
        before = self._lasting.before(reference, n)
        if n >= QUIET and explaining:
            best = min(explaining, key=lambda d: d.fit.score)
            if best is found:
                best = disturbance_of(self.residuals.of_newest(before, n))
            events = self._name(t, best)
            return Settled(self._lasting.undone(before), events, True)
        state.largest_in_vain = _largest(self.residuals.of_newest(before, state.n_since))
        state.end_suspicion()
        self._friction.doubt(before)
        lacks = self._lacking_channels(rows if theta is None else self.residuals.of_newest(theta, n))
        event = self._record.unexplained(t, lacks, "no parameters explain {}")
        events = (event, *self._in_vain(t, lacks))
        return Settled(self._lasting.undone(before), events, True)

    def _lacking_channels(self, rows: Vector) -> NDArray[np.bool_]:
        """Return the channels (c,) that residuals (n, c) are too large on; all that do not rest where there is none."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.nan_to_num(np.sum(rows**2, axis=0), nan=np.inf)
        lacks = squares > chi2_limit(FALSE_ALARM / rows.shape[1], len(rows))
        return lacks if lacks.any() else ~self._state.is_resting

    def _in_vain(self, t: float, channels: NDArray[np.bool_]) -> tuple[Event, ...]:
        """Count a search in vain; return the event of the rest of these channels (c,), where it was one too many."""
        self._state.n_failures += 1
        return () if self._state.n_failures < PATIENCE else (self._rest(t, channels),)

    def _name(self, t: float, found: Disturbance) -> tuple[Event, ...]:
        """Take a disturbance for the explanation; return the events."""
        state = self._state
        state.end_suspicion()
        offset = state.offset + found.newest * state.scale.effective
        acts = _acting(np.maximum(found.largest, np.abs(offset) / state.scale.effective))
        if found.is_constant:  # else it is another one in the next sample
            state.offset = offset
        how = "constant" if found.is_constant else "changing"
        event = self._record.disturbance(
            t, offset, acts, f"a {how} disturbance explains the samples, changed parameters do not"
        )
        return event, *self._in_vain(t, acts)

    def _passed(self, t: float, before: Vector, rows: Vector, is_changed: bool) -> Settled:
        """End a suspicion as the parameters before it (d,), whose residuals are rows (n, c), explain the samples again.

        is_changed: true where others are in force. They are undone, and a disturbance that was not known is named.
        """
        state = self._state
        largest = _largest(rows)
        acts, was_known = _acting(np.abs(largest)), bool(np.any(state.offset))
        n_unusual = sum(not self._is_usual(row, n_channels_of(rows)) for row in rows)
        lasting, n_newest = state.lasting, min(len(rows), QUIET)
        if lasting is not None and plain_fit(self.residuals.of_newest(lasting, n_newest), 0).is_explained:
            before = lasting
        events: tuple[Event, ...] = ()
        if was_known:
            events = (Event(t, "disturbance", {"size": {}, "reason": "the disturbance is over"}),)
        elif is_changed and n_unusual >= FEWEST:
            events = (self._record.disturbance(t, largest * state.scale.effective, acts, _PASSED),)
        state.offset, state.n_since = np.zeros(len(acts)), 0
        if not is_changed:
            return Settled(None, events, True)
        events = (*events, *self._in_vain(t, acts))
        return Settled(self._lasting.undone(before), events, True)

    def _passed_since(self, t: float) -> Settled | None:
        """Name a disturbance, the last search being in vain, as the parameters before it explain the samples again."""
        state, largest = self._state, self._state.largest_in_vain
        if largest is None or state.n_quiet < QUIET or np.any(state.offset):
            return None
        state.largest_in_vain = None
        return Settled(
            None,
            (self._record.disturbance(t, largest * state.scale.effective, _acting(np.abs(largest)), _PASSED),),
            True,
        )

    def succeed(self, t: float, theta: Vector) -> Settled | None:
        """Take the end of a search that has found parameters theta (d,).

        Earlier failures count less, if that proves anything. But parameters that are never proven and move on from
        search to search, by more than they may drift, explain nothing: the third time they are undone.
        """
        state = self._state
        if self._is_restless(theta):
            return self.give_up(t, rests=True)
        if state.n_spare >= _SPARE and not state.findings.has_moved:
            state.n_failures = max(state.n_failures - 1, 0)
        return None

    def _is_restless(self, theta: Vector) -> bool:
        """Take parameters (d,) that were found; return whether three of five such, soon one after the other, differ."""
        state = self._state
        state.findings = state.findings.take(state.n_samples, self._space.to_unit(theta))
        return state.findings.are_restless

    def _rest(self, t: float, channels: NDArray[np.bool_]) -> Event:
        """Let the channels rest, all of them where some do already, longer each time; return the event."""
        state = self._state
        channels = ~state.is_resting if state.is_resting.any() else channels
        length = self._settings.rest_length(state.n_failures)
        state.rest(channels, length)
        state.largest_in_vain = None
        return self._record.rest(t, channels, length)

    def _is_usual(self, row: Vector, n_sampled: int) -> bool:
        return not n_sampled or float(row @ row) <= chi2_limit(self._settings.false_alarm, n_sampled)


def _largest(rows: Vector) -> Vector:
    """Return the value (c,) of largest size in each column of rows (n, c)."""
    return rows[np.abs(rows).argmax(axis=0), np.arange(rows.shape[1])]


def _acting(largest: Vector) -> NDArray[np.bool_]:
    """Return which channels (c,) a disturbance acts on, from its largest size (c,) there: one at least."""
    acts = largest > np.sqrt(chi2_limit(FALSE_ALARM, 1))
    return acts if acts.any() else largest >= largest.max()
