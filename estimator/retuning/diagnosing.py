"""Retuner whose proposals are passed on only where a diagnosis warrants them."""

from dataclasses import dataclass, replace
from typing import Any, Final

from ..diagnosis.sample_diagnosis import Diagnosis
from ..diagnosis.settings import Judgement
from ..diagnosis.state import DiagnosisState
from ..events import Event
from ..samples import Sample
from ..space import Vector
from ..triggers import Trigger
from .counts import RetunerCounts
from .proposal import DOUBTFUL, Proposal, going_back, without_rounding
from .retuner import Retuner, RetunerSnapshot

_FEWEST: Final = 5
"""Least number of samples since the onset, and since the first search of several, at which a search fails."""
_PATIENCE: Final = 20
"""Number of samples after which a search without end counts as failed."""
_TOLD_APART: Final = 1.5
"""Distance from the parameters in force, in standard deviations, at which a filter's estimate is told apart."""


@dataclass(frozen=True)
class DiagnosingSnapshot:
    """State of retuner and diagnosis before a sample that may be an outlier."""

    retuner: RetunerSnapshot
    diagnosis: DiagnosisState
    warranted: bytes
    """Parameters, as bytes, that were proposed last as warranted."""
    solver: RetunerSnapshot | None
    """State of an endless search at the onset of a suspicion; None where there is none."""


@dataclass(frozen=True)
class SuspicionTrigger:
    """Trigger that begins an episode only where samples contradict the parameters in force."""

    trigger: Trigger
    diagnosis: Diagnosis

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return the inner trigger's reason, or None."""
        return self.trigger(sample, tracking_error, theta) if self.diagnosis.is_suspicious else None


class DiagnosingRetuner(RetunerCounts[Retuner]):
    """Retuner with a diagnosis of sampled derivatives beside it: the same calls, and only warranted proposals."""

    def __init__(self, retuner: Retuner, diagnosis: Diagnosis, is_endless: bool, jumps: bool) -> None:
        """retuner: with `diagnosis.residuals`; is_endless: true where its one episode lasts for ever; jumps: whether
        parameters that the diagnosis has found replace an estimate that lags behind."""
        self._retuner, self._diagnosis, self._is_endless, self._jumps = retuner, diagnosis, is_endless, jumps
        self._space = diagnosis.residuals.space
        self._warranted = b""
        self._solver: RetunerSnapshot | None = None  # of an endless search, at the onset

    def diagnosis_summary(self) -> dict[str, Any]:
        """Return what the diagnosis has found as JSON values."""
        return self._diagnosis.summary()

    def snapshot(self) -> DiagnosingSnapshot | None:
        """Return the snapshot that `restore` needs; None where the retuner cannot be restored."""
        inner = self._retuner.snapshot()
        if inner is None:
            return None
        before_search = None if self._solver is None else self._solver.copy()
        return DiagnosingSnapshot(inner, self._diagnosis.snapshot(), self._warranted, before_search)

    def restore(self, snapshot: DiagnosingSnapshot, held: Vector) -> None:
        """Go back to a snapshot, which is used up; held (d,): the controller's parameters then."""
        self._retuner.restore(snapshot.retuner, held)
        self._diagnosis.restore(snapshot.diagnosis)
        self._warranted, self._solver = snapshot.warranted, snapshot.solver

    def reverted(self, theta: Vector) -> None:
        """Take a revert of the guard's to theta (d,): no search that fails returns to what was reverted."""
        self._diagnosis.reverted(theta)
        self._retuner.distrust()

    def suspend(self, t: float, held: Vector, n: int) -> Proposal | None:
        """Undo what was found on samples that turn out to be doubtful, the newest n; None where nothing was."""
        reference = self._diagnosis.suspend(n)
        return None if reference is None else self._ended(t, Proposal(), reference, held, (), DOUBTFUL)

    def correct(self, newest: Sample) -> None:
        """Do nothing: an outlier of derivatives is retracted with what it has led to."""

    def keep_input(self, sample: Sample) -> None:
        """Take the input of a sample that is kept out."""
        self._diagnosis.keep_input(sample)

    def take_input(self, t: float, u: tuple[float, ...]) -> None:
        """Take the input (p,) held up to t [s], where samples have means of those of several steps."""
        self._diagnosis.take_input(t, u)

    def step(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        """Take one communication point's sample, where there is one; return what to write, and why."""
        proposal = self._proposal(t, sample, tracking_error, held)
        events = self._diagnosis.evidence.events(t)
        return replace(proposal, events=(*proposal.events, *events)) if events else proposal

    def _proposal(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        diagnosis = self._diagnosis
        if sample is not None:
            was_suspicious = diagnosis.is_suspicious
            if diagnosis.observe(sample, held, self._retuner.expects):
                self._retuner.forget()
            if diagnosis.is_suspicious and not was_suspicious:
                self._solver = self._retuner.snapshot() if self._is_endless else None
            elif held.tobytes() == self._warranted:
                diagnosis.accept(held)
            settled = diagnosis.searches.give_up(t) if diagnosis.is_wandering(held) else diagnosis.settle(t, held)
            if settled is not None:
                if settled.ends_search:
                    return self._ended(t, Proposal(), settled.undo, held, settled.events)
                self._solver = None
        if self._is_endless and diagnosis.is_resting:
            return Proposal()
        if sample is not None:
            sample = diagnosis.residuals.corrected(sample)
            drift = self._retuner.drift_to_begin
            hidden = None if drift is None else diagnosis.comparison.quiet.hidden_change(held, drift)
            if hidden is not None:
                return without_rounding(self._retuner.follow_jump(t, sample, hidden, held), held, self._space)
        proposal = without_rounding(self._stepped(t, sample, tracking_error, held), held, self._space)
        if proposal.undo is not None:  # a drift that explains nothing
            settled = diagnosis.searches.give_up(t)
            return self._ended(t, replace(proposal, undo=None), settled.undo, held, settled.events)
        return self._judged(t, proposal, held)

    def _stepped(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        """Return the retuner's proposal: a filter's in the place of its search, where one has followed a jump."""
        drift = self._retuner.drift_to_follow
        if sample is not None and drift is not None:
            known = self._diagnosis.comparison.jumps.followed(held, drift)
            if known is not None:
                return self._retuner.follow_jump(t, sample, known, held)
        return self._retuner.step(t, sample, tracking_error, held)

    def _judged(self, t: float, proposal: Proposal, held: Vector) -> Proposal:
        """Return the proposal as far as it is warranted."""
        diagnosis, verdict = self._diagnosis, self._verdict(proposal, held)
        if self._jumps and proposal.estimate is not None and diagnosis.comparison.lags(proposal.estimate.theta):
            proposal, verdict = self._jumped(proposal, verdict, held)
        theta = proposal.theta
        if self._is_endless and not diagnosis.is_suspicious and verdict != "refuted":
            return self._moved(proposal, held)
        if verdict == "warranted" and theta is not None:
            self._warranted = theta.tobytes()
        ended = self._search_ended(t, proposal, verdict, held)
        if ended is not None or theta is None:
            return ended or proposal
        if verdict == "refuted":
            return replace(proposal, theta=None)
        if proposal.estimate is not None:
            diagnosis.expect(proposal.estimate.is_identifiable)
        comparison, is_warranted = diagnosis.comparison, verdict == "warranted"
        if is_warranted and not comparison.may_be_disturbed:
            return proposal
        if_noise, rival = comparison.noise.if_noise(held), comparison.disturbance(held)
        return replace(proposal, if_noise=if_noise, possible_disturbance=rival, is_warranted=is_warranted)

    def _search_ended(self, t: float, proposal: Proposal, verdict: Judgement, held: Vector) -> Proposal | None:
        """Return what the end of a search leads to, where the diagnosis ends its suspicion then; else None."""
        diagnosis = self._diagnosis
        best = None if proposal.estimate is None else proposal.estimate.theta
        has_ended = any(event.kind == "end" for event in proposal.events)
        if has_ended and best is not None and self._is_vain(verdict):
            self._retuner.distrust()
        has_ended |= self._is_endless and diagnosis.n_since >= _PATIENCE
        n_samples = min(diagnosis.n_since, self._retuner.n_searched)
        if has_ended and n_samples >= _FEWEST and diagnosis.comparison.has_failed:
            failed = diagnosis.searches.fail(t, best, held)
            if failed is not None:
                return self._ended(t, proposal, failed.undo, held, failed.events)
            self._retuner.forget()  # the noise may be larger, or older samples of parameters that have changed since
        if has_ended and diagnosis.is_suspicious and best is not None and not diagnosis.comparison.has_failed:
            settled = diagnosis.searches.succeed(t, best)
            if settled is not None:
                return self._ended(t, proposal, settled.undo, held, settled.events)
        return None

    def _is_vain(self, verdict: Judgement) -> bool:
        """Return whether a search that has ended gives a filter nothing to go on from.

        It is refuted, and by the newest sample, too; or those in force, which samples no longer contradict, may stay.
        """
        if verdict == "refuted":
            return not self._retuner.explains_newest
        return verdict == "possible" and not self._diagnosis.is_suspicious

    def _moved(self, proposal: Proposal, held: Vector) -> Proposal:
        """Return a filter's proposal while nothing contradicts the parameters in force, held (d,).

        They move only as far as they differ from its estimate by more than one and a half standard deviations. Those of
        the start, or that have returned, stay until a change is proven.
        """
        known = None if proposal.estimate is None else proposal.estimate.information
        if proposal.theta is not None and not self._diagnosis.may_follow(held):
            return replace(proposal, theta=None)
        if proposal.theta is None or known is None:
            return proposal
        z = self._space.to_unit(proposal.theta)
        away = self._space.to_unit(held) - z
        distance = known.distance(away)
        if distance <= _TOLD_APART:
            return replace(proposal, theta=None)
        return replace(proposal, theta=self._space.from_unit(z + away * (_TOLD_APART / distance)))

    def _verdict(self, proposal: Proposal, held: Vector) -> Judgement:
        """Return whether the parameters of a proposal, or those that it leaves in force, are warranted."""
        if proposal.estimate is None:
            return "refuted"
        diagnosis, theta = self._diagnosis, proposal.theta
        found = proposal.estimate.theta if theta is None else theta
        verdict = diagnosis.comparison.judge(found, held, is_filter=self._is_endless)
        if theta is None:
            return verdict
        if diagnosis.comparison.explains_newest_only(proposal.estimate.is_identifiable):
            return "refuted"
        return "refuted" if diagnosis.is_at_unseen_bound(theta, proposal.estimate.std, held) else verdict

    def _jumped(self, proposal: Proposal, verdict: Judgement, held: Vector) -> tuple[Proposal, Judgement]:
        """Return a proposal that lags behind a jump of the plant's parameters after it has caught up, where it can.

        A filter's own parameters are not written where no parameters explain more than can always be explained.
        """
        jump = self._diagnosis.comparison.jumps.found(held, is_filter=self._is_endless)
        if jump is None:
            return proposal, "refuted" if self._is_endless and not self._diagnosis.comparison.is_tested else verdict
        if self._is_endless:
            self._retuner.jump(jump)
        proposal = without_rounding(replace(proposal, theta=jump.theta, estimate=jump), held, self._space)
        return proposal, self._verdict(proposal, held)

    def _ended(
        self,
        t: float,
        proposal: Proposal,
        before: Vector | None,
        held: Vector,
        events: tuple[Event, ...],
        reason: str = "",
    ) -> Proposal:
        """End the search, of an endless one with its state from the onset; return to the parameters before (d,)."""
        back = held if before is None else before
        if self._solver is not None:
            self._retuner.restore(self._solver, back)
            self._solver = None
        self._retuner.abandon(back)
        self._diagnosis.returned(back)
        return going_back(t, proposal, back, held, events, self._space, reason)
