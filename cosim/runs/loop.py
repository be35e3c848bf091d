"""The simulation loop of a run. At each communication point t_k, in this order:

get plant x, der(x), held u | noise | record sample | estimate | set controller theta, x, reference |
doStep controller | get u | set plant theta_true(t_k), disturbances(t_k), u | doStep plant, reference.

This is legal FMI 2.0, which forbids get after set without a doStep (section 4.2.4), and delays nothing: a memoryless
controller's output after its step is the control law at x_k.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import hypot
from pathlib import Path
from time import perf_counter
from typing import ClassVar

import numpy as np

from estimator import Vector

from ..errors import NotResumableError, ScenarioError, SlaveError, seconds
from ..fmi.table import TableSlave
from ..objectives.rollout_fmu import RunningPlant
from ..retuning.assembly import try_model
from ..retuning.decision import Decision, Point
from ..retuning.lookahead import RunningSystem
from ..retuning.policies import Policy, make_policy
from ..sampling.sampler import Sampler, measured_columns
from ..scenarios.scenario import Scenario
from ..scenarios.tuning_rule import TuningRule
from ..slaves.slave import Slave
from ..system.master import Master, Wiring
from ..system.parameters import check_parameters, true_parameters
from ..system.plant import Plant, plant_of
from ..system.tunables import ReadBackCheck, TunableWriter
from ..system.tuning import check_first_values, first_parameters, tuning_rule
from ..system.wiring import wire, with_read_back
from .checkpoint import Checkpoint, Checkpoints, restore
from .final_estimate import EstimateTracker
from .latencies import Latencies
from .manifest import Status
from .record import Recorder
from .run_state import StartObjects

StepProgress = Callable[[float, Mapping[str, float]], None]
"""Callback at each communication point: time [s] and the controller's parameters, by name."""


def open_loop(
    scenario: Scenario,
    slaves: Mapping[str, Slave | TableSlave],
    paths: Mapping[str, Path],
    estimator: str,
    seed: int,
    begun: float,
    stack: ExitStack,
) -> "Loop":
    """Return the loop of a run whose FMUs are starting.

    begun: start of the run on the performance counter [s]; stack: closes what is opened.
    Raises ScenarioError, WiringError.
    """
    plant = plant_of(scenario, slaves[scenario.plant])
    check_parameters(scenario, slaves)
    wiring, groups = wire(scenario, slaves)
    wiring = with_read_back(wiring)
    noise, search, faults = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
    master = Master(slaves, wiring, groups)
    sampler = Sampler(scenario, plant, master.names, noise, faults)
    held, rule = np.array(first_parameters(scenario, slaves)), tuning_rule(scenario)
    check_first_values(scenario, rule, held)
    truth = true_parameters(scenario, slaves)
    running = RunningSystem(slaves, wiring, groups, paths, master.names)
    live = _running_plant(scenario, slaves[scenario.plant], wiring[scenario.plant], truth)
    # Here, while the FMUs are still starting: what an estimator imports takes as long as they do.
    policy = make_policy(
        scenario, estimator, plant, held, _TrueParameters(scenario, truth), search, stack, running, live
    )
    disturbances = {name: [f"{name}.{own}" for own in w.disturbances] for name, w in wiring.items() if w.disturbances}
    return Loop(scenario, estimator, plant, master, sampler, policy, held, rule, truth, disturbances, begun)


class Loop:
    """A run in progress. The parameters that the controller holds are stored here and nowhere below.

    1. `initialize` brings the FMUs to the start.
    2. `go_to` takes a resumed run to its checkpoint.
    3. `execute` steps to the end.
    """

    made_anew: ClassVar = ("begun",)
    """Attributes that are in no checkpoint: their values are the resumed run's own."""

    def __init__(
        self,
        scenario: Scenario,
        estimator: str,
        plant: Plant,
        master: Master,
        sampler: Sampler,
        policy: Policy,
        held: Vector,
        rule: TuningRule,
        truth: Mapping[str, Callable[[float], float]],
        disturbances: Mapping[str, Sequence[str]],
        begun: float,
    ) -> None:
        """held (d,): the first parameters; rule: what the controllers hold by them; truth: all that is changed or
        estimated, as functions of time [s]; disturbances: those of it that are inputs, by component."""
        writes = list(scenario.written)
        self.plant, self.policy, self.begun = plant, policy, begun
        self.estimates, self.latencies = EstimateTracker(scenario, estimator), Latencies()
        self._scenario, self._estimator, self._truth = scenario, estimator, truth
        self._master, self._sampler, self._held, self._k = master, sampler, held, 0
        self._elapsed = 0.0  # wall time at the newest communication point [s]
        self._disturbances = disturbances
        inputs = {name for names in disturbances.values() for name in names}
        self._changed = [name for name in scenario.changes if name not in inputs]
        self._tunables = TunableWriter([*self._changed, *writes])
        self._read_back = ReadBackCheck(self._changed, master.names)  # the guard's are the others
        place = {name: i for i, name in enumerate(master.names)}
        self._tracked = [(place[a], place[b]) for a, b in scenario.tracking.items()]
        chosen = _recorded(scenario, plant, master.names)
        self._recorded = [i for name, i in place.items() if name in chosen - {*self._changed, *writes}]
        recorded = [master.names[i] for i in self._recorded]
        held_columns = [scenario.held_column(p) for p in scenario.estimation.parameters]
        self._rule, self._values = rule, rule(held)  # the controllers' parameters
        self._further = [i for i, name in enumerate(writes) if name not in held_columns]
        further = [writes[i] for i in self._further]
        self.columns = ("time", *recorded, *truth, *held_columns, *further, *sampler.columns)
        """Names of the columns recorded at each communication point."""

    def initialize(self) -> str | None:
        """Initialise the FMUs; return the reason why one failed, or None. Raises WiringError, ScenarioError."""
        settings = self._scenario.scenario
        try:
            self._master.initialize(settings.start_time, settings.stop_time)
        except SlaveError as fault:
            return str(fault)
        for parameter in self._scenario.estimation.parameters:  # a formula may have no value from the start
            self._truth[self._scenario.true_reference(parameter)](settings.start_time)
        first = self._sampler.exact(settings.start_time, self._master.values)
        try_model(self._scenario, self._estimator, self.plant, self._held, first)
        return None

    def go_to(self, checkpoint: Checkpoint, start: StartObjects) -> None:
        """Go to a checkpoint; start: the objects of this run, just initialised. Raises NotResumableError."""
        try:
            restore(start, checkpoint)
        except SlaveError as e:
            raise NotResumableError(str(e).rstrip(".")) from e
        if self._k not in range(self._scenario.scenario.n_steps + 1):
            raise NotResumableError(f"its checkpoint does not fit the run: there is no communication point {self._k}")
        self.begun -= self._elapsed

    def execute(
        self, recorder: Recorder, checkpoints: Checkpoints, progress: StepProgress | None
    ) -> tuple[Status, str | None]:
        """Step to the end; return the status and, for a fault, its reason. Raises UnfinishedError."""
        settings = self._scenario.scenario
        names = self._scenario.estimation.space.names
        t = settings.start_time
        try:
            for k in range(self._k, settings.n_steps + 1):
                self._k, t = k, settings.time(k)
                self._elapsed = perf_counter() - self.begun
                checkpoints.offer(k, recorder)
                if self._step(k, t, recorder):
                    return "diverged", None
                if progress is not None:
                    progress(t, dict(zip(names, self._held.tolist(), strict=True)))
        except (SlaveError, ScenarioError) as fault:  # the latter: a change without a value, an estimator that raised
            recorder.event(t, "fault", {"reason": str(fault)})
            return "faulted", str(fault)
        except KeyboardInterrupt:
            recorder.event(t, "interrupt", {})
            return "interrupted", None
        return "done", None

    def _step(self, k: int, t: float, recorder: Recorder) -> bool:
        """Take communication point k at t [s]; return whether the run has diverged there."""
        settings, master = self._scenario.scenario, self._master
        reference = [master.values[b] for _, b in self._tracked]
        errors = [master.values[a] - r for (a, _), r in zip(self._tracked, reference, strict=True)]
        has_diverged = not all(abs(e) <= self._scenario.limits.divergence for e in errors)
        measured = self._sampler.take(t, master.values, master.inputs.get(self._scenario.plant, {}))
        point = Point(k, t, self._sampler.filtered(measured), hypot(*errors), measured, master.values, reference)
        self._take(t, self.policy.step(point, self._held), recorder)
        truth = {reference: value(t) for reference, value in self._truth.items()}
        is_stepping = k < settings.n_steps and not has_diverged
        changed = self._tunables.changed([*(truth[name] for name in self._changed), *self._values])
        if self._disturbances:
            master.disturb({name: [truth[own] for own in names] for name, names in self._disturbances.items()})
        if is_stepping:
            master.begin(t, settings.macro_step, changed)
        outputs = [master.values[i] for i in self._recorded]
        row = self._sampler.row(measured, point.sample)
        written = [*self._held.tolist(), *(self._values[i] for i in self._further)]
        recorder.row([t, *outputs, *truth.values(), *written, *row])
        if is_stepping:
            master.finish(t, settings.macro_step, changed)
            self._read_back.check(changed, master.values)
        return has_diverged

    def _take(self, t: float, decision: Decision, recorder: Recorder) -> None:
        """Record a decision, and store the parameters that it writes."""
        for event in decision.events:
            recorder.event(event.t, event.kind, event.detail)
        self.latencies.append(self._k, decision.latencies)
        self.estimates.take(t, decision)
        if decision.write is not None:
            self._held = decision.write
            try:
                self._values = self._rule(decision.write)
            except ValueError as e:  # not with a guard, which vetoes it
                raise ScenarioError(f"estimation.parameters at t = {seconds(t)} s: {e}") from e


class _TrueParameters:
    """The true values of the estimated parameters (d,), as a function of time [s]."""

    def __init__(self, scenario: Scenario, truth: Mapping[str, Callable[[float], float]]) -> None:
        self._values = [truth[scenario.true_reference(p)] for p in scenario.estimation.parameters]

    def __call__(self, t: float) -> Vector:
        return np.array([value(t) for value in self._values])


def _recorded(scenario: Scenario, plant: Plant, names: Sequence[str]) -> set[str]:
    """Return the outputs that are recorded. Raises ScenarioError."""
    sampled = (name for columns in measured_columns(scenario, plant) for name in columns)
    try:
        return scenario.record.chosen(names, [*scenario.tracking, *scenario.tracking.values(), *sampled])
    except ValueError as e:
        raise ScenarioError(str(e)) from e


def _running_plant(
    scenario: Scenario, slave: Slave | TableSlave, wiring: Wiring, truth: Mapping[str, Callable[[float], float]]
) -> RunningPlant | None:
    """Return the running plant, for roll-outs; None for a table."""
    if isinstance(slave, TableSlave):
        return None
    changes = [name for name in scenario.changes if name.component == scenario.plant]
    functions = {name.variable: truth[name] for name in changes}
    parameters = {name: value for name, value in functions.items() if name not in wiring.disturbances}
    return RunningPlant(slave, wiring.outputs, parameters, {name: functions[name] for name in wiring.disturbances})
