"""Who looks after a run's estimator: the screen before it, the guard behind it, and the loop that is rolled ahead."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from math import nan
from typing import Any, Final

import numpy as np

from estimator import DerivativeResidual, Sample, Vector
from estimator.events import Event
from estimator.retuner import Reconfiguration, Retuner

from ..errors import CosimError
from ..objectives.choice import chosen
from ..sampling.screen import OutputScreen, SampleScreen, Seen, Sensors
from ..scenarios.scenario import Scenario
from ..system.master import Master
from ..system.plant import Plant
from ..variable_name import VariableName
from .data_support import DataSupport, NoDataSupport
from .guard import Guard, Peak
from .lookahead import Lookahead, Running

_FEWEST: Final = 30
"""Samples that say what can be seen: a recursive estimator's window is one."""


class Supervisor:
    """Of one run. Nothing of it is there for `none` and `true`, which estimate nothing."""

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant,
        policy: Retuner,
        start: Vector,
        whitened: DerivativeResidual | None,
        running: Running | None,
        stack: ExitStack,
    ) -> None:
        """start (d,): what the controller holds; whitened: the residual of a sample, where derivatives are judged;
        running: None where there is nothing to roll ahead; stack closes what is opened."""
        self._policy = policy
        self._n_seen = 0  # communication points so far
        self._marked: tuple[int, Vector] | None = None  # n_seen at a sample that is suspect, what was in force before
        self._taken_back: tuple[int, Vector] | None = None  # since how many communication points, to what
        self._read: list[int] | None = None  # places of what the controller says that it holds
        self._writes = [p.writes for p in scenario.estimation.parameters]
        space = scenario.estimation.space
        self._support: DataSupport | NoDataSupport = (
            DataSupport(whitened, space, len(whitened.noise), max(scenario.estimation.window, _FEWEST))
            if whitened is not None
            else NoDataSupport()
        )
        self._guard = (
            Guard(scenario.guard, space, start, scenario.limits.divergence, self._support)
            if scenario.guard.enabled
            else None
        )
        self._screen = _screen(scenario, plant, whitened)
        self._foresight: Lookahead | None = None
        self._why_blind = "guard.lookahead is false"
        if running is not None and self._guard is not None and scenario.guard.lookahead:
            model = None if whitened is None else whitened.model
            try:
                self._foresight = Lookahead(scenario, running, plant, model, stack)
            except CosimError as e:
                self._why_blind = str(e).rstrip(".")

    @property
    def has_stopped(self) -> bool:
        """Whether re-tuning was given up."""
        return self._guard is not None and self._guard.stopped_at is not None

    def begin(self, t: float) -> list[Event]:
        """What is to be said at the start, or when the loop cannot be rolled ahead any more."""
        if self._guard is None or self._foresight is not None:
            return []
        return [Event(t, "guard", {"reason": f"the loop is not rolled ahead: {self._why_blind}"})]

    def seen(self, t: float, sample: Sample | None, theta: Vector) -> Seen:
        """What the estimator gets of the sample, if there is one; theta (d,): what the controller holds.

        Where the sample before was an outlier, the estimator knows nothing of it from here on.
        """
        self._n_seen += 1
        if sample is None:
            return Seen(None)
        seen = Seen(sample) if self._screen is None else self._screen.step(t, sample, theta)
        if seen.was_outlier and self._marked is not None:
            self._policy.retract()
            self._support.retract()
            n, before = self._marked
            self._taken_back = None if np.array_equal(theta, before) else (self._n_seen - n, before)
            self._marked = None
        if seen.sample is not None:
            before = self._policy.mark() if seen.is_suspect else None
            self._marked = None if before is None else (self._n_seen, before)
            self._support.append(seen.sample)
        return seen

    def review(
        self, k: int, t: float, error: float, measured: Sample, decision: Reconfiguration, master: Master
    ) -> Reconfiguration:
        """The decision as far as the guard lets it through, at communication point k; measured: the plant there."""
        if self._guard is None:
            return decision
        if self._read is None:
            place = {name: i for i, name in enumerate(master.names)}
            self._read = [place[name] for name in self._writes]
        if refusal := self._guard.not_taken(t, [master.values[i] for i in self._read], self._writes):
            return Reconfiguration(events=(refusal,))
        if self._taken_back is not None:
            n, before = self._taken_back
            self._guard.retract(k - n, before)
        reviewed = self._guard.step(k, t, error, decision, self._peak(k, measured, master))
        if reviewed.write is not decision.write:
            self._policy.hold(self._guard.held)
        if self._foresight is not None and self._foresight.failure is not None:
            self._why_blind, self._foresight = self._foresight.failure, None
            return replace(reviewed, events=(*reviewed.events, *self.begin(t)))
        return reviewed

    def without_outlier(self, t: float, decision: Reconfiguration) -> Reconfiguration:
        """The decision, or else the way back from what was written on account of an outlier."""
        taken_back, self._taken_back = self._taken_back, None
        if taken_back is None or decision.write is not None:
            return decision
        _, before = taken_back
        told = Event(t, "write", {"theta": before.tolist(), "reason": "the sample before was an outlier"})
        return replace(decision, write=before, events=(*decision.events, told))

    def summary(self) -> dict[str, Any]:
        """Counts of guard and screen, as JSON values."""
        rolled = None if self._foresight is None else self._foresight.n_rolled
        guard = None if self._guard is None else self._guard.summary() | {"rolled_ahead": rolled}
        if guard is not None and rolled is None:
            guard["not_rolled_ahead"] = self._why_blind
        return {"guard": guard, "observations": None if self._screen is None else self._screen.summary()}

    def _peak(self, k: int, measured: Sample, master: Master) -> Peak | None:
        foresight = self._foresight
        if foresight is None:
            return None
        states: list[Mapping[str, Any] | None] = []  # read once, and only where they are needed
        values = list(master.values)

        def peak(controller: Vector, plant: Vector) -> float | None:
            if not states:
                states.append(foresight.now(measured))
            now = states[0]
            return None if now is None else foresight.peak(now, values, k, controller, plant)

        return peak


def _screen(
    scenario: Scenario, plant: Plant, whitened: DerivativeResidual | None
) -> SampleScreen | OutputScreen | None:
    """Of what is judged; None where that is what a filter or the user's own function makes of the samples."""
    settings, h = scenario.observations, scenario.scenario.macro_step
    if not settings.enabled or scenario.sampling.filter is not None:
        return None
    if whitened is not None:
        return SampleScreen(settings, _sensors(scenario, plant, whitened), h)
    if chosen(scenario).kind != "rollout":
        return None
    outputs = scenario.sampling.outputs
    return OutputScreen(settings, tuple(outputs), tuple(output.noise > 0.0 for output in outputs.values()), h)


@dataclass(frozen=True)
class _Slope:
    """Modelled derivatives (n,) of the states at a sample; NaN where the model has no value, as for the residual."""

    residual: DerivativeResidual

    def __call__(self, theta: Vector, sample: Sample) -> Sequence[float]:
        try:
            return self.residual.model(sample.x, sample.u, **self.residual.space.named(theta))
        except (ArithmeticError, ValueError):
            return [nan] * len(sample.x)


def _sensors(scenario: Scenario, plant: Plant, residual: DerivativeResidual) -> Sensors:
    states = [VariableName(f"{plant.name}.{name}") for name in plant.states]
    on_states = scenario.sampling.states
    is_noisy = [name in on_states and on_states[name].noise > 0.0 for name in states]
    n = len(scenario.sampling.derivatives)
    on_channels = [on_states[states[i]].noise if states[i] in on_states else 0.0 for i in plant.channels]
    return Sensors(
        (*scenario.sampling.derivatives, *states), (*[True] * n, *is_noisy), residual.noise,
        plant.channels, tuple(on_channels), residual, _Slope(residual),
    )  # fmt: skip
