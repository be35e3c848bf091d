"""Search of an episode: an ask-tell estimator's candidates, or a solver's solves, within a budget."""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from time import perf_counter
from typing import Literal, NamedTuple, cast

import numpy as np

from ..contract import AskTell, Batching, Converging, Estimate, Jumping, NoEstimateError, Rescoring, Solver
from ..objective import LinearForm, Objective, Window
from ..space import Vector


@dataclass(frozen=True)
class Budget:
    """Number of evaluations, and choice of the parameters written to the controller. Counts, never wall time."""

    evaluations: float = 30
    """Number N of evaluations an episode; infinite where one episode lasts the run."""
    evaluations_per_step: int = 1
    """Number of evaluations a macro step; a solver's one solve counts as so many, so that all episodes last as long."""
    commit: Literal["incumbent", "candidate"] = "incumbent"
    """Parameters that are written: the best so far, or each candidate."""


class EvaluatedCandidate(NamedTuple):
    """Candidate that has been evaluated."""

    theta: Vector
    """Parameters (d,)."""
    cost: float
    """Squared norm of its residual."""
    seconds: float
    """Wall time [s] since the evaluation before it."""


@dataclass(frozen=True)
class SearchSnapshot:
    """State of a search before a sample that may be an outlier."""

    remaining: float
    """Number of evaluations left in the episode."""
    solver: Solver | None
    """Copy of a solver; None of an estimator that asks for candidates."""


class Search:
    """Estimator that evaluates candidates on a window, some at each macro step, until its budget is used up."""

    def __init__(self, estimator: AskTell | Solver, budget: Budget, linear: LinearForm | None) -> None:
        self._estimator, self._budget, self._linear = estimator, budget, linear
        self._solver = estimator if isinstance(estimator, Solver) else None  # 20 us to ask a protocol
        self._rescoring = estimator if isinstance(estimator, Rescoring) else None
        self._batching = estimator if isinstance(estimator, Batching) else None
        self._converging = estimator if isinstance(estimator, Converging) else None
        self._remaining = 0.0
        self.n_evaluations = 0

    @property
    def is_under_way(self) -> bool:
        """True where evaluations are left."""
        return self._remaining > 0

    @property
    def is_whitened(self) -> bool:
        """True where the estimator takes residuals in standard deviations of the noise."""
        return self._estimator.is_whitened

    @property
    def solves(self) -> bool:
        """True where it solves anew with each sample, so that without a new one there is nothing to do."""
        return self._solver is not None

    def begin(self, window: Window, held: Vector) -> None:
        """Begin at the parameters held (d,), on a window whose episode has not begun yet."""
        self._remaining = self._budget.evaluations
        self._estimator.restart(held)
        if self._rescoring is not None and not window.is_rescoring_cheap:
            # Their residuals belong to other samples: marked as failures, they are dropped.
            self._rescoring.rescore(np.full((len(self._rescoring.candidates), 1), np.nan))

    def end(self) -> None:
        """End, whatever is left of the budget."""
        self._remaining = 0.0

    def abandon(self) -> None:
        """End, unless it is a solver's whose one search lasts the run."""
        if self._solver is None or self._remaining != math.inf:
            self._remaining = 0.0

    def jump(self, estimate: Estimate) -> None:
        """Go on from an estimate, as after a jump of the plant's parameters."""
        if isinstance(self._estimator, Jumping):
            self._estimator.jump(estimate)
        else:
            self._estimator.restart(estimate.theta)

    def estimate(self) -> Estimate | None:
        """Return the present estimate; None before any candidate has succeeded."""
        try:
            return self._estimator.estimate()
        except NoEstimateError:
            return None

    def evaluate(self, window: Window, held: Vector, is_growing: bool) -> Iterator[EvaluatedCandidate]:
        """Evaluate this step's candidates; held (d,): the controller's parameters.

        is_growing: whether the window will have more samples of the episode, for which the search goes on.
        """
        if self._solver is not None:
            return self._solve(self._solver, window)
        return self._search(cast(AskTell, self._estimator), window, held, is_growing)

    def snapshot(self) -> SearchSnapshot:
        """Return the snapshot that `restore` needs."""
        return SearchSnapshot(self._remaining, deepcopy(self._solver))

    def restore(self, snapshot: SearchSnapshot, held: Vector) -> None:
        """Go back to a snapshot, which is used up; held (d,): the controller's parameters then."""
        self._remaining = snapshot.remaining
        if snapshot.solver is not None:
            self._solver = self._estimator = snapshot.solver
        elif self._rescoring is None:
            self._estimator.restart(held)

    def _solve(self, solver: Solver, window: Window) -> Iterator[EvaluatedCandidate]:
        begun = perf_counter()
        is_cheap = window.is_rescoring_cheap  # else a solve is an episode: its samples stay, and it cannot pause
        objective = Objective(window, self._linear, math.inf if is_cheap else self._budget.evaluations)
        solver.solve(objective)
        window.keep(())
        self._remaining = max(self._remaining - self._budget.evaluations_per_step, 0) if is_cheap else 0
        self.n_evaluations += objective.n_evaluations
        estimate = solver.estimate()
        yield EvaluatedCandidate(estimate.theta, estimate.cost, perf_counter() - begun)

    def _search(self, search: AskTell, window: Window, held: Vector, is_growing: bool) -> Iterator[EvaluatedCandidate]:
        begun = perf_counter()
        batching = None if window.is_rescoring_cheap else self._batching
        if self._rescoring is None:
            window.keep([held])  # it would keep the residuals of every candidate of the run
        elif window.is_rescoring_cheap and len(candidates := self._rescoring.candidates):
            self._rescoring.rescore(np.asarray(window.residuals(candidates)))
        n = int(min(self._budget.evaluations_per_step, self._remaining))
        while n > 0:
            thetas = [search.ask()] if batching is None else batching.ask_many(n)
            n -= len(thetas)
            residuals = [window.residual(thetas[0])] if len(thetas) == 1 else window.residuals(thetas)
            for theta, residual in zip(thetas, residuals, strict=True):
                search.tell(theta, residual)
                self._remaining -= 1
                self.n_evaluations += 1
                now = perf_counter()
                yield EvaluatedCandidate(theta, float(residual @ residual), now - begun)
                begun = now
            if self._converging is not None and self._converging.is_done and not is_growing:
                self._remaining = n = 0
