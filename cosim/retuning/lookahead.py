"""Simulation of the closed loop ahead of time, in FMUs of its own: a prediction of the effect of a write.

These shadow FMUs are set to the FMU states of the run, which hold all that its FMUs do; then the plant's estimated
parameters are overwritten by those to be tried, and its disturbances by their start values: on a real plant nobody
knows them. A plant that cannot save its state is replaced by the scenario's model.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property
from math import inf
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from estimator import Sample, Vector
from estimator.differences import central_differences

from ..errors import CosimError, ScenarioError, SlaveError, WiringError
from ..fmi.archive import capabilities, unpacked
from ..fmi.folder import PrivateFolder, kept_folders
from ..fmi.table import TableSlave
from ..scenarios.scenario import Scenario
from ..scenarios.tuning_rule import TuningRule
from ..slaves.killed import unless_killed
from ..slaves.slave import Slave, open_slave
from ..system.loop_plan import LoopPlan, fit_together, listed
from ..system.loop_process import LoopProcess
from ..system.master import Steppable, Wiring
from ..system.parameters import start_values
from ..system.plant import Plant
from ..system.shadow_loop import Course, ShadowLoop, Shadows
from .model_plant import ModelPlant, not_given

_AHEAD: Final = "simulated ahead"
_INPUT_STEP: Final = 1e-4
"""Step of differences in an input, as a share of its size."""


class RunningSystem(NamedTuple):
    """The FMUs of a run, with their wiring."""

    slaves: Mapping[str, Slave | TableSlave]
    wiring: Mapping[str, Wiring]
    groups: Sequence[Sequence[str]]
    """Groups in which the FMUs step."""
    paths: Mapping[str, Path]
    """File of each FMU."""
    names: Sequence[str]
    """Names of all outputs, `component.variable`, in the master's order."""


class Lookahead:
    """Predictor of tracking errors. Its FMUs are loaded by `prepare`, where one process holds them, or when needed."""

    def __init__(
        self,
        scenario: Scenario,
        running: RunningSystem,
        plant: Plant,
        model: Callable[..., Sequence[float]] | None,
        stack: ExitStack,
        rule: TuningRule,
    ) -> None:
        """running: the run's FMUs; model: the plant's, if any; stack closes the shadows; rule: of the controllers.

        Raises CosimError with the reason where the loop cannot be simulated ahead.
        """
        slaves, wiring = running.slaves, running.wiring
        self._scenario, self._running, self._slaves = scenario, running, slaves
        self._plant, self._model = plant, model
        true = [scenario.true_reference(p) for p in scenario.estimation.parameters]
        self._places = {name: [i for i, r in enumerate(true) if r.component == name] for name in slaves}
        writes, self._rule = list(scenario.written), rule
        self._written = {name: [i for i, r in enumerate(writes) if r.component == name] for name in slaves}
        self._modelled = _modelled(scenario, slaves, wiring, plant, model)
        self._wiring = {
            name: replace(
                w,
                tunables=tuple(r.variable for r in [*true, *writes] if r.component == name),
                start={**w.start, **dict(zip(w.disturbances, _undisturbed(scenario, slaves, name, w), strict=True))},
                disturbances=() if name == self._modelled else w.disturbances,
            )
            for name, w in wiring.items()
        }
        for name, w in self._wiring.items():
            slave = slaves[name]
            if isinstance(slave, Slave) and name != self._modelled:
                slave.check_tunables(w.tunables)
        self._files = {name: _file(path) for name, path in running.paths.items()}
        self._stack = stack.enter_context(ExitStack())
        self._shadows: Shadows | None = None
        self._is_proved = False  # the states have been saved and restored
        self.n_rolled = 0
        """Number of times that the loop was simulated ahead."""
        self.failure: str | None = None
        """Reason why the loop cannot be simulated ahead after all, or None."""

    def to_checkpoint(self) -> tuple[int, str | None]:
        """Return `n_rolled` and `failure`: the rest is set to the present state whenever it is needed."""
        return self.n_rolled, self.failure

    def from_checkpoint(self, saved: tuple[int, str | None]) -> None:
        """Restore the saved count and failure."""
        self.n_rolled, self.failure = saved

    def prepare(self) -> None:
        """Begin to load the shadows, where they have a process of their own, while the run goes on.

        Raises ScenarioError as `predicted_peak`.
        """
        if self.failure is None and self._fits_one_process:
            try:
                self._opened()
            except (SlaveError, WiringError) as fault:
                self._give_up(str(fault))

    def snapshot(self, sample: Sample) -> dict[str, Any] | None:
        """Return the states of the run's FMUs at this communication point, or None. Raises SlaveError.

        None, with `failure` set, where an FMU cannot save its state though it declares so: its shadow is tried first.
        """
        if self.failure is not None:
            return None
        try:
            unless_killed(self._proved, self._forget)
        except (SlaveError, WiringError) as fault:
            self._give_up(str(fault))
            return None
        states: dict[str, Any] = {}
        for name, slave in self._slaves.items():
            if name == self._modelled:
                states[name] = sample.x
            elif isinstance(slave, Slave):
                states[name] = slave.get_state()
        return states

    def predicted_peak(
        self,
        snapshot: Mapping[str, Any],
        values: Sequence[float],
        k: int,
        controller: Vector,
        plant: Vector,
        offsets: Sequence[float] | None = None,
    ) -> float | None:
        """Return the largest norm of the tracking error over the horizon; infinite where an FMU fails or it diverges.

        values: of all outputs now, at communication point k; controller, plant: theta (d,) in each; offsets: added to
        the plant's connected inputs, see `equivalent_inputs`. None where the
        plant does not take these parameters, so that nothing is known, and where the FMUs' states cannot be restored:
        see `failure`. Raises ScenarioError where the FMUs cannot be unpacked any more, as on a full disk: the run
        faults, and can be resumed.
        """
        if self.failure is not None:
            return None

        def restored() -> Shadows:
            shadows = self._opened()
            shadows.restore(snapshot, values)
            return shadows

        try:
            unless_killed(restored, self._forget)
        except (SlaveError, WiringError) as fault:
            self._give_up(str(fault))
            return None
        self.n_rolled += 1
        course = self._course(k, controller, plant, offsets)
        try:
            return unless_killed(lambda: (self._shadows or restored()).peak(course), self._forget)
        except SlaveError as fault:
            self._forget()  # loaded anew for the next
            return None if fault.function == "set" else inf  # a value that was refused before it reached the FMU

    def equivalent_inputs(self, sample: Sample, disturbance: Vector, theta: Vector) -> list[float] | None:
        """Return the offsets of the plant's connected inputs that act most like a disturbance; None if unknown.

        disturbance (c,): of the sampled derivatives, in their units, or, without a model, (p,) of the inputs
        themselves; theta (d,): parameters of the plant. To first order, and as far as the inputs reach: She et al.
        (2008), "Improving disturbance-rejection performance based on an equivalent-input-disturbance approach", IEEE
        Transactions on Industrial Electronics 55(1).
        """
        if self._model is None:
            own = dict(zip(self._plant.inputs, disturbance.tolist(), strict=True))
            return [own[name] for name in self._wiring[self._plant.name].sources]
        named = dict(zip(self._scenario.estimation.space.names, theta.tolist(), strict=True))
        channels, names = list(self._plant.channels), list(self._plant.inputs)
        u = np.array(sample.u)
        if not np.all(np.isfinite([*sample.x, *u])):
            return None
        connected = [names.index(name) for name in self._wiring[self._plant.name].sources]

        def derivatives(some: Vector) -> Vector:
            assert self._model is not None
            inputs = u.copy()
            inputs[connected] = some
            return np.array(self._model(sample.x, tuple(inputs.tolist()), **named))[channels]

        try:
            slopes = central_differences(derivatives, u[connected], _INPUT_STEP * np.maximum(np.abs(u[connected]), 1.0))
        except (ArithmeticError, ValueError):  # where the model has no value
            return None
        if not np.all(np.isfinite(slopes)):
            return None
        return np.linalg.lstsq(slopes, disturbance, rcond=1e-9)[0].tolist()

    def _course(self, k: int, controller: Vector, plant: Vector, offsets: Sequence[float] | None) -> Course:
        """Return the steps from communication point k; as for `predicted_peak`."""
        settings = self._scenario.scenario
        horizon, values = min(self._scenario.guard.horizon, settings.n_steps - k), self._rule(controller)
        tunables = {
            name: [*(float(plant[i]) for i in self._places[name]), *(values[i] for i in written)]
            for name, written in self._written.items()
        }
        return Course(
            [settings.time(j) for j in range(k, k + horizon)],
            settings.macro_step,
            {name: v for name, v in tunables.items() if v},
            {} if offsets is None else {self._plant.name: offsets},
            self._scenario.limits.divergence,
        )

    def _forget(self) -> None:
        self._shadows = None
        self._stack.close()

    def _give_up(self, reason: str) -> None:
        self.failure = reason
        self._forget()

    def _proved(self) -> None:
        shadows = self._opened()
        if not self._is_proved:
            shadows.prove()
            self._is_proved = True

    def _opened(self) -> Shadows:
        """Return the shadows: in one process where they fit into one. Raises WiringError, SlaveError, ScenarioError."""
        if self._shadows is None:
            self._shadows = self._loaded()
        return self._shadows

    def _loaded(self) -> Shadows:
        paths = self._running.paths
        for name, path in paths.items():
            if name != self._modelled and _file(path) != self._files[name]:
                raise WiringError(f"{path} has changed since the run began")
        return self._loop_process() if self._fits_one_process else self._loop_here()

    @cached_property
    def _fits_one_process(self) -> bool:
        paths = [self._running.paths[name] for name, slave in self._slaves.items() if isinstance(slave, Slave)]
        is_isolated = self._scenario.scenario.isolation == "process" and self._modelled is None
        return is_isolated and len(set(paths)) == len(paths) and fit_together(paths)

    def _loop_process(self) -> Shadows:
        settings, components = self._scenario.scenario, self._scenario.components
        plan = LoopPlan(
            _AHEAD,
            self._stack.enter_context(_folder()),
            {name: str(self._running.paths[name].absolute()) for name in self._slaves},
            {name: components[name].tolerance for name in self._slaves},
            {name: listed(w) for name, w in self._wiring.items()},
            self._running.groups,
            list(self._scenario.tracking.items()),
            (settings.start_time, settings.stop_time),
            settings.timeout,
            settings.out_of_range,
            self._kept(),
        )
        process = LoopProcess(plan, settings.memory_limit * len(self._slaves), settings.environment)
        self._stack.callback(process.close)
        return process

    def _kept(self) -> dict[str, str]:
        """Return a folder for each FMU that it is unpacked into, where such folders are kept from run to run."""
        if (kept := kept_folders()) is None:
            return {}
        folders: dict[str, str] = {}
        for name, slave in self._slaves.items():
            if isinstance(slave, Slave):
                with _refused():
                    _, folder = unpacked(self._running.paths[name], is_checked=True, kept=kept)
                self._stack.callback(folder.remove)
                folders[name] = folder.path
        return folders

    def _loop_here(self) -> Shadows:
        settings, shadows = self._scenario.scenario, dict[str, Steppable]()
        for name, slave in self._slaves.items():
            path, label = self._running.paths[name], f"{name} ({_AHEAD})"
            if name == self._modelled and self._model is not None:
                space = self._scenario.estimation.space
                shadows[name] = ModelPlant(self._plant, self._model, space.names, self._plant.rates)
            elif isinstance(slave, TableSlave):
                shadows[name] = TableSlave(path, label)
            else:
                once = bool(capabilities(slave.description).canBeInstantiatedOnlyOncePerProcess)
                own: dict[str, Any] = settings.slave_options | ({"isolation": "process"} if once else {})
                own["tolerance"] = self._scenario.components[name].tolerance
                shadows[name] = self._stack.enter_context(_open(path, label, own))
        tracked = list(self._scenario.tracking.items())
        span = (settings.start_time, settings.stop_time)
        return ShadowLoop(shadows, self._wiring, self._running.groups, tracked, span)


class Prediction:
    """Prediction from one communication point; the FMUs' states are read once, and only if needed."""

    def __init__(self, lookahead: Lookahead, k: int, measured: Sample, values: Sequence[float]) -> None:
        """k: the communication point; measured: the plant there; values: of all outputs there."""
        self._lookahead, self._k, self._measured, self._values = lookahead, k, measured, list(values)
        self._snapshots: list[dict[str, Any] | None] = []

    def __call__(self, controller: Vector, plant: Vector, disturbance: Vector | None = None) -> float | None:
        """Return the largest norm of the tracking error with theta (d,) in each; None where it is unknown.

        disturbance: a `Proposal.possible_disturbance`, which goes on.
        """
        if not self._snapshots:
            self._snapshots.append(self._lookahead.snapshot(self._measured))
        snapshot = self._snapshots[0]
        if snapshot is None:
            return None
        offsets = None
        if disturbance is not None and np.any(disturbance):
            offsets = self._lookahead.equivalent_inputs(self._measured, disturbance, plant)
            if offsets is None:
                return None
        return self._lookahead.predicted_peak(snapshot, self._values, self._k, controller, plant, offsets)


def _folder() -> PrivateFolder:
    """Return a folder to unpack the FMUs into. Raises ScenarioError."""
    with _refused():
        return PrivateFolder()


def _open(path: Path, label: str, options: Mapping[str, Any]) -> Slave:
    """Open a shadow. Raises ScenarioError."""
    with _refused():
        return open_slave(path, label, **options)


@contextmanager
def _refused() -> Generator[None]:
    """Raise ScenarioError for a refused FMU: it could be opened before, so the disk is full, or it has gone."""
    try:
        yield
    except CosimError as e:
        raise ScenarioError(f"the loop cannot be simulated ahead: {e}") from e


def _file(path: Path) -> tuple[int, int, int] | None:
    """Return inode, size and modification time of a file, which change with it; None where there is none."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _undisturbed(
    scenario: Scenario, slaves: Mapping[str, Slave | TableSlave], name: str, wiring: Wiring
) -> list[float]:
    """Return the start values of an FMU's disturbances. Raises WiringError."""
    return start_values(scenario, slaves, [f"{name}.{own}" for own in wiring.disturbances])


def _modelled(
    scenario: Scenario,
    slaves: Mapping[str, Slave | TableSlave],
    wiring: Mapping[str, Wiring],
    plant: Plant,
    model: Callable[..., Sequence[float]] | None,
) -> str | None:
    """Return the plant's name, if the model must replace it; None if every FMU saves its state. Raises CosimError."""
    lacking = [name for name, slave in slaves.items() if isinstance(slave, Slave) and not slave.has_states]
    if not lacking:
        return None
    if lacking != [plant.name]:
        others = ", ".join(name for name in lacking if name != plant.name)
        raise CosimError(f"{others} cannot save and restore the state of the FMU")
    if model is None:
        raise CosimError(f"{plant.name} cannot save its state, and no model stands for it")
    read = {s for w in wiring.values() for s in w.sources.values()} | {*scenario.tracking, *scenario.tracking.values()}
    elsewhere = [r for p in scenario.estimation.parameters if (r := scenario.true_reference(p)).component != plant.name]
    if elsewhere:
        raise CosimError(f"{plant.name} cannot save its state, and its model does not set '{elsewhere[0]}'")
    if missing := not_given(plant, plant.rates, read):
        raise CosimError(f"{plant.name} cannot save its state, and the model does not give '{missing}'")
    return plant.name
