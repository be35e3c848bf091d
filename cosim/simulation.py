"""Runs a scenario. At each communication point t_k, in this order:

get plant x, der(x), held u | noise | record sample | estimate | set controller theta, x, reference |
doStep controller | get u | set plant theta_true(t_k), u | doStep plant, reference.

It is legal FMI 2.0, which forbids get after set without a doStep (section 4.2.4), and delays nothing: a memoryless
controller's output after its step is the control law at x_k.
"""

from array import array
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from itertools import islice
from math import hypot
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from estimator import Estimate
from estimator.identifiability import IDENTIFIABLE_BELOW

from .errors import ScenarioError, SlaveError, WiringError
from .fmi.table import TableSlave, is_table
from .master import Master
from .policy import decide, make_policy, try_model
from .reconfigure import Reconfiguration
from .results.belief import Belief, belief
from .results.record import Recorder, uninterrupted
from .results.result import Run, Status, begin_folder, end_folder
from .sampling import Sampler
from .scenarios.aliases import as_the_fmus_have_it
from .scenarios.estimators import check_estimator, find_method
from .scenarios.scenario import Scenario
from .scenarios.system import check_parameters, fmu_paths, plant_of, start_value, true_parameters, wire
from .slaves.slave import Slave, open_slave
from .units import defined_units

Progress = Callable[[float, Mapping[str, float]], None]
"""Called at each communication point with the time [s] and what the controller holds, by parameter name."""


def run(
    scenario: Scenario,
    estimator: str = "target",
    seed: int = 0,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Run:
    """Simulate the scenario with its controller re-tuned by `estimator`: an estimator's name,
    `none`, `true`, or `module:Class` of the user's own.

    The same seed gives the same run, bit for bit, on one machine. With `out`, an existing empty folder, everything is
    recorded there. A fault of an FMU ends the run with status `faulted`: the rows so far are kept.
    Raises ScenarioError, ModelDescriptionError or WiringError before any step; KeyboardInterrupt when interrupted,
    the rows so far recorded.
    """
    check_estimator(estimator, scenario)
    paths = fmu_paths(scenario)
    with threadpool_limits(1), ExitStack() as stack:  # the number of BLAS threads changes bits
        begun = perf_counter()
        settings = scenario.scenario
        slaves = {
            name: stack.enter_context(
                TableSlave(path, name)
                if is_table(path)
                else open_slave(path, name, isolation=settings.isolation, timeout=settings.timeout)
            )
            for name, path in paths.items()
        }
        scenario = as_the_fmus_have_it(scenario, slaves)
        loop = _Loop(scenario, slaves, estimator, seed, stack)
        fault = loop.initialize()
        if out is not None:
            begin_folder(out, scenario, estimator, seed, paths, loop.plant)
        recorder = Recorder(out, loop.columns)
        status, error = ("faulted", fault) if fault else loop.execute(recorder, progress)
        wall = perf_counter() - begun
        policy = loop.policy
        with uninterrupted():  # and before the FMUs are closed, which may take its time
            result = Run(
                scenario, loop.plant, estimator, seed, recorder.close(), status, error, policy.n_evaluations,
                policy.n_episodes, loop.latencies, wall, out, policy.n_model_calls, loop.belief,
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
        estimator: str,
        seed: int,
        stack: ExitStack,
    ) -> None:
        """stack: closes what the run has opened. Raises ScenarioError, WiringError."""
        plant = plant_of(scenario, slaves[scenario.plant])
        check_parameters(scenario, slaves)
        wiring, groups = wire(scenario, slaves)
        noise, search = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
        self._scenario, self._estimator = scenario, estimator
        self.plant = plant
        self._master = Master(slaves, wiring, groups)
        self._sampler = Sampler(scenario, plant, self._master.names, noise)
        self._theta = np.array([start_value(scenario, slaves, p.writes) for p in scenario.estimation.parameters])
        self._truth = true_parameters(scenario, slaves)
        # Here, while the FMUs are still starting: what an estimator imports takes as long as they do.
        self.policy = make_policy(scenario, estimator, plant, self._theta, self._true_theta, search, stack)
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
        self.columns = ("time", *self._master.names, *self._truth, *self._writes, *self._sampler.columns)

    @property
    def latencies(self) -> tuple[tuple[float, ...], ...]:
        """Wall time of each evaluation [s], a tuple a macro step that had any."""
        seconds = iter(self._latencies)
        return tuple(tuple(islice(seconds, n)) for n in self._n_latencies)

    @property
    def belief(self) -> Belief | None:
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

    def execute(self, recorder: Recorder, progress: Progress | None) -> tuple[Status, str | None]:
        """Step to the end; returns how it ended and, for a fault, why."""
        settings = self._scenario.scenario
        names = self._scenario.estimation.space.names
        t = settings.start_time
        try:
            for k in range(settings.n_steps + 1):
                t = settings.time(k)
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
        sample = self._sampler.take(t, master.values, master.inputs.get(self._scenario.plant, {}))
        decision = decide(self.policy, self._estimator, sample if k else None, t, hypot(*errors))
        self._take(t, decision, recorder)
        truth = {reference: f(t) for reference, f in self._truth.items()}
        is_stepping = k < settings.n_steps and not has_diverged
        tunables = self._tunables(truth)
        if is_stepping:
            master.begin(t, settings.macro_step, tunables)
        recorder.row([t, *master.values, *truth.values(), *self._theta.tolist(), *self._sampler.row(sample)])
        if is_stepping:
            master.finish(t, settings.macro_step, tunables)
        return has_diverged

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
