"""Algorithm 1 of the paper: watch the tracking error, estimate, write back. Knows no FMU.

Khan and Chatterjee (2020), section III-C and algorithm 1.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, Literal, Protocol, cast

import numpy as np

from estimator import (
    AskTell,
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
    chi2_limit,
)


class Trigger(Protocol):
    """Decides whether an idle loop begins an episode."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """The reason to begin, or None. tracking_error: norm over the tracked outputs; theta: what is in force."""
        ...


@dataclass(frozen=True)
class TrackingTrigger:
    """The paper's: the tracking error reaches a threshold."""

    threshold: float
    """tau_e, in the norm of the tracked outputs' unit."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """A reason where tracking_error >= threshold."""
        if tracking_error < self.threshold:
            return None
        return f"tracking error {tracking_error:.4g} reached {self.threshold:g}"


@dataclass(frozen=True)
class InnovationTrigger:
    """The newest sample contradicts the parameters in force: sees a jump within one sample.

    The normalised innovation squared |r|^2 of the whitened residual exceeds its chi-square limit.
    Bar-Shalom, Li, Kirubarajan (2001), section 5.4.
    """

    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of one sample."""
    false_alarm: float
    """Probability of firing on one sample where nothing has changed."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """A reason where |r|^2 exceeds the limit."""
        r = self.residual(theta, sample)
        squared, limit = float(r @ r), chi2_limit(self.false_alarm, len(r))
        if squared <= limit:
            return None
        return f"normalised innovation squared {squared:.4g} exceeds {limit:.4g}"


@dataclass(frozen=True)
class AlwaysTrigger:
    """For recursive estimators: at the first sample begins the one episode."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Always a reason."""
        return "every sample"


@dataclass(frozen=True)
class Event:
    """One thing that happened, for the record."""

    t: float
    """Communication point [s]."""
    kind: Literal["trigger", "candidate", "write", "end"]
    """What it was."""
    detail: dict[str, Any] = field(default_factory=dict[str, Any])
    """JSON values."""


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


class Retuner:
    """The loop: idle until triggered, then an episode of evaluations, writing as it goes. Holds the run's belief."""

    def __init__(
        self,
        estimator: AskTell | Solver,
        window: ResidualWindow,
        trigger: Trigger,
        budget: Budget,
        start: Vector,
        linear: LinearForm | None = None,
    ) -> None:
        self._estimator, self._window, self._trigger, self._budget = estimator, window, trigger, budget
        self._solver = estimator if isinstance(estimator, Solver) else None  # 20 us to ask a protocol
        self._rescoring = estimator if isinstance(estimator, Rescoring) else None
        self._linear = linear
        self._theta = self._believed = start
        self._remaining = 0.0
        self.n_evaluations = 0
        self.n_episodes = 0

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """Take one communication point's sample, where there is one; returns what to write, and why."""
        if sample is None:
            return Reconfiguration()
        begun = perf_counter()
        self._window.append(sample)
        events: list[Event] = []
        if not self._remaining:
            reason = self._trigger(sample, tracking_error, self._theta)
            if reason is None:
                return Reconfiguration()
            self._begin()
            events.append(Event(t, "trigger", {"reason": reason, "episode": self.n_episodes}))
        elif self._estimator.is_whitened:  # before the evaluations, which a past that misleads would spoil
            self._window.explain(self._believed)
        latencies: list[float] = []
        candidate = self._theta
        for candidate, cost, seconds in self._evaluate():
            latencies.append(seconds)
            events.append(Event(t, "candidate", {"theta": candidate.tolist(), "cost": cost}))
        estimate = self._believe()
        latencies[-1] += perf_counter() - begun - sum(latencies)
        if self._remaining == 0:
            cost = None if estimate is None else estimate.cost
            belief = {} if estimate is None else _belief(estimate)
            events.append(Event(t, "end", {"episode": self.n_episodes, "cost": cost} | belief))
        if estimate is None:
            return Reconfiguration(None, None, tuple(events), tuple(latencies))
        is_candidate = self._budget.commit == "candidate" and self._remaining > 0
        theta = candidate if is_candidate else estimate.theta
        write = None if np.array_equal(theta, self._theta) else theta
        if write is not None:
            why = {"theta": theta.tolist(), "reason": "candidate"} if is_candidate else {}
            events.append(Event(t, "write", _belief(estimate) | why))
        self._theta = theta
        return Reconfiguration(write, estimate, tuple(events), tuple(latencies))

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

    def _begin(self) -> None:
        self.n_episodes += 1
        self._remaining = self._budget.evaluations
        self._estimator.restart(self._theta)
        self._believed = self._theta
        if self._estimator.is_whitened:
            self._window.explain(self._theta, patient=False)

    def _evaluate(self) -> Iterator[tuple[Vector, float, float]]:
        """Evaluate this step's candidates: (theta, |residual|^2, wall time [s]) of each."""
        if self._solver is not None:
            return self._solve(self._solver)
        return self._search(cast(AskTell, self._estimator))

    def _solve(self, solver: Solver) -> Iterator[tuple[Vector, float, float]]:
        begun = perf_counter()
        objective = Objective(self._window, self._linear)
        solver.solve(objective)
        self._window.keep(())
        self._remaining = max(self._remaining - self._budget.evaluations_per_step, 0)
        self.n_evaluations += objective.n_evaluations
        estimate = solver.estimate()
        yield estimate.theta, estimate.cost, perf_counter() - begun

    def _search(self, search: AskTell) -> Iterator[tuple[Vector, float, float]]:
        begun = perf_counter()
        if self._rescoring is None:
            self._window.keep([self._theta])  # it would keep the residuals of every candidate of the run
        elif len(candidates := self._rescoring.candidates):
            self._rescoring.rescore(self._window.residuals(candidates))
        for _ in range(int(min(self._budget.evaluations_per_step, self._remaining))):
            theta = search.ask()
            residual = self._window.residual(theta)
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
) -> Retuner:
    """The loop round an estimator, on windows of at most max_length samples; start (d,): what the controller holds.

    whitened: the residual in standard deviations of its noise; an estimator that wants physical units gets those.
    """
    judged = whitened if estimator.is_whitened else replace(whitened, noise=(1.0,) * len(whitened.noise))
    window = ResidualWindow(judged, len(whitened.noise), max_length)
    if isinstance(trigger, AlwaysTrigger):
        budget = replace(budget, evaluations=math.inf)
    return Retuner(estimator, window, trigger, budget, start, linear)
