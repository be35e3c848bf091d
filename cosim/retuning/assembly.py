"""Assembly of a supervisor with its screen, retuner and guard from a scenario."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from math import nan
from typing import Final

import numpy as np

from estimator import DerivativeResidual, EpisodeWindow, LinearForm, Method, Sample, Vector
from estimator.diagnosis.episode_diagnosis import EpisodeDiagnosis
from estimator.diagnosis.sample_diagnosis import Diagnosis
from estimator.effects.step_means import StepMeans
from estimator.retuning.factory import AnyRetuner, make_episodes, make_retuner
from estimator.retuning.search import Budget
from estimator.samples import RememberingModel

from ..errors import CosimError, ScenarioError, one_line
from ..objectives.choice import ENDLESS, chosen, open_objective
from ..objectives.model import FmuModel, opened_model
from ..objectives.model_trial import try_arrays, try_derivatives
from ..objectives.rollout_fmu import RunningPlant
from ..sampling.derivative_filter import derivative_noise, kernel_of, points_apart
from ..sampling.screen import FilteredScreen, OutputScreen, SampleScreen, Sensors
from ..scenarios.scenario import Scenario
from ..scenarios.tuning_rule import TuningRule
from ..system.plant import Plant
from ..system.tuning import WriteCheck, tuning_rule, written_variables
from ..user_code import USERS, load
from ..variable_name import VariableName
from .data_support import DataSupport, NoDataSupport
from .estimators import find_method, make_estimator
from .guard import Guard
from .lookahead import Lookahead, RunningSystem
from .supervisor import ReadBack, Supervisor

_FEWEST: Final = 30
"""Least number of samples that the data support keeps: a recursive estimator's window is one."""
_NUMERICS: Final = ("scipy.linalg", "scipy.optimize", "scipy.spatial", "scipy.special")
"""Modules that a search needs, 0.3 s: loaded while FMUs start, those of the loop ahead too, not when first used."""


def make_supervisor(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    held: Vector,
    rng: np.random.Generator,
    stack: ExitStack,
    running: RunningSystem | None = None,
    live: RunningPlant | None = None,
) -> Supervisor:
    """Return the supervisor of a scenario's controller; see `make_policy`. Raises ScenarioError."""
    space, settings = scenario.estimation.space, scenario.guard
    whitened = _residual(scenario, plant, stack) if chosen(scenario).kind == "derivative" else None
    rule = tuning_rule(scenario)
    lookahead = _lookahead(scenario, plant, whitened, running, rule, stack)
    for part in _NUMERICS:
        import_module(part)
    diagnosis = None
    if whitened is not None and scenario.diagnosis.enabled:
        names = tuple(scenario.sampling.derivatives)
        late = through_actuators(scenario, plant)
        inputs = [f"{plant.name}.{name}" for name in plant.inputs]
        diagnosis = Diagnosis(whitened, names, scenario.diagnosis, late, inputs, _step_means(scenario))
    retuner = _retuner(scenario, estimator, plant, held, rng, stack, whitened, live, diagnosis)
    support: DataSupport | NoDataSupport = NoDataSupport()
    if whitened is not None:
        rows = whitened.rows if diagnosis is None else diagnosis.residuals.rows
        slopes = whitened.slope_rows if diagnosis is None else diagnosis.residuals.slopes
        support = DataSupport(rows, space, len(whitened.noise), max(scenario.estimation.window, _FEWEST), slopes)
    variables = {} if running is None else written_variables(scenario, running.slaves)
    refusal = WriteCheck(rule, variables)
    guard = Guard(settings, space, held, scenario.limits.divergence, support, refusal) if settings.enabled else None
    read_back = None if running is None else _read_back(rule, running)
    model = None if whitened is None or not isinstance(whitened.model, RememberingModel) else whitened.model
    screen = _screen(scenario, plant, whitened)
    return Supervisor(estimator, retuner, support, screen, guard, read_back, lookahead, model)


def try_model(scenario: Scenario, estimator: str, plant: Plant, theta: Vector, first: Sample) -> None:
    """Call the scenario's model, and its linear form where the estimator uses it, once. Raises ScenarioError."""
    if estimator in ("none", "true") or chosen(scenario).kind != "derivative":
        return
    settings, given = scenario.estimation, _arguments(scenario, plant)
    try:
        with ExitStack() as stack:
            model = _residual(scenario, plant, stack).model
            try_derivatives(model, plant, settings.space, theta, first, settings.model or "", given)
            if settings.takes_arrays:
                try_arrays(model, plant, settings.space, theta, first, settings.model or "")
    except CosimError:
        raise
    except USERS as e:
        call = f"{settings.model}(x ({len(first.x)},), u ({len(first.u)},), {', '.join(settings.space.names)})"
        raise ScenarioError(f"estimation.model: {call} failed: {type(e).__name__}: {e}; {given}.") from e
    form = _linear_form(find_method(estimator, scenario), scenario)
    if form is None:
        return
    try:
        rows, targets = form.rows(first)
        if rows.shape != (len(targets), len(form.coefficients(theta))):
            raise ValueError(f"rows are {rows.shape}, targets {targets.shape}")
    except USERS as e:
        raise ScenarioError(f"estimation.linear: failed: {type(e).__name__}: {e}.") from e


def _arguments(scenario: Scenario, plant: Plant) -> str:
    """Return what a model's x and u are, by name and in order, and which inputs leave u once they are changed."""
    x, u = (", ".join(map(one_line, names)) for names in (plant.states, plant.inputs))
    loose = [one_line(name) for name in plant.inputs if f"{plant.name}.{name}" not in scenario.connections]
    left = f"; not connected, and in u until [changes] names it: {', '.join(loose)}"
    return f"x is ({x}), u is ({u}){left if loose else ''}"


def _retuner(
    scenario: Scenario,
    estimator: str,
    plant: Plant,
    held: Vector,
    rng: np.random.Generator,
    stack: ExitStack,
    whitened: DerivativeResidual | None,
    live: RunningPlant | None,
    diagnosis: Diagnosis | None,
) -> AnyRetuner:
    """Return the retuner of the estimator, with window and trigger for the objective. Raises ScenarioError."""
    method = find_method(estimator, scenario)
    choice = chosen(scenario)
    search, loop = make_estimator(estimator, method, scenario, held, rng)
    budget = Budget(loop.budget, loop.evaluations_per_step, loop.commit)
    form = _linear_form(method, scenario)
    if whitened is not None:
        text = f"derivatives of {scenario.estimation.model} ({choice.why})"
        return make_retuner(search, whitened, loop.trigger, budget, loop.window, form, text, diagnosis, method.jumps)
    if method.needs_derivatives:
        raise ScenarioError(
            f"estimator '{estimator}' takes derivatives sample by sample: no estimation.objective else."
        )
    if loop.trigger.is_endless:
        raise ScenarioError(ENDLESS)
    objective = open_objective(scenario, plant, held, live, stack)
    is_rollout = choice.kind == "rollout"
    noise = [n.noise for n in scenario.sampling.outputs.values()] if is_rollout and not search.is_whitened else None
    window = EpisodeWindow(objective, loop.window, noise)
    sequences = None
    if scenario.diagnosis.enabled:
        outputs = tuple(scenario.sampling.outputs) if is_rollout else (scenario.estimation.objective,)
        driven = [name for name in plant.inputs if f"{plant.name}.{name}" in scenario.connections]
        sequences = EpisodeDiagnosis(
            window, outputs, tuple(plant.inputs), scenario.diagnosis, scenario.estimation.space, driven or None
        )
    return make_episodes(search, window, loop.trigger, budget, objective.describe, form, sequences, method.jumps)


def _residual(scenario: Scenario, plant: Plant, stack: ExitStack) -> DerivativeResidual:
    """Return the whitened residual of the scenario's model, which stack closes. Raises ScenarioError."""
    settings = scenario.estimation
    opened = stack.enter_context(opened_model(scenario, plant))
    slopes = opened.slopes if isinstance(opened, FmuModel) and opened.has_slopes else None
    sigma = derivative_noise(scenario.sampling, scenario.scenario.macro_step)
    model = RememberingModel(opened)
    return DerivativeResidual(model, settings.space, plant.channels, sigma, settings.takes_arrays, slopes)


def through_actuators(scenario: Scenario, plant: Plant) -> list[int]:
    """Return the places of the plant's inputs that a component computes from its own inputs: no reference, no table."""
    computing = {target.component for target in scenario.connections}
    sources = {str(target): source.component for target, source in scenario.connections.items()}
    return [i for i, name in enumerate(plant.inputs) if sources.get(f"{plant.name}.{name}") in computing]


def _step_means(scenario: Scenario) -> StepMeans | None:
    """Return the means that the filter's samples have of the inputs; None without a filter."""
    settings = scenario.sampling.filter
    if settings is None:
        return None
    kernel = kernel_of(settings, scenario.scenario.macro_step)
    return StepMeans(tuple(kernel.weights.tolist()), kernel.delay, points_apart(settings, kernel))


def _linear_form(method: Method, scenario: Scenario) -> LinearForm | None:
    """Return the model's linear form, for an estimator that needs it, or None. Raises ScenarioError."""
    settings = scenario.estimation.linear
    if settings is None or not method.needs_linear_form:
        return None
    return LinearForm(
        scenario.estimation.space,
        load(settings.rows, scenario.folder, "estimation.linear.rows", scenario.origin),
        load(settings.coefficients, scenario.folder, "estimation.linear.coefficients", scenario.origin),
    )


def _read_back(rule: TuningRule, running: RunningSystem) -> ReadBack:
    """Return the places of the controller's parameters among the outputs of the system."""
    return ReadBack(rule.names, tuple(running.names.index(name) for name in rule.names), rule)


def _lookahead(
    scenario: Scenario,
    plant: Plant,
    whitened: DerivativeResidual | None,
    running: RunningSystem | None,
    rule: TuningRule,
    stack: ExitStack,
) -> Lookahead | str:
    """Return the loop that is simulated ahead, or the reason why there is none."""
    if running is None:
        return "the FMUs do not run"
    if not (scenario.guard.enabled and scenario.guard.lookahead):
        return "guard.lookahead is false"
    try:
        lookahead = Lookahead(scenario, running, plant, None if whitened is None else whitened.model, stack, rule)
    except CosimError as e:
        return str(e).rstrip(".")
    lookahead.prepare()  # as the run's FMUs start, too: with the first write there is no time to wait
    return lookahead


def _screen(
    scenario: Scenario, plant: Plant, whitened: DerivativeResidual | None
) -> SampleScreen | FilteredScreen | OutputScreen | None:
    """Return the screen of the samples; None where they are for a user's objective."""
    settings, h, filtering = scenario.observations, scenario.scenario.macro_step, scenario.sampling.filter
    if not settings.enabled:
        return None
    if whitened is not None and filtering is not None:
        kernel, sensors = kernel_of(filtering, h), _sensors(scenario, plant, whitened)
        n_points, every = len(kernel.weights) + 1, points_apart(filtering, kernel)
        states = SampleScreen(settings, sensors, h)
        return FilteredScreen(states, sensors.state_noise, n_points, every, whitened.has_corner)
    if whitened is not None:
        return SampleScreen(settings, _sensors(scenario, plant, whitened), h)
    if filtering is not None or chosen(scenario).kind != "rollout":
        return None
    outputs = {str(name): output.noise for name, output in scenario.sampling.outputs.items()}
    return OutputScreen(settings, outputs, _state_noise(scenario, plant), h)


@dataclass(frozen=True)
class _Slope:
    """Modelled derivatives (n,) of the states; NaN where the model has no value, as for the residual."""

    residual: DerivativeResidual

    def __call__(self, theta: Vector, x: Sequence[float], u: Sequence[float]) -> Sequence[float]:
        try:
            return self.residual.model(x, u, **self.residual.space.named(theta))
        except (ArithmeticError, ValueError):
            return [nan] * len(x)


def _sensors(scenario: Scenario, plant: Plant, residual: DerivativeResidual) -> Sensors:
    """Return the description of the sampled values for the screen."""
    noise = _state_noise(scenario, plant)
    is_noisy = [own > 0.0 for own in noise.values()]
    others = [residual.space.from_unit(np.full(len(residual.space), z)) for z in (0.25, 0.75)]
    names, is_filtered = tuple(scenario.sampling.derivatives), scenario.sampling.filter is not None
    if is_filtered:  # the filter makes them
        names = ()
    return Sensors(
        (*names, *noise),
        (*[True] * len(names), *is_noisy),
        () if is_filtered else residual.noise,
        () if is_filtered else plant.channels,
        tuple(noise.values()),
        _no_residual if is_filtered else residual,
        _Slope(residual),
        tuple(others),
    )


def _state_noise(scenario: Scenario, plant: Plant) -> dict[str, float]:
    """Return the standard deviation of each state's noise, by name; a state among the outputs has it there."""
    known = {**scenario.sampling.states, **scenario.sampling.outputs}
    names = [VariableName(f"{plant.name}.{name}") for name in plant.states]
    return {name: known[name].noise if name in known else 0.0 for name in names}


def _no_residual(theta: Vector, sample: Sample) -> Vector:
    """Return the residual (0,) of a sample without derivatives."""
    return np.empty(0)
