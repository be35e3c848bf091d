"""Re-tuning loop: idle until triggered, then an episode of evaluations that ends in new parameters.

Khan and Chatterjee (2020), section III-C and algorithm 1. It uses no FMU and stores no parameters of the
controller: those in force are an argument, those to be written are returned.
"""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, replace
from time import perf_counter
from typing import cast

import numpy as np

from ..arrival_cost import ArrivalCost
from ..contract import AskTell, Estimate, Solver
from ..episode_window import EpisodeWindow
from ..events import Event
from ..objective import LinearForm, Window
from ..parameter_filter import Following
from ..samples import Sample
from ..sliding_window import ResidualWindow
from ..space import Vector
from ..triggers import Trigger
from .proposal import Proposal
from .search import Budget, Search, SearchSnapshot

_APART = 5
"""Number of samples without a search after which the next one has nothing to do with the one before."""
_TOGETHER = "many samples together contradict the parameters in force, though none does by itself"


@dataclass(frozen=True)
class RetunerSnapshot:
    """State of a retuner before a sample that may be an outlier."""

    window: ResidualWindow
    search: SearchSnapshot
    believed: Vector | None
    """Newest estimate (d,) of the episode; None before one."""
    arrival_cost: ArrivalCost | None
    """What the filter knows; None without a filter, or before a search has ended."""
    before_search: ArrivalCost | None
    """What it knew when the newest search began."""
    searched: Vector | None
    """Parameters (d,) at which the newest search ended; None before one."""
    n_searched: int
    """Number of samples since the newest search began, or the first of several, one soon after the other."""
    n_idle: int
    """Number of samples since the newest search ended."""
    is_waiting: bool
    """True where the newest episode began on a window that waits for samples."""

    def copy(self) -> "RetunerSnapshot":
        """Return an independent copy, which evaluates the same residuals."""
        return replace(self, window=self.window.copy(), search=deepcopy(self.search))


class Retuner:
    """Loop that monitors samples, and in an episode evaluates candidates and proposes the best so far.

    One call a communication point: `proposal = retuner.step(t, sample, tracking_error, held)`.
    """

    def __init__(
        self,
        estimator: AskTell | Solver,
        window: Window,
        trigger: Trigger,
        budget: Budget,
        linear: LinearForm | None = None,
        describe: Callable[[], str] = str,
        closes: bool = True,
        judged: Callable[[ArrivalCost, Sample], ArrivalCost | None] = lambda known, sample: (
            None if known.is_refuted else known
        ),
    ) -> None:
        """describe: returns how the window scores candidates, in a line; closes: False where the caller calls `close`
        when an episode has ended; judged: returns what a filter goes on with, from what it knows of the samples and the
        newest of them, or None where a drift explains nothing."""
        self._closes, self._judged = closes, judged
        self.describe = describe
        self._window, self._trigger, self._writes_candidates = window, trigger, budget.commit == "candidate"
        self._search = Search(estimator, budget, linear)
        is_following = isinstance(estimator, Following) and isinstance(window, ResidualWindow)
        self._filter = cast(Following, estimator).filter if is_following else None
        self._is_waiting = False  # whether the newest episode began on a window that waits
        self._searched: Vector | None = None  # where the newest search ended
        self._n_idle = 0  # samples since the newest search
        self.n_searched = 0
        """Number of samples since the newest search began, or the first of several, one soon after the other."""
        self._believed: Vector | None = None  # the newest estimate of the present episode
        self.n_episodes = 0

    def step(self, t: float, sample: Sample | None, tracking_error: float, held: Vector) -> Proposal:
        """Take one communication point's sample, where there is one; return what to write, and why.

        held (d,): the controller's parameters. A filter gives a sample only every few points, of a time before t: a
        search continues between them.
        """
        begun = perf_counter()
        if sample is not None:
            self._window.append(sample)
            self.n_searched += 1
            self._n_idle = 0 if self.is_searching else self._n_idle + 1
        elif not self.is_searching or self._search.solves:  # an equal window has nothing new to solve
            return Proposal()
        events: list[Event] = []
        if sample is not None and not self.is_searching:
            reason = self._trigger(sample, tracking_error, held)
            followed = self._follow(sample, held, reason is not None)
            if followed is not None or reason is None:
                return followed or Proposal()
            events.append(self._begin(t, held, reason))
        elif sample is not None and self._search.is_whitened and self._believed is not None:
            self._window.explain(self._believed)  # before the evaluations, which outdated samples would bias
        if not self._window.is_ready:
            return Proposal(events=tuple(events))
        candidate, latencies = held, list[float]()
        for candidate, cost, seconds in self._search.evaluate(self._window, held, self._is_growing):
            latencies.append(seconds)
            events.append(self._evaluated(t, candidate, cost))
        estimate = self._estimate()
        latencies[-1] += perf_counter() - begun - sum(latencies)
        is_candidate = self._writes_candidates and self.is_searching
        wanted = held if estimate is None else candidate if is_candidate else estimate.theta
        if not self.is_searching:
            events.append(self._end(t, estimate, wanted, held))
        theta = None if np.array_equal(wanted, held) else wanted
        return Proposal(theta, estimate, tuple(events), tuple(latencies), is_candidate)

    @property
    def drift_to_follow(self) -> float | None:
        """Rate of a drift, as a share of the scaled bounds, that a filter may follow in the place of a search.

        None where there is no filter, or no search under way.
        """
        return None if self._filter is None or not self.is_searching else self._filter.drift

    @property
    def drift_to_begin(self) -> float | None:
        """The same where there is no search under way, and the filter knows nothing."""
        is_searching, known = self.is_searching, self._filter
        return None if known is None or is_searching or known.arrival_cost is not None else known.drift

    def follow_jump(self, t: float, sample: Sample, known: ArrivalCost, held: Vector) -> Proposal:
        """End the search, if there is one, as a filter has followed the parameters since they jumped; it goes on.

        known: of the samples since then, the newest one among them; held (d,): the controller's parameters.
        """
        assert self._filter is not None
        begun, begins = perf_counter(), tuple[Event, ...]()
        if not self.is_searching:
            self.n_episodes += 1
            begins = (Event(t, "trigger", {"reason": _TOGETHER, "episode": self.n_episodes}),)
        self._window.append(sample)
        self._search.end()
        self._filter.arrival_cost = known
        estimate = self._filter.estimate(held)
        wanted = held if estimate is None else estimate.theta
        self._searched = wanted
        events = (*begins, self._end_event(t, estimate))
        theta = None if np.array_equal(wanted, held) else wanted
        return Proposal(theta, estimate, events, (perf_counter() - begun,))

    def end_at(self, t: float, estimate: Estimate, proposal: Proposal) -> Proposal:
        """End the search, if it has not ended, with an estimate in place of a proposal's; return it."""
        self._search.end()
        self._believed = estimate.theta
        events = tuple(event for event in proposal.events if event.kind != "end")
        events = (*events, self._end_event(t, estimate))
        return replace(proposal, theta=estimate.theta, estimate=estimate, events=events, is_candidate=False)

    def expects(self, sample: Sample) -> bool:
        """Return whether a sample is as a filter expects it, which knows more than the parameters in force say."""
        window = self._sliding
        if self._filter is None or self.is_searching or window is None:
            return False
        return self._filter.expects(lambda theta: window.residual_at(theta, sample))

    @property
    def explains_newest(self) -> bool:
        """True where the filter, if it goes on, explains the newest sample."""
        return self._sliding is not None and self.expects(self._sliding.newest)

    def suspend(self, t: float, held: Vector, n: int) -> None:
        """Go on with samples that turn out to be doubtful: without a diagnosis nothing says what to go back to."""

    def keep_input(self, sample: Sample) -> None:
        """Take a sample that begins and judges nothing, where a simulation needs its input; else do nothing."""
        if self._sliding is None:
            self._window.append(sample)

    def take_input(self, t: float, u: tuple[float, ...]) -> None:
        """Do nothing: without a diagnosis of derivatives, samples have all that is to be known of the inputs."""

    def correct(self, newest: Sample) -> None:
        """Replace the newest sample, one of whose values has turned out to be wrong, where simulations begin there."""
        if isinstance(self._window, EpisodeWindow):
            self._window.correct(newest)

    def diagnosis_summary(self) -> None:
        """Return None: there is no diagnosis."""

    @property
    def is_searching(self) -> bool:
        """True where an episode is under way."""
        return self._search.is_under_way

    def close(self, theta: Vector) -> None:
        """Close the window of an episode that has ended with theta (d,) in force."""
        self._window.end(theta)

    def abandon(self, held: Vector) -> None:
        """End the episode, if there is one, and forget its samples; what was known of held (d,) is known again."""
        self._search.abandon()
        if self._filter is not None:
            self._filter.recall(held)
        self.forget()

    def jump(self, estimate: Estimate) -> None:
        """Let a filter go on from an estimate, as after a jump of the plant's parameters."""
        self._search.jump(estimate)

    def reverted(self, theta: Vector) -> None:
        """Take a return to earlier parameters theta (d,): what the filter knows is doubtful."""
        self.distrust()
        self._window.revert(theta)

    def distrust(self) -> None:
        """Forget what the samples so far say of the parameters: the next samples are followed after a search only."""
        if self._filter is not None:
            self._filter.forget()

    def forget(self) -> None:
        """Forget the samples, whose residuals are no longer valid."""
        if self._sliding is not None:
            self._sliding.clear()

    def snapshot(self) -> RetunerSnapshot | None:
        """Return the snapshot that `restore` needs; None where the window, an episode's own, cannot be restored."""
        if self._sliding is None:
            return None
        known = (None, None) if self._filter is None else (self._filter.arrival_cost, self._filter.before_search)
        return RetunerSnapshot(
            self._sliding.copy(), self._search.snapshot(), self._believed, *known, self._searched, self.n_searched,
            self._n_idle, self._is_waiting,
        )  # fmt: skip

    def restore(self, snapshot: RetunerSnapshot, held: Vector) -> None:
        """Go back to a snapshot, which is used up; held (d,): the controller's parameters then.

        Evaluations made since stay counted.
        """
        snapshot.window.n_model_calls = self._window.n_model_calls
        self._window, self._believed = snapshot.window, snapshot.believed
        self._searched, self._is_waiting = snapshot.searched, snapshot.is_waiting
        self.n_searched, self._n_idle = snapshot.n_searched, snapshot.n_idle
        if self._filter is not None:
            self._filter.arrival_cost, self._filter.before_search = snapshot.arrival_cost, snapshot.before_search
        self._search.restore(snapshot.search, held)

    @property
    def n_evaluations(self) -> int:
        """Candidates evaluated so far."""
        return self._search.n_evaluations

    @property
    def n_model_calls(self) -> int:
        """Number of samples at which a candidate was evaluated, re-scoring included."""
        return self._window.n_model_calls

    def _evaluated(self, t: float, candidate: Vector, cost: float) -> Event:
        """Return the event of an evaluation at t [s]."""
        why = self._window.why_failed(candidate)
        failed = {} if why is None else {"failed": why}
        return Event(t, "candidate", {"theta": candidate.tolist(), "cost": cost, **failed})

    def _end(self, t: float, estimate: Estimate | None, wanted: Vector, held: Vector) -> Event:
        """End an episode with the parameters wanted (d,), others, held (d,), in force; return its event at t [s]."""
        if self._filter is not None and estimate is not None:
            self._filter.begin_after_search(estimate.theta, held, cast(ResidualWindow, self._window))
            self._searched = estimate.theta
        if self._closes:
            self._window.end(wanted)
        return self._end_event(t, estimate)

    def _end_event(self, t: float, estimate: Estimate | None) -> Event:
        found = {"cost": None} if estimate is None else {"cost": estimate.cost} | estimate.as_json()
        return Event(t, "end", {"episode": self.n_episodes} | found)

    def _estimate(self) -> Estimate | None:
        """Return the present estimate; None before any candidate has succeeded."""
        estimate = self._search.estimate()
        if estimate is not None:
            self._believed = estimate.theta
            if self._search.is_whitened:
                self._window.explain(estimate.theta)
        return estimate

    def _follow(self, sample: Sample, held: Vector, is_triggered: bool) -> Proposal | None:
        """Take the newest sample between two episodes; return None where there is nothing to go on from."""
        window = self._sliding
        if self._filter is None or window is None:
            return None
        begun = perf_counter()
        if not self._filter.follow(window.newest_residual, is_triggered):
            return None
        known = self._filter.arrival_cost
        if known is not None and known.n_known <= window.n_kept:
            self._filter.relinearise(window.newest_residuals)
        estimate, known = self._filter.estimate(held), self._filter.arrival_cost
        self._filter.arrival_cost = None if known is None else self._judged(known, sample)
        latencies = (perf_counter() - begun,)
        if known is not None and self._filter.arrival_cost is None:
            self.distrust()
            return Proposal(undo=self._searched, latencies=latencies)
        if estimate is None or np.array_equal(estimate.theta, held):
            return Proposal(latencies=latencies)
        return Proposal(estimate.theta, estimate, latencies=latencies)

    def _begin(self, t: float, held: Vector, reason: str) -> Event:
        """Begin an episode; return its event at t [s], with its samples in words, if not simply the newest ones."""
        self.n_episodes += 1
        if self._n_idle > _APART:
            self.n_searched = 1
        if self._filter is not None:
            self._filter.begin_search(held)
        self._search.begin(self._window, held)
        samples = self._window.begin(held)
        self._believed = held
        waits = self._searched is not None and self._is_growing
        if self._sliding is not None and waits and not self._is_waiting:
            self._sliding.wait()  # what was found on fewer samples may have been wrong, the plant still the same
        elif self._search.is_whitened:
            self._window.explain(held, patient=False)
        self._is_waiting = waits and not self._is_waiting
        on = {} if samples is None else {"samples": samples}
        return Event(t, "trigger", {"reason": reason, "episode": self.n_episodes, **on})

    @property
    def _sliding(self) -> ResidualWindow | None:
        """The window, where it slides."""
        return self._window if isinstance(self._window, ResidualWindow) else None

    @property
    def _is_growing(self) -> bool:
        """True where the window will have more samples than it has now."""
        return self._sliding is not None and not self._sliding.is_full
