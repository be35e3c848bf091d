"""Runs a scenario. At each communication point t_k, in this order:

get plant x, der(x), held u | noise | record sample | estimate | set controller theta, x, reference |
doStep controller | get u | set plant theta_true(t_k), u | doStep plant, reference.

It is legal FMI 2.0, which forbids get after set without a doStep (section 4.2.4), and delays nothing: a memoryless
controller's output after its step is the control law at x_k.
"""

from array import array
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from math import hypot
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from estimator import Estimate, Sample
from estimator.identifiability import IDENTIFIABLE_BELOW
from estimator.retuner import Reconfiguration, Retuner

from ..errors import CosimError, FolderError, NotResumableError, ScenarioError, SlaveError, WiringError
from ..fmi.table import TableSlave, is_table
from ..objectives.rollout_fmu import RunningPlant
from ..retuning.estimators import check_estimator, find_method
from ..retuning.lookahead import Running
from ..retuning.policies import decide, failed_at, make_policy, try_model, whitened_residual
from ..retuning.supervisor import Supervisor
from ..sampling.sampler import Sampler
from ..scenarios.scenario import Scenario
from ..slaves.slave import Slave, open_slave
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import fmu_paths
from ..system.master import Master, Wiring
from ..system.parameters import check_parameters, start_value, true_parameters
from ..system.plant import plant_of
from ..system.wiring import wire, with_read_back
from ..units import defined_units
from ..user_code import USERS
from .checkpoint import Checkpoint, Checkpoints, restore
from .final_estimate import FinalEstimate, belief
from .lock import locked
from .manifest import Status, read_manifest, scenario_of
from .record import Recorder, recording, uninterrupted
from .result import Run, begin_folder, end_folder
from .resumable import Unfinished, has_begun, read_unfinished
from .run_files import new_run_folder

Progress = Callable[[float, Mapping[str, float]], None]
"""Called at each communication point with the time [s] and what the controller holds, by parameter name."""


def run(
    scenario: Scenario | Path | str,
    estimator: str = "target",
    seed: int = 0,
    out: Path | str | None = None,
    progress: Progress | None = None,
) -> Run:
    """Simulate the scenario with its controller re-tuned by `estimator`: an estimator's name,
    `none`, `true`, or `module:Class` of the user's own.

    scenario: a Scenario, the name of one, or a TOML file. The same seed gives the same run, bit for bit, on one
    machine. With `out`, an absent or empty folder, everything is recorded there. A fault of an FMU ends the run with
    status `faulted`: the rows so far are kept.
    Raises ScenarioError, ModelDescriptionError, WiringError or FolderError before any step; KeyboardInterrupt when
    interrupted and UnfinishedError when the disk is full, the rows so far recorded: `resume` goes on with them.
    """
    scenario = scenario if isinstance(scenario, Scenario) else Scenario.load(scenario)
    return _simulated(scenario, estimator, seed, None if out is None else Path(out), progress)


def resume(folder: Path | str, progress: Progress | None = None) -> Run:
    """Go on with a run that was killed, interrupted or faulted, from its last checkpoint, to the same bits as if
    nothing had happened; wall times are added up.

    Raises FolderError where that cannot be, with the reason, the folder being as it was; and what `run` raises.
    """
    folder = Path(folder)
    read_manifest(folder)  # else a lock would be put into a folder of something else
    with locked(folder):
        try:
            old = read_unfinished(folder)
            manifest = old.manifest
            scenario = scenario_of(folder, manifest)
            return _simulated(scenario, manifest.estimator, manifest.seed, folder, progress, old)
        except NotResumableError as e:
            raise FolderError(f"{folder} cannot be resumed: {e}.") from e


def _simulated(
    scenario: Scenario,
    estimator: str,
    seed: int,
    out: Path | None,
    progress: Progress | None,
    old: Unfinished | None = None,
) -> Run:
    """What `run` and, with an old record that goes on, `resume` do."""
    check_estimator(estimator, scenario)
    paths = fmu_paths(scenario)
    with threadpool_limits(1), ExitStack() as stack:  # the number of BLAS threads changes bits
        begun = perf_counter()
        settings = scenario.scenario
        slaves = {
            name: stack.enter_context(
                TableSlave(path, name) if is_table(path) else open_slave(path, name, **settings.slave_options)
            )
            for name, path in paths.items()
        }
        scenario = as_the_fmus_have_it(scenario, slaves)
        loop = _Loop(scenario, slaves, paths, estimator, seed, begun, stack)
        fault = loop.initialize()
        if old is not None and old.checkpoint is not None:
            loop.go_to(old.checkpoint, fault)
        if out is not None:
            if old is None and not has_begun(out):
                new_run_folder(settings.name, out)
            stack.enter_context(locked(out))
            if old is None and has_begun(out):
                raise FolderError(f"{out} holds a run already.")
        with recording(out):
            if out is not None:
                begin_folder(out, scenario, estimator, seed, paths, loop.plant)
            recorder = Recorder(out, loop.columns, old and old.place)
        stack.callback(recorder.release)
        checkpoints = Checkpoints(out, settings.checkpoint)
        status, error = ("faulted", fault) if fault else loop.execute(recorder, checkpoints, progress)
        wall = perf_counter() - loop.begun
        policy = loop.policy
        with recording(out), uninterrupted():  # and before the FMUs are closed, which may take its time
            result = Run(
                scenario, loop.plant, estimator, seed, recorder.close(), status, error, policy.n_evaluations,
                policy.n_episodes, loop.latencies, wall, out, policy.n_model_calls, policy.describe(),
                **loop.oversight_summary(), belief=loop.belief,
            )  # fmt: skip
            if out is not None:
                declared = [s.description.unitDefinitions for s in slaves.values()]
                end_folder(result, out, {k: u for d in declared for k, u in defined_units(d).items()})
    if status == "interrupted":
        raise KeyboardInterrupt
    return result


class _Loop:
    """One run in progress: the FMUs by way of the master, and what the controller holds."""

    def __init__(
        self,
        scenario: Scenario,
        slaves: Mapping[str, Slave | TableSlave],
        paths: Mapping[str, Path],
        estimator: str,
        seed: int,
        begun: float,
        stack: ExitStack,
    ) -> None:
        """begun: the clock then [s]; stack: closes what the run has opened. Raises ScenarioError, WiringError."""
        plant = plant_of(scenario, slaves[scenario.plant])
        check_parameters(scenario, slaves)
        wiring, groups = wire(scenario, slaves)
        wiring = with_read_back(wiring, [p.writes for p in scenario.estimation.parameters])
        noise, search, faults = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(3))
        self._scenario, self._estimator = scenario, estimator
        self.plant, self.begun = plant, begun
        self._k = 0
        self._master = Master(slaves, wiring, groups)
        self._sampler = Sampler(scenario, plant, self._master.names, noise, faults)
        self._theta = np.array([start_value(scenario, slaves, p.writes) for p in scenario.estimation.parameters])
        self._truth = true_parameters(scenario, slaves)
        # Here, while the FMUs are still starting: what an estimator imports takes as long as they do.
        live = _live(scenario, slaves[scenario.plant], wiring[scenario.plant], self._truth)
        whitened = whitened_residual(scenario, estimator, plant, stack)
        self.policy = make_policy(
            scenario, estimator, plant, self._theta, self._true_theta, search, stack, live, whitened
        )
        running = Running(slaves, wiring, groups, paths)
        self._oversight = (
            Supervisor(scenario, plant, self.policy, self._theta, whitened, running, stack)
            if isinstance(self.policy, Retuner)
            else None
        )
        self._estimated: tuple[float, Estimate] | None = None
        self._has_ended = False
        self._latencies, self._n_latencies = array("d"), array("L")  # an hour of tuples would be 30 MB
        self._writes = [p.writes for p in scenario.estimation.parameters]
        self._places: dict[str, list[int]] = {}
        for i, reference in enumerate([*scenario.changes, *self._writes]):
            self._places.setdefault(reference.partition(".")[0], []).append(i)
        self._written: dict[str, list[float]] = {}
        place = {name: i for i, name in enumerate(self._master.names)}
        self._tracked = [(place[a], place[b]) for a, b in scenario.tracking.items()]
        self._recorded = [i for i, name in enumerate(self._master.names) if name not in self._writes]
        recorded = [self._master.names[i] for i in self._recorded]
        self.columns = ("time", *recorded, *self._truth, *self._writes, *self._sampler.columns)

    @property
    def latencies(self) -> tuple[tuple[float, ...], ...]:
        """Wall time of each evaluation [s], a tuple a macro step that had any."""
        seconds = iter(self._latencies)
        return tuple(tuple(islice(seconds, n)) for n in self._n_latencies)

    @property
    def belief(self) -> FinalEstimate | None:
        """The estimate at the end of the last episode that ended, else the last; and what it says."""
        estimation = self._scenario.estimation
        method = find_method(self._estimator, self._scenario) if self._estimated else None
        settings = estimation.settings(self._estimator, method) if method else None
        below = getattr(settings, "identifiable_below", IDENTIFIABLE_BELOW)
        return self._estimated and belief(*self._estimated, estimation.space, below)

    def initialize(self) -> str | None:
        """Bring the FMUs to the start; why one failed, or None. Raises WiringError, ScenarioError."""
        settings = self._scenario.scenario
        try:
            self._master.initialize(settings.start_time, settings.stop_time)
        except SlaveError as fault:
            if fault.function == "set":  # refused before it reached the FMU
                raise WiringError(f"{fault}.") from fault
            return str(fault)
        self._true_theta(settings.start_time)  # a formula may have no value from the start
        first = self._sampler.exact(settings.start_time, self._master.values)
        try_model(self._scenario, self._estimator, self.plant, self._theta, first)
        return None

    @property
    def checkpoint_name(self) -> str:
        """See `cosim.runs.checkpoint.Alive`."""
        return "loop"

    def to_checkpoint(self) -> tuple[dict[str, Any], float]:
        """All that it holds but what is made of the scenario alone; wall time so far [s]."""
        held = {name: value for name, value in vars(self).items() if name not in ("_scenario", "_truth", "begun")}
        return held, perf_counter() - self.begun

    def from_checkpoint(self, saved: tuple[dict[str, Any], float]) -> None:
        """Hold that instead."""
        held, wall = saved
        vars(self).update(held)
        self.begun -= wall

    def go_to(self, checkpoint: Checkpoint, fault: str | None) -> None:
        """From the start to a checkpoint; fault: why there is no start. Raises NotResumableError."""
        try:
            if fault is None:
                restore(self, checkpoint)
        except SlaveError as e:
            fault = str(e)
        if fault is not None:
            raise NotResumableError(fault.rstrip("."))

    def execute(
        self, recorder: Recorder, checkpoints: Checkpoints, progress: Progress | None
    ) -> tuple[Status, str | None]:
        """Step to the end; returns how it ended and, for a fault, why. Raises UnfinishedError."""
        settings = self._scenario.scenario
        names = self._scenario.estimation.space.names
        t = settings.start_time
        try:
            for k in range(self._k, settings.n_steps + 1):
                self._k, t = k, settings.time(k)
                checkpoints.offer(k, self, recorder)
                for event in self._oversight.begin(t) if self._oversight is not None and not k else ():
                    recorder.event(t, event.kind, event.detail)
                if self._exchange(k, t, recorder):
                    return "diverged", None
                if progress is not None:
                    progress(t, dict(zip(names, self._theta.tolist(), strict=True)))
        except (SlaveError, ScenarioError) as fault:  # the latter: a change without a value, an estimator that raised
            recorder.event(t, "fault", {"reason": str(fault)})
            return "faulted", str(fault)
        except KeyboardInterrupt:
            recorder.event(t, "interrupt", {})
            return "interrupted", None
        return "done", None

    def _exchange(self, k: int, t: float, recorder: Recorder) -> bool:
        """Communication point k at t [s]; returns whether the run has diverged there."""
        settings, master = self._scenario.scenario, self._master
        errors = [master.values[a] - master.values[b] for a, b in self._tracked]
        has_diverged = not all(abs(e) <= self._scenario.limits.divergence for e in errors)
        measured = self._sampler.take(t, master.values, master.inputs.get(self._scenario.plant, {}))
        sample = self._sampler.filtered(measured)
        self._take(t, self._decide(k, t, measured, sample, hypot(*errors)), recorder)
        truth = {reference: f(t) for reference, f in self._truth.items()}
        is_stepping = k < settings.n_steps and not has_diverged
        tunables = self._tunables(truth)
        if is_stepping:
            master.begin(t, settings.macro_step, tunables)
        outputs = [master.values[i] for i in self._recorded]
        row = self._sampler.row(measured, sample)
        recorder.row([t, *outputs, *truth.values(), *self._theta.tolist(), *row])
        if is_stepping:
            master.finish(t, settings.macro_step, tunables)
        return has_diverged

    def _decide(self, k: int, t: float, measured: Sample, sample: Sample | None, error: float) -> Reconfiguration:
        """What the policy makes of the sample, as far as it is let through; error: norm of the tracking error."""
        oversight = self._oversight
        if oversight is None or not k:
            return decide(self.policy, self._estimator, sample if k else None, t, error)
        if oversight.has_stopped:
            return Reconfiguration()
        try:
            seen = oversight.seen(t, sample, self._theta)
            decision = decide(self.policy, self._estimator, seen.sample, t, error)
            reviewed = oversight.without_outlier(t, oversight.review(k, t, error, measured, decision, self._master))
        except CosimError:
            raise
        except USERS as e:
            raise failed_at("estimation.model", t, e) from e
        return replace(reviewed, events=(*seen.events, *reviewed.events)) if seen.events else reviewed

    def oversight_summary(self) -> dict[str, Any]:
        """What guard and screen have done, for the result."""
        return {} if self._oversight is None else self._oversight.summary()

    def _take(self, t: float, decision: Reconfiguration, recorder: Recorder) -> None:
        for event in decision.events:
            recorder.event(event.t, event.kind, event.detail)
        if decision.latencies:
            self._latencies.extend(decision.latencies)
            self._n_latencies.append(len(decision.latencies))
        is_end = any(event.kind == "end" for event in decision.events)
        if decision.estimate is not None and (is_end or not self._has_ended):
            self._estimated, self._has_ended = (t, decision.estimate), is_end
        if decision.write is not None:
            self._theta = decision.write

    def _tunables(self, truth: Mapping[str, float]) -> dict[str, list[float]]:
        """Values of the tunable parameters of those FMUs where one has changed, in the order of the wiring."""
        values = [*(truth[name] for name in self._scenario.changes), *self._theta.tolist()]
        now = {name: [values[i] for i in places] for name, places in self._places.items()}
        changed = {name: v for name, v in now.items() if self._written.get(name) != v}
        self._written |= changed
        return changed

    def _true_theta(self, t: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        references = (self._scenario.true_reference(p) for p in self._scenario.estimation.parameters)
        return np.array([self._truth[reference](t) for reference in references])


def _live(
    scenario: Scenario, slave: Slave | TableSlave, wiring: Wiring, truth: Mapping[str, Callable[[float], float]]
) -> RunningPlant | None:
    """The running plant, for shadows of it."""
    if isinstance(slave, TableSlave):
        return None
    changes = [r for r in scenario.changes if r.partition(".")[0] == scenario.plant]
    return RunningPlant(slave, wiring.outputs, {r.partition(".")[2]: truth[r] for r in changes})
