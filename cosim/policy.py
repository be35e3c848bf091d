"""What a run does about its controller's parameters: re-tune them, leave them, or tell the truth."""

import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np

from estimator import METHODS, DerivativeResidual, Model, ResidualWindow, Sample, Vector, make_estimator

from .errors import ScenarioError
from .names import did_you_mean
from .reconfigure import Budget, InnovationTrigger, Reconfiguration, Retuner, TrackingTrigger, Trigger
from .scenario import Innovation, Scenario
from .system import Plant

ESTIMATORS = (*METHODS, "none", "true")
"""`none` leaves the controller alone; `true` is the floor: it writes the plant's true parameters."""


class Policy(Protocol):
    """Decides, at each communication point, what the controller gets. `Retuner` is one."""

    @property
    def n_evaluations(self) -> int:
        """Candidates evaluated so far."""
        ...

    @property
    def n_episodes(self) -> int:
        """Episodes begun so far."""
        ...

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """t [s]; the sample there, but for the first point, whose u is unknown; norm of the tracking error."""
        ...


class LeaveAlone:
    """The nominal controller."""

    n_evaluations = n_episodes = 0

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """Nothing."""
        return Reconfiguration()


class TellTruth:
    """The controller with the plant's own parameters: the least error that re-tuning can hope for."""

    n_evaluations = n_episodes = 0

    def __init__(self, truth: Callable[[float], Vector]) -> None:
        self._truth = truth

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """The parameters in force at t."""
        return Reconfiguration(write=self._truth(t))


def make_policy(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    start: Vector,
    truth: Callable[[float], Vector],
    seed: np.random.Generator,
) -> Policy:
    """The policy of that name; start (d,): what the controller holds. Raises ScenarioError for an unknown name."""
    if estimator == "none":
        return LeaveAlone()
    if estimator == "true":
        return TellTruth(truth)
    check_estimator(estimator)
    settings, method = scenario.estimation, METHODS[estimator]
    model, space = _load_model(settings.model, scenario.folder), settings.space
    sigma = tuple(n.noise for n in scenario.sampling.derivatives.values())
    whitened = DerivativeResidual(model, space, plant.channels, sigma)
    judged = (
        whitened
        if method.estimator.is_whitened
        else DerivativeResidual(model, space, plant.channels, (1.0,) * len(sigma))
    )
    loop = settings.loop(estimator)
    trigger: Trigger = (
        InnovationTrigger(whitened, loop.trigger.false_alarm)
        if isinstance(loop.trigger, Innovation)
        else TrackingTrigger(loop.trigger.threshold)
    )
    return Retuner(
        make_estimator(estimator, space, start, seed, settings.settings(estimator)),
        ResidualWindow(judged, len(sigma), loop.window),
        trigger,
        Budget(loop.budget, loop.evaluations_per_step, loop.commit),
        start,
    )


def check_estimator(name: str) -> None:
    """Raises ScenarioError for a name that is none of `ESTIMATORS`."""
    if name not in ESTIMATORS:
        known = f"; the estimators are {', '.join(ESTIMATORS)}"
        raise ScenarioError(f"no estimator '{name}'{did_you_mean(name, ESTIMATORS) or known}.")


def _load_model(reference: str, folder: Path) -> Model:
    """The function that `module:function` names; modules beside the scenario are found too."""
    module_name, _, function = reference.partition(":")
    sys.path.insert(0, str(folder))
    try:
        return getattr(importlib.import_module(module_name), function)
    except Exception as e:  # whatever a user's module raises when imported
        raise ScenarioError(f"estimation.model: cannot load '{reference}': {type(e).__name__}: {e}.") from e
    finally:
        sys.path.remove(str(folder))
