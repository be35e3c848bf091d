"""Diagnosis of samples that contradict the parameters in force: changed parameters, a disturbance, or neither.

quiet        the parameters in force explain the samples; the residuals' true size is learnt
suspicious   they do not, from an onset on; new parameters are warranted where they explain the samples since then

A suspicion ends when the parameters in force, new ones perhaps, explain the samples again; or with a search for
parameters that has found none: then either a constant disturbance explains them, and is subtracted from now on, or
nothing does, and the channels concerned rest. See `comparison` for how that is found. The ends of a suspicion that
something beside the model has won are in `effect_diagnosis` and `disturbance_diagnosis`, those that come with the end
of a search in `search_diagnosis`.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from ..arrival_cost import ArrivalCost
from ..effects.step_means import StepMeans
from ..hypotheses import MARGIN, disturbance_of, plain_fit
from ..samples import DerivativeResidual, Sample
from ..space import Vector
from .comparison import HypothesisComparison
from .disturbance_diagnosis import DisturbanceDiagnosis
from .doubtful_samples import DoubtfulSamples
from .drift_rival import DriftRival
from .effect_diagnosis import EffectDiagnosis
from .evidence import Evidence
from .failed_searches import FailedSearches
from .friction_comparison import FrictionComparison
from .lag_comparison import LagComparison
from .lasting import LastingParameters
from .record import DiagnosisRecord
from .search_diagnosis import SearchDiagnosis
from .settings import CALM, FEWEST, LONG, QUIET, DiagnosisSettings, is_at_unseen_bound
from .settled import Settled
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState
from .wandering import InForce, agree

_SURE: Final = 10
"""Number of samples on which a lag need not explain better than changed parameters, which have more values."""


class Diagnosis:
    """Diagnosis on sampled derivatives: decides when a suspicion begins and ends, and which hypothesis has won."""

    def __init__(
        self,
        declared: DerivativeResidual,
        names: Sequence[str],
        settings: DiagnosisSettings,
        may_lag: Sequence[int] | None,
        inputs: Sequence[str] = (),
        means: StepMeans | None = None,
    ) -> None:
        """declared: residual (c,) in standard deviations of the declared noise; names (c,): of the channels; settings:
        of false alarms and rests; may_lag: places in the input of what actuators may delay, None for all; inputs (p,):
        names; means: that a filter's samples have of the inputs, None where samples have those of their own step."""
        self._settings, self._space = settings, declared.space
        self._state = state = DiagnosisState.at_start(len(names), may_lag, means or StepMeans())
        self.residuals = residuals = StandardisedResiduals(declared, state)
        self.evidence = evidence = Evidence()
        self._lag = LagComparison(state, residuals, evidence)
        self.comparison = HypothesisComparison(state, residuals, evidence, self._lag)
        self._friction = FrictionComparison(state, residuals, evidence)
        self._lasting = LastingParameters(state, residuals)
        self._doubtful = DoubtfulSamples(state, residuals, self._lasting)
        self._record = DiagnosisRecord(state, residuals, names, inputs)
        failed_searches = FailedSearches(state, settings, self._record)
        self._effects = EffectDiagnosis(state, residuals, self._lag, self._friction, self._lasting, self._record)
        self._disturbances = DisturbanceDiagnosis(
            state, residuals, settings, self._lasting, failed_searches, self._record, evidence
        )
        self.searches = SearchDiagnosis(
            state, residuals, self.comparison, self._lag, self._friction, self._lasting, self._effects,
            self._disturbances, failed_searches, self._record, evidence,
        )  # fmt: skip

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
        """Number of the samples kept since the onset of the suspicion, 20 at most; 0 while quiet."""
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

    def keep_input(self, sample: Sample) -> None:
        """Take the input of a sample that is kept out: it acts on the plant all the same, and later perhaps."""
        if self._state.inputs.means:
            return  # those of the steps are known
        self._state.inputs = self._state.inputs.copy()  # what is made of the one before is made anew
        self._state.inputs.take(sample)

    def take_input(self, t: float, u: tuple[float, ...]) -> None:
        """Take the input (p,) held up to t [s], where samples have means of those of several steps."""
        if self._state.inputs.means:
            self._state.inputs.take_input(t, u)

    def observe(self, sample: Sample, held: Vector, expects: Callable[[Sample], bool] = lambda sample: False) -> bool:
        """Take a sample, with the parameters in force (d,); return whether residuals are to be computed anew.

        expects: returns whether a filter explains a corrected sample that these contradict.
        """
        state = self._state
        state.n_samples += 1
        state.inputs.take(sample)
        z = self._space.to_unit(held)
        state.path, state.in_force = state.path.moved_to(z), state.in_force.take(state.n_samples, held)
        if state.has_lasted(held):
            state.lasting_until = state.n_samples
        is_anew = state.wake()
        corrected = self.residuals.corrected(sample)
        declared = self.residuals.declared(held, corrected)
        is_anew |= self._end_rest(sample, held)
        is_missing = state.is_resting | np.isnan(corrected.xdot)
        n_values = len(declared) - int(np.count_nonzero(is_missing))
        is_contradictory = not self._settings.is_usual(declared / state.scale.values, n_values)
        state.keep(sample)
        if is_contradictory and not state.n_since and (self._lag.take_again(held) or self._friction.take_again(held)):
            is_contradictory, is_anew = False, True
        is_expected = is_contradictory and not state.n_since and expects(corrected)
        if state.n_since or (is_contradictory and not is_expected):
            if not state.n_since:
                state.begin_suspicion(held, z)
            state.count_suspicious(held)
            return self._disturbances.take_change(self.comparison.changed_with_disturbance(held)) or is_anew
        state.count_quiet()
        self.comparison.quiet.learn_noise(held)
        if is_expected:
            return is_anew
        return state.scale.learn(np.where(is_missing, np.nan, declared)) or is_anew

    def _end_rest(self, sample: Sample, held: Vector) -> bool:
        """Take a sample of a rest, and return whether it ends the rest before its time.

        Residuals have outgrown all before in it; or they have been no more than noise, with a known disturbance or
        without it, for as long as they had been more.
        """
        state = self._state
        if not np.count_nonzero(state.is_resting):
            return False
        rested = self.residuals.declared(held, self.residuals.known.on_all_channels().without(sample))
        rested = np.where(state.is_resting & np.isnan(sample.xdot), np.nan, rested)
        state.rested.append(rested)
        least = np.where(np.abs(rested) < np.abs(rested - state.offset), rested, rested - state.offset)
        state.resting = state.resting.take(np.where(state.is_resting, least, 0.0), state.scale.values)
        if state.resting.is_outgrown:
            self.evidence.outgrown(self._record.names, state.resting)
            state.wake_early()
            return True
        names = [self._record.names[i] for i in np.flatnonzero(state.is_resting)]
        if state.resting.is_calm(state.n_samples - state.restless_since - state.resting.n_calm):
            self.evidence.rest_ended(names, CALM)
            state.wake_calm()
            return True
        if self.comparison.has_changed_in_rest(held):
            self.evidence.rest_ended(names, "changed parameters explained the newest hundred samples")
            state.wake_to_change()
            return True
        return False

    def settle(self, t: float, held: Vector) -> Settled | None:
        """End the suspicion where one hypothesis has won, from the samples since the onset; None where it goes on."""
        state, n = self._state, self._state.n_since
        settled = self._effects.since_lasting(t, held)
        if settled is not None:
            state.largest_unexplained = None  # it was this
            return settled
        settled = self._disturbances.over(t, held)
        if settled is not None:
            return settled
        if not n:
            return self._disturbances.passed_since(t)
        if n == 1 and state.has_lasted(held) and self.comparison.quiet.admit_noise(held):
            state.end_suspicion()  # a newest sample that is more than noise begins another
            return Settled(None, ends_search=True)
        reference = state.reference_or(held)
        if self._friction.end(reference, min(n, QUIET)):
            return self._effects.adopt_friction(t, None)
        is_changed = not np.array_equal(reference, held)
        of_held = self.residuals.of_newest(held, n)
        is_explained = n >= QUIET and plain_fit(of_held[-QUIET:], 0).is_explained
        if is_explained and not is_changed:
            return self._explained(t, held, n)
        of_reference = self.residuals.of_newest(reference, n) if is_changed else of_held
        is_over = self._disturbances.has_passed(of_held, of_reference, is_changed, is_explained)
        if is_over and not self._is_changing(held, n, is_explained):
            return self._disturbances.passed(t, reference, of_reference, is_changed)
        if n < LONG:
            late = self._lag.at_once(reference, disturbance_of(of_reference).fit)
            if late is None or late.fit.score + MARGIN > self.comparison.best(held, n, may_drift=True).fit.score:
                return None
            return self._effects.adopt(t, late)
        if self._lasting.are_better(held, of_held):
            return self.searches.give_up(t)
        return self._weighed(t, held, of_held, of_reference, is_explained)

    def _is_changing(self, held: Vector, n: int, is_explained: bool) -> bool:
        """Return whether changed parameters explain the newest n samples, all since the onset; held (d,): in force.

        Constant ones, or also drifting ones where those in force explain the very newest samples.
        """
        return (is_explained or n >= LONG) and self.comparison.is_changing(held, n, may_drift=is_explained)

    def _weighed(
        self, t: float, held: Vector, of_held: Vector, of_reference: Vector, is_explained: bool
    ) -> Settled | None:
        """End a long suspicion where noise, changed parameters, a lag or a disturbance has won; None without a winner.

        of_held, of_reference: residuals (n, c) of the parameters in force, held (d,), which explain the very newest
        samples or not, and of the reference.
        """
        state, n = self._state, len(of_held)
        reference = state.reference_or(held)
        is_changed = of_reference is not of_held
        disturbance = disturbance_of(of_reference, may_drift=False)
        parameters, nothing = plain_fit(of_held, len(self._space)), plain_fit(of_reference, 0)
        self.evidence.note(n, nothing=nothing, disturbance=disturbance.fit)
        is_noise = is_changed and nothing.is_explained and nothing.score <= min(parameters.score, disturbance.fit.score)
        if is_noise or self.comparison.noise.adopt_white(held, reference):
            return self._effects.larger_noise(reference, held, n)
        if is_changed and is_explained and parameters.is_explained:
            self.evidence.note(n, parameters=parameters)
            return self._changed(t, held) if disturbance.fit.score >= parameters.score + MARGIN else None
        is_due = self._lag.is_due
        late = self._lag.in_newest(reference, n) if is_due else None
        if late is not None:
            best = self.comparison.best(held, late.n, may_drift=True).fit
            is_told_apart = not (late.has_limits and best.is_explained)  # a drift of parameters has more values
            if is_told_apart and late.fit.score + (MARGIN if late.n < _SURE else 0.0) <= best.score:
                return self._effects.adopt(t, late)
        if is_due and not state.inputs.means:  # a filter's samples are too few
            beside = self.searches.late_beside_change(held, reference, is_early=True)
            if beside is not None:
                return self._effects.adopt(t, beside)
        is_named = disturbance.fit.is_explained and disturbance.fit.score + MARGIN <= nothing.score
        if is_named and n % 2 == 0 and not self.comparison.may_be_parameters(held, n, disturbance.fit):
            before = self._lasting.before(reference, n)
            found = disturbance_of(self.residuals.of_newest(before, n), may_drift=False)
            return self._disturbances.adopt(t, found, before)
        return None

    def _explained(self, t: float, held: Vector, n: int) -> Settled:
        """End a suspicion, n samples long, as the parameters in force explain the samples again.

        Where searches have gone from those that lasted and have come back to them, a disturbance has passed. Where
        several samples contradicted those in force, and nothing else was tried, that counts as a failed search; not
        where changed parameters are proven by them, which may have been kept from being written.
        """
        state, lasting = self._state, self._state.lasting
        if state.has_moved and lasting is not None and agree(self._space.to_unit(lasting), self._space.to_unit(held)):
            of_reference = self.residuals.of_newest(lasting, n)
            if plain_fit(of_reference[-QUIET:], 0).is_explained:
                return self._disturbances.passed(t, lasting, of_reference, True)
        state.n_since = 0
        rows = self.residuals.of_newest(held, n)
        is_in_vain = not state.has_moved and self._settings.n_unusual(rows) >= FEWEST
        if is_in_vain and not self.comparison.has_changed(held, n):
            state.n_failures += 1
            if state.has_lasted(held) and state.admit_usual(rows):
                return Settled(None, ends_search=True)  # what was found on these samples was noise
        return Settled(None)

    def _changed(self, t: float, held: Vector) -> Settled:
        """End a suspicion that changed parameters, those in force, have won."""
        if self.searches.is_restless(held):
            return self.searches.give_up(t, rests=True)
        self._state.n_since, self._state.reference = 0, held
        return Settled(None)

    def judged_drift(self, known: ArrivalCost, sample: Sample) -> ArrivalCost | None:
        """Return what a filter that lets parameters drift goes on with after a sample; None where no drift explains it.

        known: by the filter; sample: the newest one, corrected. Where it has begun to follow, the newest 20 samples say
        what disturbance there is beside the parameters that lasted.
        """
        state = self._state
        if state.lasting is None:
            return None if known.is_refuted else known
        rival = state.drift_rival
        if rival is None or rival.n_samples != state.n_samples - 1:
            rows = self.residuals.of_newest(state.lasting, min(len(state.samples), WINDOW))
            rival = DriftRival.of_rows(rows[:-1], state.n_samples - 1)
        updated = rival.updated(self.residuals.scaled(state.lasting, sample), known)
        state.drift_rival, known_after = updated.judged(known)
        return known_after

    def accept(self, theta: Vector) -> None:
        """Take parameters (d,) that are warranted and in force for those that the next ones are compared with."""
        if self._state.n_since:
            self._state.reference, self._state.n_calm = theta, 0

    def may_follow(self, held: Vector) -> bool:
        """Return whether a filter's parameters may replace those in force, held (d,), which nothing contradicts.

        Where these were found or followed since the start or the last return; else samples must prove a change.
        """
        return self._state.in_force.have_changed or self.comparison.has_changed_slowly(held)

    def expect(self, is_identifiable: Sequence[bool]) -> None:
        """Take a proposal that is passed on, with which of its parameters (d,) the samples determine."""
        state = self._state
        state.path = state.path.expect(np.array(is_identifiable) if state.n_since else None)

    def is_wandering(self, held: Vector) -> bool:
        """Return whether parameters have gone to and fro on the way to those in force (d,).

        By half of their bounds in excess of that way, each time determined by the samples: no change of the plant's
        does that.
        """
        return self._state.n_since > 0 and self._state.path.is_to_and_fro(self._space.to_unit(held))

    def is_at_unseen_bound(self, theta: Vector, std: Vector, held: Vector) -> bool:
        """Return whether a parameter would move to a bound although its standard deviation is as wide as the bounds.

        Or anywhere, while channels rest.
        """
        return is_at_unseen_bound(self._space, theta, std, held, not self._state.is_resting.any())

    def suspend(self, n: int) -> Vector | None:
        """End the suspicion, as the newest n samples are doubtful; return what to go back to (d,), if anything."""
        return self._doubtful.undone(n)

    def returned(self, theta: Vector) -> None:
        """Take a return to earlier parameters (d,): what was in force before is over, too."""
        self._state.in_force = InForce(((self._state.n_samples, theta),))

    def reverted(self, theta: Vector) -> None:
        """Take a revert of the guard's to theta (d,): nothing returns to those that came after it."""
        if self._state.lasting_at >= self._state.in_force.left_at(theta):
            self._state.begin_lasting(theta)
        self.accept(theta)
        self.returned(theta)
