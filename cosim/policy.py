"""What a run does about its controller's parameters: re-tune them, leave them, or tell the truth."""

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from typing import Protocol

import numpy as np

from estimator import DerivativeResidual, LinearForm, ResidualWindow, Sample, Vector

from .errors import CosimError, ScenarioError, one_line, seconds
from .estimators import find_method, load, make_estimator
from .fmu_model import opened_model
from .reconfigure import (
    AlwaysTrigger,
    Budget,
    InnovationTrigger,
    Reconfiguration,
    Retuner,
    TrackingTrigger,
    Trigger,
)
from .scenario import Scenario
from .schema import Innovation, LinearModel, Loop, Tracking
from .system import Plant


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

    @property
    def n_model_calls(self) -> int:
        """Samples at which a candidate was judged so far."""
        ...

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """t [s]; the sample there, but for the first point, whose u is unknown; norm of the tracking error."""
        ...


class LeaveAlone:
    """The nominal controller."""

    n_evaluations = n_episodes = n_model_calls = 0

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """Nothing."""
        return Reconfiguration()


class TellTruth:
    """The controller with the plant's own parameters: the least error that re-tuning can hope for."""

    n_evaluations = n_episodes = n_model_calls = 0

    def __init__(self, truth: Callable[[float], Vector]) -> None:
        self._truth = truth

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """The parameters in force at t."""
        return Reconfiguration(write=self._truth(t))


def decide(policy: Policy, estimator: str, sample: Sample | None, t: float, tracking_error: float) -> Reconfiguration:
    """What the policy makes of t [s]. Raises ScenarioError, with the estimator's name, for whatever it raises."""
    try:
        return policy.step(t, sample, tracking_error)
    except CosimError:
        raise
    except Exception as e:
        reason = f"{type(e).__name__}: {one_line(str(e))}"
        raise ScenarioError(f"estimator '{estimator}' failed at t = {seconds(t)} s: {reason}.") from e


def make_policy(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    theta: Vector,
    truth: Callable[[float], Vector],
    first: Sample,
    rng: np.random.Generator,
    stack: ExitStack,
) -> Policy:
    """The policy of that name; theta (d,): what the controller holds; first: a sample to try the model on.
    stack closes the model, where it is an FMU.

    Raises ScenarioError for an unknown name, or a model or estimator that cannot be loaded or called.
    """
    if estimator == "none":
        return LeaveAlone()
    if estimator == "true":
        return TellTruth(truth)
    method = find_method(estimator, scenario)
    search, loop = make_estimator(estimator, method, scenario, theta, rng)
    whitened = _residual(scenario, plant, first, theta, stack)
    judged = whitened if search.is_whitened else replace(whitened, noise=(1.0,) * len(whitened.noise))
    linear = scenario.estimation.linear if method.needs_linear_form else None
    trigger = _trigger(loop, whitened)
    budget = math.inf if isinstance(trigger, AlwaysTrigger) else loop.budget
    return Retuner(
        search,
        ResidualWindow(judged, len(whitened.noise), loop.window),
        trigger,
        Budget(budget, loop.evaluations_per_step, loop.commit),
        theta,
        _linear_form(linear, scenario, first, theta) if linear else None,
    )


def _trigger(loop: Loop, residual: DerivativeResidual) -> Trigger:
    match loop.trigger:
        case Innovation():
            return InnovationTrigger(residual, loop.trigger.false_alarm)
        case Tracking():
            return TrackingTrigger(loop.trigger.threshold)
        case _:
            return AlwaysTrigger()


def _residual(scenario: Scenario, plant: Plant, first: Sample, theta: Vector, stack: ExitStack) -> DerivativeResidual:
    """The whitened residual of the scenario's model, tried once. Raises ScenarioError."""
    settings = scenario.estimation
    model = stack.enter_context(opened_model(scenario, plant))
    sigma = tuple(n.noise for n in scenario.sampling.derivatives.values())
    residual = DerivativeResidual(model, settings.space, plant.channels, sigma)
    try:
        residual(theta, first)
    except Exception as e:  # whatever a user's function raises
        call = f"{settings.model}(x ({len(first.x)},), u ({len(first.u)},), {', '.join(settings.space.names)})"
        raise ScenarioError(f"estimation.model: {call} failed: {type(e).__name__}: {e}.") from e
    return residual


def _linear_form(settings: LinearModel, scenario: Scenario, first: Sample, theta: Vector) -> LinearForm:
    """The model's linear form, tried once. Raises ScenarioError."""
    form = LinearForm(
        scenario.estimation.space,
        load(settings.rows, scenario.folder, "estimation.linear.rows"),
        load(settings.coefficients, scenario.folder, "estimation.linear.coefficients"),
    )
    try:
        rows, targets = form.rows(first)
        if rows.shape != (len(targets), len(form.coefficients(theta))):
            raise ValueError(f"rows are {rows.shape}, targets {targets.shape}")
    except Exception as e:  # whatever a user's function raises
        raise ScenarioError(f"estimation.linear: failed: {type(e).__name__}: {e}.") from e
    return form
