"""Supervisor of re-tuning: screen, retuner and guard between a sample and a write.

controller reads back what was written?  no: re-tuning stops
screen the sample                        an outlier before it: all three are restored
retuner proposes parameters
guard rules on them                      with the loop simulated ahead
write
"""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from estimator import Estimate, Sample, Vector
from estimator.events import Event
from estimator.retuning.counts import RetunerCounts
from estimator.retuning.factory import AnyRetuner
from estimator.retuning.proposal import Proposal
from estimator.samples import RememberingModel, is_of_model

from ..errors import CosimError, ScenarioError, one_line, seconds
from ..sampling.screen import FilteredScreen, Screened
from ..user_code import USERS
from .data_support import DataSupport, NoDataSupport
from .decision import Decision, Point
from .guard import Guard, GuardSnapshot, Ruling
from .lookahead import Lookahead, Prediction


class Screen(Protocol):
    """Screen that decides which samples the estimator gets: a `SampleScreen` or an `OutputScreen`."""

    def step(self, t: float, sample: Sample, theta: Vector) -> Screened: ...
    def summary(self) -> dict[str, Any]: ...


@dataclass(frozen=True)
class _Snapshot:
    """State of supervisor and parts before a sample that may be an outlier."""

    held: Vector
    """Parameters in the controller (d,)."""
    retuner: Any
    support: tuple[Sample, ...]
    guard: GuardSnapshot | None


@dataclass(frozen=True)
class ReadBack:
    """Places at which the controller's parameters are read back."""

    names: tuple[str, ...]
    """Names of the parameters, `component.variable` (n,)."""
    places: tuple[int, ...]
    """Indices among the outputs of all FMUs (n,)."""
    written: Callable[[Vector], list[float]]
    """Values of the parameters (n,), by the estimated ones (d,)."""


class Supervisor(RetunerCounts[AnyRetuner]):
    """Supervisor that re-tunes one controller. It owns retuner, screen and guard; the caller stores the parameters."""

    def __init__(
        self,
        name: str,
        retuner: AnyRetuner,
        support: DataSupport | NoDataSupport,
        screen: Screen | FilteredScreen | None = None,
        guard: Guard | None = None,
        read_back: ReadBack | None = None,
        lookahead: Lookahead | str = "the FMUs do not run",
        model: RememberingModel | None = None,
    ) -> None:
        """name: the estimator's, for messages; screen, guard: None where there is none; read_back: None where nothing
        is read back; lookahead: or the reason why there is none; model: of the derivatives, where they are compared."""
        self._name, self._retuner, self._support, self._model = name, retuner, support, model
        self._screen, self._guard, self._read_back, self._lookahead = screen, guard, read_back, lookahead
        self._snapshot: _Snapshot | None = None

    def summary(self) -> dict[str, Any]:
        """Return the findings of guard, screen and diagnosis as JSON values; None for any that is missing."""
        others = {
            "observations": None if self._screen is None else self._screen.summary(),
            "diagnosis": self._retuner.diagnosis_summary(),
        }
        if self._guard is None:
            return {"guard": None, **others}
        if isinstance(self._lookahead, str):
            rolled = {"rolled_ahead": None, "not_rolled_ahead": self._lookahead}
        else:
            rolled = {"rolled_ahead": self._lookahead.n_rolled}
        return {"guard": self._guard.summary() | rolled, **others}

    def step(self, point: Point, held: Vector) -> Decision:
        """Return the decision at a communication point; held (d,): the controller's parameters.

        Raises ScenarioError, which names what has failed, for any exception of user code.
        """
        begun = perf_counter()
        if not point.k:
            return Decision(events=tuple(self._no_lookahead(point.t)))
        if self._guard is not None and self._guard.stopped_at is not None:
            return Decision()
        if stop := self._not_taken(point, held):
            return Decision(events=(stop,))
        with failing("estimation.model", point.t):
            screened, before = self._screened(point, held)
        in_force = held if before is None else before
        with failing(f"estimator '{self._name}'", point.t):
            proposal = self._proposal(point, screened, in_force)
        with failing("estimation.model", point.t):
            ruling = self._ruling(point, proposal, in_force)
        events = [*screened.events, *proposal.events, *ruling.events]
        write = ruling.write
        if proposal.undo is not None and not ruling.is_revert:
            write, self._snapshot = proposal.undo, None  # an outlier does not bring back what is undone
            if self._guard is not None:
                self._guard.undo(write)
        elif write is not None and not ruling.is_revert:
            events.append(_written(point.t, write, ruling.estimate or proposal.estimate, proposal.is_candidate))
        elif write is None and before is not None and not np.array_equal(before, held):
            write = before
            detail = {"theta": before.tolist(), "reason": "the sample before was an outlier"}
            events.append(Event(point.t, "write", detail))
        latencies = proposal.latencies
        if latencies:  # diagnosis, checks and prediction belong to the step's last evaluation
            latencies = (*latencies[:-1], perf_counter() - begun - sum(latencies[:-1]))
        return Decision(write, proposal.estimate, tuple(events), latencies)

    def _proposal(self, point: Point, screened: Screened, held: Vector) -> Proposal:
        """Return the retuner's proposal, which knows the input at every point, whatever becomes of the sample."""
        n, kept = screened.n_doubtful, screened.sample
        if point.measured is not None:
            self._retuner.take_input(point.t, point.measured.u)
        if screened.before is not None:
            self._retuner.correct(screened.before)
        undone = self._retuner.suspend(point.t, held, n) if n else None
        if point.sample is not None and (kept is None or undone is not None):
            self._retuner.keep_input(kept or replace(point.sample, t=point.t))
        return undone or self._retuner.step(point.t, kept, point.error, held)

    def _not_taken(self, point: Point, held: Vector) -> Event | None:
        """Return the stop event, where the read-back differs from the parameters written; or None."""
        if self._guard is None or self._read_back is None:
            return None
        read = [point.values[i] for i in self._read_back.places]
        return self._guard.not_taken(point.t, read, self._read_back.written(held), self._read_back.names)

    def _screened(self, point: Point, held: Vector) -> tuple[Screened, Vector | None]:
        """Return the screened sample and, after an outlier, the parameters held before it (d,)."""
        sample, screened = point.sample, Screened(point.sample)
        if sample is not None and self._model is not None:
            self._model.remember(sample)
        if isinstance(self._screen, FilteredScreen):
            if point.measured is not None:
                screened = self._screen.step(point.t, sample, held, point.measured)
        elif self._screen is not None and sample is not None:
            screened = self._screen.step(point.t, sample, held)
        before = self._restored(held) if screened.was_outlier else None
        if screened.sample is not None:
            self._snapshot = self._taken(held if before is None else before) if screened.is_suspect else None
            self._support.append(screened.sample)
        return screened, before

    def _taken(self, held: Vector) -> _Snapshot | None:
        """Return a snapshot; None where the retuner cannot be restored."""
        retuner = self._retuner.snapshot()
        if retuner is None:
            return None
        return _Snapshot(held, retuner, self._support.snapshot(), self._guard and self._guard.snapshot())

    def _restored(self, held: Vector) -> Vector | None:
        """Restore the snapshot, if there is one; return the parameters held then (d,), or None."""
        snapshot, self._snapshot = self._snapshot, None
        if snapshot is None:
            return None
        self._retuner.restore(snapshot.retuner, snapshot.held)
        self._support.restore(snapshot.support)
        if self._guard is not None and snapshot.guard is not None and not np.array_equal(snapshot.held, held):
            self._guard.restore(snapshot.guard)
        return snapshot.held

    def _ruling(self, point: Point, proposal: Proposal, held: Vector) -> Ruling:
        """Return the guard's ruling on a proposal."""
        if self._guard is None:
            return Ruling(proposal.theta if proposal.is_warranted else None)
        lookahead, prediction = self._lookahead, None
        if not isinstance(lookahead, str) and point.measured is not None:
            prediction = Prediction(lookahead, point.k, point.measured, point.values)
        ruling = self._guard.step(point, proposal, held, prediction)
        if ruling.is_revert:
            assert ruling.write is not None
            self._retuner.reverted(ruling.write)
            if self._snapshot is not None:  # an outlier changes nothing about it
                self._snapshot = replace(self._snapshot, held=ruling.write, guard=self._guard.snapshot())
        if not isinstance(lookahead, str) and lookahead.failure is not None:
            self._lookahead = lookahead.failure
            return replace(ruling, events=(*ruling.events, *self._no_lookahead(point.t)))
        return ruling

    def _no_lookahead(self, t: float) -> Sequence[Event]:
        """Return the event with the reason why the loop is not simulated ahead, where it should be."""
        if self._guard is None or not isinstance(self._lookahead, str):
            return ()
        return (Event(t, "guard", {"reason": f"the loop is not simulated ahead: {self._lookahead}"}),)


def _written(t: float, theta: Vector, estimate: Estimate | None, is_candidate: bool) -> Event:
    """Return the event of a write."""
    assert estimate is not None
    reason = {"reason": "candidate"} if is_candidate else {}
    return Event(t, "write", estimate.as_json() | {"theta": theta.tolist()} | reason)


@contextmanager
def failing(what: str, t: float) -> Generator[None]:
    """Turn exceptions of user code at t [s] into the ScenarioError that ends the run as faulted.

    The model's are told as the model's, though it is the estimator that has called it.
    """
    try:
        yield
    except CosimError:
        raise
    except USERS as e:
        reason = f"{type(e).__name__}: {one_line(str(e))}"
        named = "estimation.model" if is_of_model(e) else what
        raise ScenarioError(f"{named} failed at t = {seconds(t)} s: {reason}.") from e
