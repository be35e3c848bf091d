"""Policies for the controller's parameters in a run: re-tune them, leave them, or write the true ones."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, Protocol

import numpy as np

from estimator import Vector

from ..objectives.rollout_fmu import RunningPlant
from ..scenarios.scenario import Scenario
from ..system.plant import Plant
from .assembly import make_supervisor
from .decision import Decision, Point
from .lookahead import RunningSystem


class Policy(Protocol):
    """Policy that decides at each communication point what is written to the controller, such as `Supervisor`."""

    @property
    def n_evaluations(self) -> int:
        """Candidates evaluated so far."""
        ...

    @property
    def n_episodes(self) -> int:
        """Episodes begun so far."""
        ...

    @property
    def n_model_calls(self) -> int:
        """Samples at which a candidate was scored so far."""
        ...

    def describe(self) -> str:
        """Return a description of the objective, in a line; empty where there are no candidates."""
        ...

    def summary(self) -> dict[str, Any]:
        """Return the counts of guard and screen, if any, as JSON values."""
        ...

    def step(self, point: Point, held: Vector) -> Decision:
        """Return the decision at a communication point; held (d,): the controller's parameters."""
        ...


class NominalPolicy:
    """Policy of the nominal controller: nothing is written."""

    n_evaluations = n_episodes = n_model_calls = 0

    def describe(self) -> str:
        """Return an empty text: there are no candidates."""
        return ""

    def summary(self) -> dict[str, Any]:
        """Return no counts: there is neither guard nor screen."""
        return {}

    def step(self, point: Point, held: Vector) -> Decision:
        """Leave the controller unchanged."""
        return Decision()


class TrueParametersPolicy(NominalPolicy):
    """Policy that writes the plant's true parameters: the least error that re-tuning can achieve."""

    def __init__(self, truth: Callable[[int], Vector], delay: int) -> None:
        """truth: the plant's parameters (d,) by communication point; delay: number of these by which they are late."""
        self._truth, self._delay = truth, delay

    def step(self, point: Point, held: Vector) -> Decision:
        """Write the true parameters at the communication point that is as far back as they are late."""
        return Decision(write=self._truth(max(point.k - self._delay, 0)))


def make_policy(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    held: Vector,
    truth: Callable[[float], Vector],
    rng: np.random.Generator,
    stack: ExitStack,
    running: RunningSystem | None = None,
    live: RunningPlant | None = None,
) -> Policy:
    """Return the policy of that name.

    held (d,): the controller's first parameters; truth: the plant's parameters (d,) as a function of time [s]; stack:
    closes what is opened; running, live: the system and its plant, where they run.
    Raises ScenarioError for an unknown name, or a model, objective or estimator that cannot be loaded or do not fit.
    """
    if estimator == "none":
        return NominalPolicy()
    if estimator == "true":
        return TrueParametersPolicy(lambda k: truth(scenario.scenario.time(k)), scenario.estimation.true.delay)
    return make_supervisor(scenario, estimator, plant, held, rng, stack, running, live)
