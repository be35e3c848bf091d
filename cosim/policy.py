"""What a run does about its controller's parameters: re-tune them, leave them, or tell the truth."""

import importlib
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from estimator import METHODS, DerivativeResidual, Model, ResidualWindow, Sample, Vector, make_estimator

from .errors import ScenarioError
from .names import did_you_mean
from .reconfigure import Budget, InnovationTrigger, Reconfiguration, Retuner, TrackingTrigger, Trigger
from .scenario import Scenario
from .schema import Innovation
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
    theta: Vector,
    truth: Callable[[float], Vector],
    first: Sample,
    rng: np.random.Generator,
) -> Policy:
    """The policy of that name; theta (d,): what the controller holds; first: a sample to try the model on.

    Raises ScenarioError for an unknown name, or a model that cannot be loaded or called.
    """
    check_estimator(estimator)
    if estimator == "none":
        return LeaveAlone()
    if estimator == "true":
        return TellTruth(truth)
    settings, method = scenario.estimation, METHODS[estimator]
    whitened = _residual(scenario, plant, first, theta)
    is_whitened = method.estimator.is_whitened
    judged = whitened if is_whitened else replace(whitened, noise=(1.0,) * len(whitened.noise))
    loop = settings.loop(estimator)
    trigger: Trigger = (
        InnovationTrigger(whitened, loop.trigger.false_alarm)
        if isinstance(loop.trigger, Innovation)
        else TrackingTrigger(loop.trigger.threshold)
    )
    return Retuner(
        make_estimator(estimator, settings.space, theta, rng, settings.settings(estimator)),
        ResidualWindow(judged, len(whitened.noise), loop.window),
        trigger,
        Budget(loop.budget, loop.evaluations_per_step, loop.commit),
        theta,
    )


def _residual(scenario: Scenario, plant: Plant, first: Sample, theta: Vector) -> DerivativeResidual:
    """The whitened residual of the scenario's model, tried once. Raises ScenarioError."""
    settings = scenario.estimation
    model = load_model(settings.model, scenario.folder)
    sigma = tuple(n.noise for n in scenario.sampling.derivatives.values())
    residual = DerivativeResidual(model, settings.space, plant.channels, sigma)
    try:
        residual(theta, first)
    except Exception as e:  # whatever a user's function raises
        call = f"{settings.model}(x ({len(first.x)},), u ({len(first.u)},), {', '.join(settings.space.names)})"
        raise ScenarioError(f"estimation.model: {call} failed: {type(e).__name__}: {e}.") from e
    return residual


def check_estimator(name: str) -> None:
    """Raises ScenarioError for a name that is none of `ESTIMATORS`."""
    if name not in ESTIMATORS:
        known = f"; the estimators are {', '.join(ESTIMATORS)}."
        raise ScenarioError(f"no estimator '{name}'{did_you_mean(name, ESTIMATORS) or known}")


def load_model(reference: str, folder: Path) -> Model:
    """The function that `module:function` names; modules beside the scenario are found too."""
    module_name, _, function = reference.partition(":")
    sys.path.insert(0, str(folder))
    try:
        return getattr(importlib.import_module(module_name), function)
    except Exception as e:  # whatever a user's module raises when imported
        raise ScenarioError(f"estimation.model: cannot load '{reference}': {type(e).__name__}: {e}.") from e
    finally:
        sys.path.remove(str(folder))
