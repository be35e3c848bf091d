"""Choice of a scenario's objective: derivatives, roll-outs, or a function of the user's."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, Protocol

import numpy as np

from estimator import Evaluation, ParameterSpace, Sample, SampleSequence, SequenceObjective, Vector

from ..errors import ScenarioError, one_line
from ..scenarios.scenario import Scenario
from ..system.plant import Plant
from ..user_code import USERS, load
from ..variable_name import VariableName
from .rollout import RolloutObjective
from .rollout_fmu import START_METHODS, RunningPlant, StartMethod, obstacles_in_words, shadow_of
from .rollout_start import NoisyStartObjective

ENDLESS: Final = "estimation.trigger: 'always' is for derivatives: other objectives need episodes that end."
_CAUTIONS: Final[Mapping[StartMethod, str]] = {
    "state": "roll-outs from the plant's saved state hide disturbances inside it: an FMU's state holds what nobody "
    'measures; start = "measured" does not',
    "replay": "roll-outs simulated again from the start diverge on an unstable plant",
}
"""What to know of roll-outs that begin in a way."""


@dataclass(frozen=True)
class Choice:
    """The kind of objective, and the reason for it."""

    kind: Literal["derivative", "rollout", "function"]
    why: str


def chosen(scenario: Scenario) -> Choice:
    """Return the kind of objective that a scenario names or, with `auto`, allows. Raises ScenarioError if none."""
    settings, sampling = scenario.estimation, scenario.sampling
    objective, lacks = settings.objective, "estimation.objective"
    if ":" in objective:
        return Choice("function", "as asked")
    if objective == "auto" and settings.model is not None and sampling.derivatives:
        return Choice("derivative", "there is a model for the sampled derivatives")
    if objective == "auto" and sampling.outputs:
        return Choice("rollout", "outputs are sampled, and there is no model for derivatives")
    if objective != "rollout" and settings.model is None:
        raise ScenarioError("estimation.model: derivatives need it; roll-outs do without, where sampling.outputs are.")
    if objective != "rollout" and not sampling.derivatives:
        raise ScenarioError("sampling.derivatives must have one at least: the model's are compared with it.")
    if objective == "rollout" and not sampling.outputs:
        raise ScenarioError(f"{lacks}: 'rollout' needs sampling.outputs, which simulated ones are compared with.")
    return Choice("derivative" if objective != "rollout" else "rollout", "as asked")


def open_objective(
    scenario: Scenario, plant: Plant, theta: Vector, live: RunningPlant | None, stack: ExitStack
) -> "DescribedObjective":
    """Open the objective for roll-outs or for the user's function; stack ends its processes. Raises ScenarioError.

    theta (d,): the controller's present parameters; live: the running plant, if there is one.
    """
    settings = scenario.estimation
    if ":" in settings.objective:
        return FunctionObjective(_function(scenario), settings.objective, settings.space)
    way = None if settings.rollout.start == "auto" else settings.rollout.start
    shadow = shadow_of(scenario, plant, live is not None)
    opened = partial(RolloutObjective, shadow, theta, way, live, settings.rollout.jobs)
    known = {**scenario.sampling.states, **scenario.sampling.outputs}
    measured = [known.get(VariableName(f"{plant.name}.{name}")) for name in plant.states]
    noise = [0.0 if n is None else n.noise for n in measured]
    may_be_measured = way == "measured" or (way is None and "measured" not in shadow.obstacles)
    if any(noise) and may_be_measured:
        return stack.enter_context(NoisyStartObjective(opened, noise))
    return stack.enter_context(opened())


def check_objective(scenario: Scenario, plant: Plant) -> list[str]:
    """Return notes on the objective that `run` will use: a description, then what to know of it.

    No FMU is started. Raises ScenarioError for what `run` refuses.
    """
    choice, name = chosen(scenario), scenario.estimation.objective
    if scenario.estimation.trigger.is_endless:
        raise ScenarioError(ENDLESS)
    if choice.kind == "function":
        _function(scenario)
        return [f"residuals of {name}"]
    shadow = shadow_of(scenario, plant, is_live=True)
    start = scenario.estimation.rollout.start
    open_ways = [w for w in START_METHODS if w not in shadow.obstacles]
    ways = " or else ".join(f"'{w}'" for w in open_ways) if start == "auto" else f"'{start}', as asked"
    likely = open_ways[0] if start == "auto" else start
    obstacles = f"; not so: {obstacles_in_words(shadow.obstacles)}" if shadow.obstacles else ""
    description = f"roll-outs of {shadow.fmu.name} ({choice.why}), begun by {ways}{obstacles}"
    return [description, *([_CAUTIONS[likely]] if likely in _CAUTIONS else [])]


def _function(scenario: Scenario) -> Callable[..., Any]:
    name = scenario.estimation.objective
    function = load(name, scenario.folder, "estimation.objective", scenario.origin)
    if not callable(function):
        raise ScenarioError(f"estimation.objective: '{name}' must be a function.")
    return function


class DescribedObjective(SequenceObjective, Protocol):
    """An objective with a description of itself."""

    def describe(self) -> str: ...


class FunctionObjective:
    """A function of the user's: residuals (D,) = f(theta by name, samples), in standard deviations of the noise."""

    is_ready, is_of_outputs = True, False

    def __init__(self, function: Callable[..., Any], name: str, space: ParameterSpace) -> None:
        self._function, self._name, self._space = function, name, space
        self._last: SampleSequence | None = None
        self._size = 0
        self._why_lost: str | None = None  # why it has failed, if it has each time

    def describe(self) -> str:
        """Return a description with the function's name, and why it failed where it has failed each time."""
        failed = "" if self._why_lost is None else f", which failed each time: {self._why_lost}"
        return f"residuals of {self._name}{failed}"

    def add_sample(self, sample: Sample) -> None:
        """Ignore the sample: the function gets those of each stretch."""

    def snapshot(self, is_needed: bool) -> bool:
        """Return True: a stretch may begin at any sample."""
        return True

    def accept(self, theta: Vector, stretch: SampleSequence) -> None:
        """Ignore the accepted parameters: no residual depends on earlier ones."""

    def revert(self, theta: Vector) -> None:
        """Do nothing: no residual depends on earlier parameters."""

    def move_inputs(self, moved: Vector, stretch: SampleSequence) -> None:
        """Do nothing: the function gets the inputs with the samples."""

    def evaluate(self, thetas: Sequence[Vector], stretch: SampleSequence) -> list[Evaluation]:
        """Evaluate each candidate in turn. Raises ScenarioError for no residuals, or for another number of them."""
        return [self._one(theta, stretch) for theta in thetas]

    def track(self, theta: Vector, stretch: SampleSequence) -> Vector:
        """Return the residual of theta on a stretch that grows from call to call; empty where the function fails."""
        found = self._one(theta, stretch)
        return found.residual if found.reason is None else np.empty(0)

    def _one(self, theta: Vector, stretch: SampleSequence) -> Evaluation:
        found = self._called(theta, stretch)
        if found.reason is None:
            self._why_lost = None
        elif not self._size:
            self._why_lost = self._why_lost or found.reason
        return found

    def _called(self, theta: Vector, stretch: SampleSequence) -> Evaluation:
        where = f"estimation.objective: {self._name}"
        try:
            returned = self._function(self._space.named(theta), stretch.samples)
            residual = np.array(returned, dtype=float)
        except (ArithmeticError, ValueError) as e:
            return Evaluation(np.array([np.nan]), one_line(f"{type(e).__name__}: {e}"))
        except USERS as e:
            raise ScenarioError(one_line(f"{where} failed: {type(e).__name__}: {e}") + ".") from e
        if residual.ndim != 1 or not len(residual):
            raise ScenarioError(f"{where} must return a row of residuals, got an array of shape {residual.shape}.")
        if not np.all(np.isfinite(residual)):
            return Evaluation(
                np.array([np.nan]), f"{np.count_nonzero(~np.isfinite(residual))} residuals are not finite"
            )
        if stretch is self._last and len(residual) != self._size:
            raise ScenarioError(f"{where} must return as many residuals each time, got {len(residual)}, {self._size}.")
        self._last, self._size = stretch, len(residual)
        return Evaluation(residual)
