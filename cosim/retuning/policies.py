"""What a run does about its controller's parameters: re-tune them, leave them, or tell the truth."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Protocol

import numpy as np

from estimator import DerivativeResidual, EpisodeWindow, LinearForm, Method, Sample, Vector
from estimator.retuner import Budget, Reconfiguration, Retuner, make_retuner

from ..errors import CosimError, ScenarioError, one_line, seconds
from ..objectives.choice import ENDLESS, chosen, open_objective
from ..objectives.model import opened_model
from ..objectives.rollout_fmu import RunningPlant
from ..sampling.derivative_filter import derivative_noise
from ..scenarios.scenario import Scenario
from ..system.plant import Plant
from ..user_code import USERS, load
from .estimators import find_method, make_estimator


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

    def describe(self) -> str:
        """How candidates are judged, in a line; empty where there are none."""
        ...

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """t [s]; the sample there, but for the first point, whose u is unknown; norm of the tracking error."""
        ...


class NominalPolicy:
    """The nominal controller."""

    n_evaluations = n_episodes = n_model_calls = 0

    def describe(self) -> str:
        """Nothing is judged."""
        return ""

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """Nothing."""
        return Reconfiguration()


class TrueParametersPolicy:
    """The controller with the plant's own parameters: the least error that re-tuning can hope for."""

    n_evaluations = n_episodes = n_model_calls = 0

    def __init__(self, truth: Callable[[float], Vector]) -> None:
        self._truth = truth

    def describe(self) -> str:
        """Nothing is judged."""
        return ""

    def step(self, t: float, sample: Sample | None, tracking_error: float) -> Reconfiguration:
        """The parameters in force at t."""
        return Reconfiguration(write=self._truth(t))


def decide(policy: Policy, estimator: str, sample: Sample | None, t: float, tracking_error: float) -> Reconfiguration:
    """What the policy makes of t [s]. Raises ScenarioError, with the estimator's name, for whatever it raises."""
    try:
        return policy.step(t, sample, tracking_error)
    except CosimError:
        raise
    except USERS as e:
        raise failed_at(f"estimator '{estimator}'", t, e) from e


def failed_at(what: str, t: float, error: BaseException) -> ScenarioError:
    """The fault of a run in which code of the user's has raised at t [s]."""
    reason = f"{type(error).__name__}: {one_line(str(error))}"
    return ScenarioError(f"{what} failed at t = {seconds(t)} s: {reason}.")


def make_policy(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    theta: Vector,
    truth: Callable[[float], Vector],
    rng: np.random.Generator,
    stack: ExitStack,
    live: RunningPlant | None = None,
    whitened: DerivativeResidual | None = None,
) -> Policy:
    """The policy of that name; theta (d,): what the controller holds; stack closes what it opens; live: the plant,
    where it runs; whitened: see `whitened_residual`.

    Raises ScenarioError for an unknown name, or a model, objective or estimator that cannot be loaded or do not fit.
    """
    if estimator == "none":
        return NominalPolicy()
    if estimator == "true":
        return TrueParametersPolicy(truth)
    method = find_method(estimator, scenario)
    choice = chosen(scenario)
    search, loop = make_estimator(estimator, method, scenario, theta, rng)
    budget = Budget(loop.budget, loop.evaluations_per_step, loop.commit)
    form = _linear_form(method, scenario)
    if choice.kind == "derivative":
        whitened = whitened or _residual(scenario, plant, stack)
        text = f"derivatives of {scenario.estimation.model} ({choice.why})"
        return make_retuner(search, whitened, loop.trigger.trigger(whitened), budget, loop.window, theta, form, text)
    if method.needs_derivatives:
        raise ScenarioError(
            f"estimator '{estimator}' takes derivatives sample by sample: no estimation.objective else."
        )
    if loop.trigger.is_endless:
        raise ScenarioError(ENDLESS)
    judge = open_objective(scenario, plant, theta, live, stack)
    is_rollout = choice.kind == "rollout"
    noise = [n.noise for n in scenario.sampling.outputs.values()] if is_rollout and not search.is_whitened else None
    window = EpisodeWindow(judge, loop.window, noise)
    trigger = loop.trigger.trigger(window.innovation)
    return Retuner(search, window, trigger, budget, theta, form, judge.describe)


def whitened_residual(scenario: Scenario, estimator: str, plant: Plant, stack: ExitStack) -> DerivativeResidual | None:
    """The residual of sampled derivatives, whose model stack closes; None where nothing, or something else, is judged.

    Raises ScenarioError.
    """
    if estimator in ("none", "true") or chosen(scenario).kind != "derivative":
        return None
    return _residual(scenario, plant, stack)


def try_model(scenario: Scenario, estimator: str, plant: Plant, theta: Vector, first: Sample) -> None:
    """Call the scenario's model, and its linear form where the estimator uses it, once. Raises ScenarioError."""
    if estimator in ("none", "true") or chosen(scenario).kind != "derivative":
        return
    settings = scenario.estimation
    try:
        with ExitStack() as stack:
            _residual(scenario, plant, stack)(theta, first)
    except CosimError:
        raise
    except USERS as e:
        call = f"{settings.model}(x ({len(first.x)},), u ({len(first.u)},), {', '.join(settings.space.names)})"
        raise ScenarioError(f"estimation.model: {call} failed: {type(e).__name__}: {e}.") from e
    form = _linear_form(find_method(estimator, scenario), scenario)
    if form is None:
        return
    try:
        rows, targets = form.rows(first)
        if rows.shape != (len(targets), len(form.coefficients(theta))):
            raise ValueError(f"rows are {rows.shape}, targets {targets.shape}")
    except USERS as e:
        raise ScenarioError(f"estimation.linear: failed: {type(e).__name__}: {e}.") from e


def _residual(scenario: Scenario, plant: Plant, stack: ExitStack) -> DerivativeResidual:
    """The whitened residual of the scenario's model, which stack closes. Raises ScenarioError."""
    settings = scenario.estimation
    model = stack.enter_context(opened_model(scenario, plant))
    sigma = derivative_noise(scenario.sampling, scenario.scenario.macro_step)
    return DerivativeResidual(model, settings.space, plant.channels, sigma)


def _linear_form(method: Method, scenario: Scenario) -> LinearForm | None:
    """The model's linear form, for an estimator that needs it. Raises ScenarioError."""
    settings = scenario.estimation.linear
    if settings is None or not method.needs_linear_form:
        return None
    return LinearForm(
        scenario.estimation.space,
        load(settings.rows, scenario.folder, "estimation.linear.rows"),
        load(settings.coefficients, scenario.folder, "estimation.linear.coefficients"),
    )
