"""What a run does about its controller's parameters: re-tune them, leave them, or write the true ones."""

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
    """Decides, at each communication point, what the controller gets. `Supervisor` is one."""

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
        """Return how candidates are scored, in a line; empty where there are none."""
        ...

    def summary(self) -> dict[str, Any]:
        """Return the counts of guard and screen as JSON values, where there are any."""
        ...

    def step(self, point: Point, held: Vector) -> Decision:
        """Return what to do at a communication point; held (d,): what the controller holds."""
        ...


class NominalPolicy:
    """The nominal controller: nothing is written."""

    n_evaluations = n_episodes = n_model_calls = 0

    def describe(self) -> str:
        """Return nothing: there are no candidates."""
        return ""

    def summary(self) -> dict[str, Any]:
        """Return nothing: there is neither guard nor screen."""
        return {}

    def step(self, point: Point, held: Vector) -> Decision:
        """Leave the controller as it is."""
        return Decision()


class TrueParametersPolicy(NominalPolicy):
    """The controller with the plant's own parameters: the least error that re-tuning can hope for."""

    def __init__(self, truth: Callable[[float], Vector]) -> None:
        """truth: the plant's parameters (d,) as a function of time [s]."""
        self._truth = truth

    def step(self, point: Point, held: Vector) -> Decision:
        """Write the parameters in force."""
        return Decision(write=self._truth(point.t))


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

    held (d,): what the controller holds first; truth: the plant's parameters (d,) as a function of time [s]; stack
    closes what is opened; running, live: the system and its plant, where they run.
    Raises ScenarioError for an unknown name, or a model, objective or estimator that cannot be loaded or do not fit.
    """
    if estimator == "none":
        return NominalPolicy()
    if estimator == "true":
        return TrueParametersPolicy(truth)
    return make_supervisor(scenario, estimator, plant, held, rng, stack, running, live)
