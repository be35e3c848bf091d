"""Runs a scenario. At each communication point t_k, in this order:

get plant x, der(x), held u | noise | record sample | estimate | set controller theta, x, reference |
doStep controller | get u | set plant theta_true(t_k), u | doStep plant, reference.

It is legal FMI 2.0, which forbids get after set without a doStep (section 4.2.4), and delays nothing: a memoryless
controller's output after its step is the control law at x_k.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from math import hypot
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from estimator import Sample, Vector

from .errors import SlaveError
from .master import Master
from .policy import Policy, make_policy
from .reconfigure import Reconfiguration
from .record import Recorder
from .result import Run, Status, begin_folder, end_folder
from .scenario import Scenario
from .slave import open_slave
from .system import Plant, fmu_paths, input_defaults, plant_of, start_value, wire

Progress = Callable[[float, Mapping[str, float]], None]
"""Called at each communication point with the time [s] and what the controller holds, by parameter name."""


def run(
    scenario: Scenario,
    estimator: str = "target",
    seed: int = 0,
    out: Path | None = None,
    progress: Progress | None = None,
) -> Run:
    """Simulate the scenario with its controller re-tuned by `estimator`: an estimator's name, `none` or `true`.

    The same seed gives the same run, bit for bit, on one machine. With `out`, an existing empty folder, everything is
    recorded there. A fault of an FMU ends the run with status `faulted`: the rows so far are kept.
    Raises ValueError for an unknown estimator; ScenarioError, ModelDescriptionError, WiringError before any step.
    """
    paths = fmu_paths(scenario)
    with threadpool_limits(1), ExitStack() as stack:  # the number of BLAS threads changes bits
        begun = perf_counter()
        settings = scenario.scenario
        slaves = {
            name: stack.enter_context(open_slave(path, name, isolation=settings.isolation, timeout=settings.timeout))
            for name, path in paths.items()
        }
        wiring, groups = wire(scenario, slaves)
        plant = plant_of(scenario, slaves[scenario.plant])
        theta = np.array([start_value(scenario, slaves, p.writes) for p in scenario.estimation.parameters])
        truth = _true_parameters(scenario, lambda reference: start_value(scenario, slaves, reference))
        noise, search = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
        policy = make_policy(scenario, estimator, plant, theta, truth, search)
        loop = _Loop(
            scenario, Master(slaves, wiring, groups), plant, policy, theta, noise,
            input_defaults(slaves[plant.name]), tuple(wiring[plant.name].sources),
        )  # fmt: skip
        if out is not None:
            begin_folder(out, scenario, estimator, seed, paths)
        recorder = Recorder(out, loop.columns)
        status, error = loop.execute(recorder, progress)
        wall = perf_counter() - begun
    result = Run(
        scenario=scenario, estimator=estimator, seed=seed, series=recorder.close(), status=status, error=error,
        n_evaluations=policy.n_evaluations, n_episodes=policy.n_episodes, latencies=tuple(loop.latencies), wall=wall,
        folder=out,
    )  # fmt: skip
    if out is not None:
        end_folder(result, out)
    if status == "interrupted":
        raise KeyboardInterrupt
    return result


class _Loop:
    """One run in progress."""

    def __init__(
        self, scenario: Scenario, master: Master, plant: Plant, policy: Policy, theta: Vector,
        noise: np.random.Generator, input_defaults: Mapping[str, float], connected: Sequence[str],
    ) -> None:  # fmt: skip
        self._scenario, self._master, self._plant, self._policy = scenario, master, plant, policy
        self._theta, self._noise = theta, noise
        self._input_defaults, self._connected = input_defaults, connected
        self._changes = scenario.change_functions()
        self._writes = [p.writes for p in scenario.estimation.parameters]
        self._names = [p.name for p in scenario.estimation.parameters]
        self._written: dict[str, list[float]] = {}
        place = {name: i for i, name in enumerate(master.names)}
        self._tracked = [(place[a], place[b]) for a, b in scenario.tracking.items()]
        self._sampled = [place[name] for name in scenario.sampling.derivatives]
        self._x = [place[f"{plant.name}.{name}"] for name in plant.states]
        states = scenario.sampling.states
        self._sigma = np.array(
            [n.noise for n in scenario.sampling.derivatives.values()]
            + [states[s].noise if s in states else 0.0 for s in (f"{plant.name}.{name}" for name in plant.states)]
        )
        self.latencies: list[tuple[float, ...]] = []
        self.columns = (
            "time", *master.names, *self._changes, *self._writes,
            *(f"sampled.{name}" for name in scenario.sampling.derivatives),
        )  # fmt: skip

    def execute(self, recorder: Recorder, progress: Progress | None) -> tuple[Status, str | None]:
        """Step to the end; returns how it ended and, for a fault, why."""
        settings = self._scenario.scenario
        t = settings.start_time
        try:
            self._master.initialize(settings.start_time, settings.stop_time)
            for k in range(settings.n_steps + 1):
                t = settings.time(k)
                is_last = k == settings.n_steps
                if self._exchange(t, is_first=k == 0, is_last=is_last, recorder=recorder):
                    return "diverged", None
                if progress is not None:
                    progress(t, dict(zip(self._names, self._theta.tolist(), strict=True)))
        except SlaveError as fault:
            recorder.event(t, "fault", {"reason": str(fault)})
            return "faulted", str(fault)
        except KeyboardInterrupt:
            recorder.event(t, "interrupt", {})
            return "interrupted", None
        return "done", None

    def _exchange(self, t: float, is_first: bool, is_last: bool, recorder: Recorder) -> bool:
        """One communication point; returns whether the run has diverged there."""
        h, master = self._scenario.scenario.macro_step, self._master
        values = master.values
        errors = [values[a] - values[b] for a, b in self._tracked]
        has_diverged = not all(abs(e) <= self._scenario.limits.divergence for e in errors)
        noise = self._sigma * self._noise.standard_normal(len(self._sigma))  # at every point, used or not
        sample = self._sample(t, noise)
        self._take(self._policy.step(t, None if is_first else sample, hypot(*errors)), recorder)
        tunables = self._tunables(t)
        is_stepping = not (is_last or has_diverged)
        if is_stepping:
            master.begin(t, h, tunables)
        changed = [f(t) for f in self._changes.values()]
        recorder.row([t, *master.values, *changed, *self._theta.tolist(), *sample.xdot])
        if is_stepping:
            master.finish(t, h, tunables)
        return has_diverged

    def _sample(self, t: float, noise: Vector) -> Sample:
        values, n = self._master.values, len(self._sampled)
        xdot = [values[i] + e for i, e in zip(self._sampled, noise[:n].tolist(), strict=True)]
        x = [values[i] + e for i, e in zip(self._x, noise[n:].tolist(), strict=True)]
        held = dict(zip(self._connected, self._master.inputs.get(self._plant.name, []), strict=False))
        u = tuple(held.get(name, default) for name, default in self._input_defaults.items())
        return Sample(t, tuple(x), u, tuple(xdot))

    def _take(self, decision: Reconfiguration, recorder: Recorder) -> None:
        for event in decision.events:
            recorder.event(event.t, event.kind, event.detail)
        if decision.latencies:
            self.latencies.append(decision.latencies)
        if decision.write is not None:
            self._theta = decision.write

    def _tunables(self, t: float) -> dict[str, list[float]]:
        """Values of the tunable parameters of those FMUs where one has changed, in the order of the wiring."""
        now: dict[str, list[float]] = {}
        values = [f(t) for f in self._changes.values()] + self._theta.tolist()
        for reference, value in zip([*self._changes, *self._writes], values, strict=True):
            now.setdefault(reference.partition(".")[0], []).append(value)
        changed = {name: v for name, v in now.items() if self._written.get(name) != v}
        self._written |= changed
        return changed


def _true_parameters(scenario: Scenario, start: Callable[[str], float]) -> Callable[[float], Vector]:
    """The plant's true values of the estimated parameters, as a function of t [s]."""
    changes = scenario.change_functions()
    constants: dict[str, float] = {}
    references = [scenario.true_reference(p) for p in scenario.estimation.parameters]
    for reference in references:
        if reference not in changes:
            constants[reference] = start(reference)

    def truth(t: float) -> Vector:
        return np.array([changes[r](t) if r in changes else constants[r] for r in references])

    return truth
