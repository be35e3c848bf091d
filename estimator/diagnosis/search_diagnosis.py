"""End of a search for parameters: it has failed, has found some, or what was found before is given up."""

from typing import Final

from ..effects.known_effects import Explanation
from ..hypotheses import MARGIN, disturbance_of, plain_fit
from ..space import Vector
from .comparison import HypothesisComparison
from .disturbance_diagnosis import DisturbanceDiagnosis
from .effect_diagnosis import EffectDiagnosis
from .evidence import Evidence
from .failed_searches import FailedSearches
from .friction_comparison import FrictionComparison
from .lag_comparison import FEWEST_BESIDE, LagComparison
from .lasting import LastingParameters
from .record import DiagnosisRecord
from .residual_scale import NOISY
from .settings import LONG, PATIENCE, QUIET
from .settled import Settled
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState

_SPARE: Final = 10
"""Least number of explained values in excess of the fitted ones that makes good for a failed search."""


class SearchDiagnosis:
    """Diagnosis at the end of a search: a disturbance, what the model lacks, larger noise, or nothing explains."""

    def __init__(
        self,
        state: DiagnosisState,
        residuals: StandardisedResiduals,
        comparison: HypothesisComparison,
        lag: LagComparison,
        friction: FrictionComparison,
        lasting: LastingParameters,
        effects: EffectDiagnosis,
        disturbances: DisturbanceDiagnosis,
        failed_searches: FailedSearches,
        record: DiagnosisRecord,
        evidence: Evidence,
    ) -> None:
        self._state, self._residuals, self._comparison, self._lasting = state, residuals, comparison, lasting
        self._lag, self._friction = lag, friction
        self._effects, self._disturbances, self._failed_searches = effects, disturbances, failed_searches
        self._record, self._evidence = record, evidence

    def give_up(self, t: float, *, rests: bool = False) -> Settled:
        """Return to the parameters that lasted, as others explain the samples for a while only.

        The third time, or where it rests at once, all channels rest.
        """
        state = self._state
        before = state.lasting if state.reference is None else self._lasting.accepted(state.reference)
        found = None if before is None else self._effects.lacking(before)
        if found is None and before is not None and state.n_since >= LONG:
            found = self._effects.late(before) or self.late_beside_change(before, before)
        if found is not None:
            return self._effects.adopt(t, found)
        if before is not None and state.n_since:
            self._disturbances.await_end(self._residuals.of_newest(before, state.n_since))
        state.end_suspicion()
        state.path = state.path.begin(None if before is None else self._residuals.space.to_unit(before))
        if before is not None:
            self._friction.doubt(before)
        every = ~state.is_resting
        event = self._record.unexplained(t, every, "parameters explain {} for a few samples only")
        state.n_failures = max(state.n_failures + 1, PATIENCE if rests else 0)
        if state.n_failures < PATIENCE:
            return Settled(before, (event,), True)
        state.findings = state.findings.forget()
        return Settled(before, (event, self._failed_searches.rest(t, every)), True)

    def fail(self, t: float, theta: Vector | None, held: Vector) -> Settled | None:
        """Take the end of a search that has found no parameters, theta (d,) being the best.

        None where the suspicion goes on with newer samples only, or is a false alarm: nothing happened, parameters are
        still changing, or the noise is larger, which the parameters that lasted do not explain by themselves.
        Parameters that move on from search to search are given up, as in `succeed`.
        A disturbance is named where a constant one explains the samples; one that does so together with changed
        parameters is known from then on, and these are sought beside it. After the third time, one soon after the
        other, the channels that neither explains rest, longer each time.
        """
        state = self._state
        n = min(state.n_since, QUIET)
        if state.n_since < NOISY and self._comparison.noise.if_noise(held) is not None:
            return None  # so few samples show no noise, as where a filter makes them
        if theta is not None and self.is_restless(theta):
            return self.give_up(t, rests=True)
        reference = state.reference_or(held)
        rows = self._residuals.of_newest(reference, n)
        found = disturbance_of(rows)
        self._evidence.note(n, nothing=plain_fit(rows, 0), disturbance=found.fit)
        if plain_fit(rows, 0).score <= found.fit.score:  # a false alarm
            state.end_suspicion()
            return None
        before = self._lasting.before(reference, n)
        late = self._effects.late(reference) or self.late_beside_change(held, before)
        if late is not None:
            return self._effects.adopt(t, late)
        if self._comparison.is_changing(held, n) and not state.is_resting.any():
            return None
        if self._comparison.noise.adopt(held):
            return self._effects.only_noise(state.n_since)
        both = self._comparison.with_disturbance(held, n)
        explaining = [d for d in (found, both) if d is not None and d.fit.is_explained]
        if n >= QUIET and explaining:
            best = min(explaining, key=lambda d: d.fit.score)
            if best is not found and best.fit.n_values - best.fit.n_free >= _SPARE:
                self._disturbances.take_change(best)
                return None
            return self._disturbances.adopt(t, disturbance_of(self._residuals.of_newest(before, n)), before)
        return self._nothing_explains(t, theta, before, rows)

    def succeed(self, t: float, theta: Vector) -> Settled | None:
        """Take the end of a search that has found parameters theta (d,).

        Earlier failures count less, if that proves anything. But parameters that are never proven and move on from
        search to search, by more than they may drift, explain nothing: the third time they are undone.
        """
        state = self._state
        if self.is_restless(theta):
            return self.give_up(t, rests=True)
        if state.verdict.n_spare >= _SPARE and not state.findings.has_moved:
            state.n_failures = max(state.n_failures - 1, 0)
        return None

    def is_restless(self, theta: Vector) -> bool:
        """Take parameters (d,) that were found; return whether three of five such, soon one after the other, differ."""
        state, z = self._state, self._residuals.space.to_unit(theta)
        state.findings = state.findings.take(state.n_samples, z, self._comparison.determined(z))
        return state.findings.are_restless

    def late_beside_change(self, held: Vector, before: Vector, *, is_early: bool = False) -> Explanation | None:
        """Return the lag that explains all samples since the onset together with changed parameters, or None.

        None too where parameters do so alone, those in force, held (d,), or others; or beside a constant disturbance,
        nearly as well. before (d,): parameters before the onset; is_early: limited rates only, and of fewer samples.
        """
        n = self._state.n_since
        if n < (LONG if is_early else FEWEST_BESIDE) or self._comparison.is_changing(held, n):
            return None
        late = self._lag.beside_change(before, is_early=is_early)
        if late is None:
            return None
        both = self._comparison.with_disturbance(held, n)
        return late if both is None or late.fit.score + MARGIN <= both.fit.score else None

    def _nothing_explains(self, t: float, theta: Vector | None, before: Vector, rows: Vector) -> Settled:
        """End a suspicion as nothing explains the newest samples, theta (d,) best; rows (n, c): residuals before it."""
        self._disturbances.await_end(self._residuals.of_newest(before, self._state.n_since))
        self._state.end_suspicion()
        self._friction.doubt(before)
        lacks = self._comparison.lacking_channels(
            rows if theta is None else self._residuals.of_newest(theta, len(rows))
        )
        event = self._record.unexplained(t, lacks, "no parameters explain {}")
        events = (event, *self._failed_searches.count(t, lacks))
        return Settled(self._lasting.undone(before), events, True)
