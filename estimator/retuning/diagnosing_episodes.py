"""Retuner on sequences of samples whose proposals are passed on only where a diagnosis warrants them."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from ..diagnosis.episode_diagnosis import EpisodeDiagnosis
from ..diagnosis.settings import Judgement
from ..samples import Sample
from ..space import Vector
from ..triggers import Trigger
from .counts import RetunerCounts
from .proposal import DOUBTFUL, Proposal, going_back, without_rounding
from .retuner import Retuner

_KEPT: Final = 255
"""Number of earlier changes of the parameters in force that are known."""
_SURE: Final = 10
"""Values a parameter that, explained, leave no doubt."""


@dataclass(frozen=True)
class EpisodeTrigger:
    """Trigger that begins an episode only where a sequence of samples contradicts the parameters in force."""

    trigger: Trigger
    diagnosis: EpisodeDiagnosis

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return the inner trigger's reason, or None."""
        return self.diagnosis.reason(self.trigger, sample, tracking_error, theta)


class DiagnosingEpisodes(RetunerCounts[Retuner]):
    """Retuner with a diagnosis of sequences beside it: the same calls, and only warranted proposals."""

    def __init__(self, retuner: Retuner, diagnosis: EpisodeDiagnosis, jumps: bool) -> None:
        """retuner: on the diagnosis' window, with an `EpisodeTrigger`; jumps: whether parameters that the diagnosis has
        found replace an estimate that lags behind, and end its search."""
        self._retuner, self._diagnosis, self._jumps = retuner, diagnosis, jumps
        self._before: Vector | None = None  # in force at the beginning of the episode
        self._ended: tuple[Vector, Judgement] | None = None  # what the last episode proposed in the end
        self._in_force: list[tuple[int, Vector]] = []  # parameters, from which step on they were; the newest is last
        self._n_steps = 0
        self._n_values = 0  # that the parameters proposed last explain

    def diagnosis_summary(self) -> dict[str, Any]:
        """Return what the diagnosis has found as JSON values."""
        return self._diagnosis.summary()

    def snapshot(self) -> None:
        """Return None: an episode's window cannot be restored."""

    def restore(self, snapshot: None, held: Vector) -> None:
        """Do nothing: there is no snapshot."""

    def reverted(self, theta: Vector) -> None:
        """Take a revert of the guard's to theta (d,): no search that fails returns to what was reverted."""
        self._before, self._in_force = theta, [(0, theta)]
        self._diagnosis.reverted(theta)
        self._retuner.reverted(theta)

    def suspend(self, t: float, held: Vector, n: int) -> Proposal | None:
        """Go back to the parameters in force before the newest n samples, which turn out to be doubtful; end a search.

        None where there is no search, and those in force now were then, or explain many values measured since.
        """
        if not self._in_force:
            return None
        earlier = (theta for k, theta in reversed(self._in_force) if k <= self._n_steps - n + 1)
        before = next(earlier, self._in_force[0][1])
        is_searching = self._before is not None and self._retuner.is_searching
        is_sure = self._n_values + self._diagnosis.n_calm >= _SURE * len(held)
        if not is_searching and (is_sure or self._diagnosis.space.are_same(before, held)):
            return None
        self._retuner.abandon(before)
        self._retuner.close(before)
        self._retuner.reverted(before)
        self._in_force = [(0, before)]
        return going_back(t, Proposal(), before, held, (), self._diagnosis.space, DOUBTFUL)

    def correct(self, newest: Sample) -> None:
        """Replace the newest sample, one of whose values has turned out to be wrong."""
        self._retuner.correct(self._diagnosis.corrected(newest))

    def keep_input(self, sample: Sample) -> None:
        """Take a sample that begins and judges nothing: a simulation needs its input."""
        self._retuner.keep_input(self._diagnosis.corrected(sample))

    def take_input(self, t: float, u: tuple[float, ...]) -> None:
        """Do nothing: samples have all that is to be known of the inputs."""

    def step(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        """Take one communication point's sample, where there is one; return what to write, and why."""
        self._note_in_force(held)
        proposal = self._proposal(t, sample, tracking_error, held)
        if proposal.undo is not None:
            self._in_force = [(0, proposal.undo)]  # nothing returns to what was taken back
        return replace(proposal, events=(*proposal.events, *self._diagnosis.evidence.events(t)))

    def _proposal(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        diagnosis = self._diagnosis
        self._close(held)
        if sample is not None:
            sample = diagnosis.corrected(sample)
        proposal = without_rounding(self._retuner.step(t, sample, tracking_error, held), held, diagnosis.space)
        kinds = [event.kind for event in proposal.events]
        if "trigger" in kinds:
            self._before = held
        if proposal.estimate is None and "end" not in kinds:
            return replace(proposal, events=(*proposal.events, *diagnosis.passed(t, held)))
        before = held if self._before is None else self._before
        verdict = self._verdict(proposal, before)
        jump = diagnosis.jump() if self._jumps else None
        if jump is not None:
            proposal = without_rounding(self._retuner.end_at(t, jump, proposal), held, diagnosis.space)
            kinds, verdict = ["end"], self._verdict(proposal, before)
        best = None if proposal.estimate is None else proposal.estimate.theta
        theta = proposal.theta
        if verdict == "refuted" and "end" in kinds and best is not None and diagnosis.adopt_unexplained(best, before):
            proposal, theta, verdict = replace(proposal, theta=best), best, diagnosis.judge(best, before)
        if proposal.estimate is not None and theta is not None:
            verdict = "refuted" if diagnosis.is_at_unseen_bound(theta, proposal.estimate.std, held) else verdict
        if verdict != "refuted":
            rival = diagnosis.disturbance(before) if verdict == "possible" and theta is not None else None
            if "end" in kinds:
                self._ended = (held if theta is None else theta, verdict)
            self._n_values = self._n_values if theta is None else diagnosis.n_values
            if_noise = None if theta is None else diagnosis.if_noise(before)
            return replace(proposal, if_noise=if_noise, possible_disturbance=rival, is_warranted=rival is None)
        if "end" not in kinds:
            return replace(proposal, theta=None)
        before = diagnosis.accepted(before)
        events = diagnosis.fail(t, best, before)
        before = diagnosis.in_rest(before)
        self._retuner.close(before)
        return going_back(t, proposal, before, held, events, diagnosis.space)

    def _note_in_force(self, held: Vector) -> None:
        """Take the parameters (d,) in force in the step that begins."""
        self._n_steps += 1
        if not self._in_force or not np.array_equal(held, self._in_force[-1][1]):
            self._in_force = [*self._in_force[-_KEPT:], (self._n_steps, held)]

    def _verdict(self, proposal: Proposal, before: Vector) -> Judgement:
        """Return whether a proposal, or else its estimate, is warranted in place of the parameters before (d,)."""
        if proposal.estimate is None:
            return "refuted"
        return self._diagnosis.judge(proposal.estimate.theta if proposal.theta is None else proposal.theta, before)

    def _close(self, held: Vector) -> None:
        """Close the window of the last episode; wait for more samples where its proposal was possible, and refused."""
        if self._ended is None:
            return
        (proposed, verdict), self._ended = self._ended, None
        was_refused = not np.array_equal(proposed, held)
        if verdict == "possible" and was_refused and self._diagnosis.wait():
            return
        self._diagnosis.succeed()
        self._retuner.close(held)
