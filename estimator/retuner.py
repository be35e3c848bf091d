"""Algorithm 1 of the paper: watch the tracking error, estimate, write back. Knows no FMU.

Khan and Chatterjee (2020), section III-C and algorithm 1.
"""

import math
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from . import (
    AskTell,
    Batching,
    DerivativeResidual,
    Estimate,
    LinearForm,
    NoEstimateError,
    Objective,
    Rescoring,
    ResidualWindow,
    Sample,
    Solver,
    Vector,
    Window,
)
from .events import Event
from .triggers import AlwaysTrigger, Trigger


@dataclass(frozen=True)
class Reconfiguration:
    """What one communication point led to."""

    write: Vector | None = None
    """theta (d,) for the controller, or None to leave it."""
    estimate: Estimate | None = None
    """The belief behind it."""
    events: tuple[Event, ...] = ()
    """In order."""
    latencies: tuple[float, ...] = ()
    """Wall time of each evaluation [s]: ask, score, tell, any refit; the first and the last carry what is done once."""


@dataclass(frozen=True)
class Budget:
    """How much is evaluated, and what of it reaches the controller. Counts, never the clock."""

    evaluations: float = 30
    """N, evaluations an episode; infinite where one episode lasts the run."""
    evaluations_per_step: int = 1
    """Evaluations a macro step; a solver's one solve counts as so many, so that all episodes last as long."""
    commit: Literal["incumbent", "candidate"] = "incumbent"
    """Whether the best so far or each candidate is written."""


class _Mark(NamedTuple):
    """What a loop knew before a sample that may be an outlier."""

    window: ResidualWindow
    remaining: float
    theta: Vector
    believed: Vector
    solver: Solver | None


class Retuner:
    """The loop: idle until triggered, then an episode of evaluations, writing as it goes. Holds the run's belief."""

    def __init__(
        self,
        estimator: AskTell | Solver,
        window: Window,
        trigger: Trigger,
        budget: Budget,
        start: Vector,
        linear: LinearForm | None = None,
        describe: Callable[[], str] = str,
    ) -> None:
        """describe: how the window judges candidates, in a line."""
        self.describe = describe
        self._estimator, self._window, self._trigger, self._budget = estimator, window, trigger, budget
        self._solver = estimator if isinstance(estimator, Solver) else None  # 20 us to ask a protocol
        self._rescoring = estimator if isinstance(estimator, Rescoring) else None
        is_batching = isinstance(estimator, Batching) and not window.is_rescoring_cheap
        self._batching = cast(Batching, estimator) if is_batching else None
        self._linear = linear
        self._theta = self._believed = start
        self._remaining = 0.0
        self._marked: _Mark | None = None
        self.n_evaluations = 0
        self.n_episodes = 0

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """Take one communication point's sample, where there is one; returns what to write, and why.

        A filter gives a sample every so many points, of a time before t: a search goes on between them.
        """
        begun = perf_counter()
        if sample is not None:
            self._window.append(sample)
        elif not self._remaining or self._solver is not None:  # an equal window has nothing new to solve
            return Reconfiguration()
        events: list[Event] = []
        if sample is not None and not self._remaining:
            reason = self._trigger(sample, tracking_error, self._theta)
            if reason is None:
                return Reconfiguration()
            samples = self._begin()
            on = {} if samples is None else {"samples": samples}
            events.append(Event(t, "trigger", {"reason": reason, "episode": self.n_episodes, **on}))
        elif sample is not None and self._estimator.is_whitened:
            self._window.explain(self._believed)  # before the evaluations, which a past that misleads would spoil
        if not self._window.is_ready:
            return Reconfiguration(events=tuple(events))
        latencies: list[float] = []
        candidate = self._theta
        for candidate, cost, seconds in self._evaluate():
            latencies.append(seconds)
            why = self._window.why_failed(candidate)
            failed = {} if why is None else {"failed": why}
            events.append(Event(t, "candidate", {"theta": candidate.tolist(), "cost": cost, **failed}))
        estimate = self._believe()
        latencies[-1] += perf_counter() - begun - sum(latencies)
        if self._remaining == 0:
            cost = None if estimate is None else estimate.cost
            belief = {} if estimate is None else _belief(estimate)
            events.append(Event(t, "end", {"episode": self.n_episodes, "cost": cost} | belief))
        write = None
        if estimate is not None:
            is_candidate = self._budget.commit == "candidate" and self._remaining > 0
            theta = candidate if is_candidate else estimate.theta
            write = None if np.array_equal(theta, self._theta) else theta
            if write is not None:
                why = {"theta": theta.tolist(), "reason": "candidate"} if is_candidate else {}
                events.append(Event(t, "write", _belief(estimate) | why))
            self._theta = theta
        if self._remaining == 0:
            self._window.end(self._theta)
        return Reconfiguration(write, estimate, tuple(events), tuple(latencies))

    def hold(self, theta: Vector) -> None:
        """The controller holds theta (d,), whatever was to be written."""
        self._theta = theta

    def mark(self) -> Vector | None:
        """Remember what is known, for `retract`: the next sample may be an outlier.

        Returns what is in force (d,); None where an episode's own window cannot go back.
        """
        if not isinstance(self._window, ResidualWindow):
            return None
        solver = deepcopy(self._solver)
        self._marked = _Mark(self._window.copy(), self._remaining, self._theta, self._believed, solver)
        return self._theta

    def retract(self) -> None:
        """Go back to the mark, as if the sample after it had not been taken; what was evaluated stays counted."""
        if (mark := self._marked) is None:
            return
        mark.window.n_model_calls = self._window.n_model_calls
        self._window, self._remaining = mark.window, mark.remaining
        self._theta, self._believed = mark.theta, mark.believed
        if mark.solver is not None:
            self._solver = mark.solver
            self._estimator = mark.solver
        elif self._rescoring is None:
            self._estimator.restart(self._theta)

    @property
    def n_model_calls(self) -> int:
        """Samples at which a candidate was judged, re-scoring included."""
        return self._window.n_model_calls

    def _believe(self) -> Estimate | None:
        """What the estimator believes now; None before any candidate has succeeded."""
        try:
            estimate = self._estimator.estimate()
        except NoEstimateError:
            return None
        self._believed = estimate.theta
        if self._estimator.is_whitened:
            self._window.explain(estimate.theta)
        return estimate

    def _begin(self) -> str | None:
        """Begin an episode; on which samples, where that is not simply the newest ones."""
        self.n_episodes += 1
        self._remaining = self._budget.evaluations
        self._estimator.restart(self._theta)
        if self._rescoring is not None and not self._window.is_rescoring_cheap:
            # What was told of them belongs to other samples: as failures they are forgotten.
            self._rescoring.rescore(np.full((len(self._rescoring.candidates), 1), np.nan))
        samples = self._window.begin(self._theta)
        self._believed = self._theta
        if self._estimator.is_whitened:
            self._window.explain(self._theta, patient=False)
        return samples

    def _evaluate(self) -> Iterator[tuple[Vector, float, float]]:
        """Evaluate this step's candidates: (theta, |residual|^2, wall time [s]) of each."""
        if self._solver is not None:
            return self._solve(self._solver)
        return self._search(cast(AskTell, self._estimator))

    def _solve(self, solver: Solver) -> Iterator[tuple[Vector, float, float]]:
        begun = perf_counter()
        is_cheap = self._window.is_rescoring_cheap  # else a solve is an episode: its samples stay, and it cannot pause
        objective = Objective(self._window, self._linear, math.inf if is_cheap else self._budget.evaluations)
        solver.solve(objective)
        self._window.keep(())
        self._remaining = max(self._remaining - self._budget.evaluations_per_step, 0) if is_cheap else 0
        self.n_evaluations += objective.n_evaluations
        estimate = solver.estimate()
        yield estimate.theta, estimate.cost, perf_counter() - begun

    def _search(self, search: AskTell) -> Iterator[tuple[Vector, float, float]]:
        begun = perf_counter()
        if self._rescoring is None:
            self._window.keep([self._theta])  # it would keep the residuals of every candidate of the run
        elif self._window.is_rescoring_cheap and len(candidates := self._rescoring.candidates):
            self._rescoring.rescore(np.asarray(self._window.residuals(candidates)))
        n = int(min(self._budget.evaluations_per_step, self._remaining))
        while n > 0:
            thetas = [search.ask()] if self._batching is None else self._batching.ask_many(n)
            n -= len(thetas)
            residuals = [self._window.residual(thetas[0])] if len(thetas) == 1 else self._window.residuals(thetas)
            for theta, residual in zip(thetas, residuals, strict=True):
                search.tell(theta, residual)
                self._remaining -= 1
                self.n_evaluations += 1
                now = perf_counter()
                yield theta, float(residual @ residual), now - begun
                begun = now


def _belief(estimate: Estimate) -> dict[str, Any]:
    """An estimate as JSON values."""
    return {
        "theta": estimate.theta.tolist(),
        "std": estimate.std.tolist(),
        "is_identifiable": list(estimate.is_identifiable),
        "reason": estimate.reason,
    }


def make_retuner(
    estimator: AskTell | Solver,
    whitened: DerivativeResidual,
    trigger: Trigger,
    budget: Budget,
    max_length: int,
    start: Vector,
    linear: LinearForm | None = None,
    text: str = "",
) -> Retuner:
    """The loop round an estimator, on windows of at most max_length samples; start (d,): what the controller holds.

    whitened: the residual in standard deviations of its noise; an estimator that wants physical units gets those.
    text: what it is, for the report.
    """
    judged = whitened if estimator.is_whitened else replace(whitened, noise=(1.0,) * len(whitened.noise))
    window = ResidualWindow(judged, len(whitened.noise), max_length)
    if isinstance(trigger, AlwaysTrigger):
        budget = replace(budget, evaluations=math.inf)
    return Retuner(estimator, window, trigger, budget, start, linear, partial(str, text))
