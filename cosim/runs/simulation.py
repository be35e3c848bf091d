"""Simulation of a scenario, from its FMUs to a result."""

from collections.abc import Generator, Mapping
from contextlib import ExitStack, contextmanager
from numbers import Integral
from pathlib import Path
from time import perf_counter

from ..blas_threads import one_thread
from ..errors import FolderError, NotResumableError, told_at
from ..fmi.ports import attribute
from ..fmi.table import TableSlave, is_table
from ..retuning.estimators import check_estimator
from ..scenarios.scenario import Scenario
from ..scenarios.trust import check_trust, trusted, with_own
from ..slaves.slave import Slave, open_slave
from ..slaves.supervision.fork_server import forked_processes
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import fmu_paths
from ..system.package_cache import hold_those_of
from ..system.tuning import written_variables
from ..units import defined_units
from .checkpoint import Checkpoints
from .lock import locked
from .loop import StepProgress, open_loop
from .manifest import read_manifest, scenario_of
from .record import Recorder, recording, uninterrupted
from .result import Run, begin_folder, end_folder
from .resumable import Unfinished, has_begun, read_unfinished
from .run_files import new_run_folder
from .run_state import StartObjects


def run(
    scenario: Scenario | Path | str,
    estimator: str = "target",
    seed: int = 0,
    out: Path | str | None = None,
    progress: StepProgress | None = None,
) -> Run:
    """Simulate the scenario with its controller re-tuned by `estimator`: an estimator's name,
    `none`, `true`, or a user's `module:Class`.

    scenario: a Scenario, the name of one, or a TOML file. The same seed gives the same run, bit for bit, on one
    machine. With `out`, an absent or empty folder, everything is recorded there. A fault of an FMU ends the run with
    status `faulted`: the rows so far are kept.
    Raises ScenarioError, ModelDescriptionError, WiringError or FolderError before any step, ValueError for a seed that
    is no whole number from 0 on; KeyboardInterrupt when interrupted and UnfinishedError when the disk is full, the rows
    so far recorded: `resume` continues from them.
    """
    if not isinstance(seed, Integral) or seed < 0:
        raise ValueError(f"seed must be a whole number from 0 on, got {seed!r}.")
    scenario = with_own(scenario if isinstance(scenario, Scenario) else Scenario.load(scenario), estimator)
    return _simulated(scenario, estimator, seed, None if out is None else Path(out), progress)


def resume(folder: Path | str, progress: StepProgress | None = None, trust: bool = False) -> Run:
    """Resume a run that was killed, interrupted or faulted from its last checkpoint. The result is the same, bit for
    bit, as without the interruption; wall times are added up.

    trust: run the Python code that the folder names even if the run was not made by this user.
    Raises FolderError with the reason where that is impossible, leaving the folder unchanged; and what `run` raises.
    """
    folder = Path(folder)
    read_manifest(folder)  # else a lock would be put into a folder of something else
    with locked(folder):
        try:
            old = read_unfinished(folder)
            manifest = old.manifest
            scenario = scenario_of(folder, manifest)
            scenario = trusted(scenario) if trust else scenario
            return _simulated(scenario, manifest.estimator, manifest.seed, folder, progress, old)
        except NotResumableError as e:
            raise FolderError(f"{folder} cannot be resumed: {e}.") from e


def _simulated(
    scenario: Scenario,
    estimator: str,
    seed: int,
    out: Path | None,
    progress: StepProgress | None,
    old: Unfinished | None = None,
) -> Run:
    """Simulate for `run` or, with old, an earlier record to be continued, for `resume`."""
    check_trust(scenario, estimator)
    is_isolated = scenario.scenario.isolation == "process"
    with one_thread(), ExitStack() as stack:  # the number of BLAS threads changes bits
        with forked_processes(scenario.scenario.environment if is_isolated else None):
            check_estimator(estimator, scenario)
            paths = fmu_paths(scenario)
            hold_those_of(paths.values())
            begun = perf_counter()
            slaves = _opened(scenario, paths, stack)
            scenario = as_the_fmus_have_it(scenario, slaves)
            loop = open_loop(scenario, slaves, paths, estimator, seed, begun, stack)
        fault = loop.initialize()
        start = None if out is None or fault is not None else StartObjects(loop)
        if old is not None and old.checkpoint is not None:
            if start is None:
                raise NotResumableError((fault or "").rstrip("."))
            loop.go_to(old.checkpoint, start)
        if out is not None:
            stack.enter_context(_locked_folder(out, scenario.scenario.name, is_new=old is None))
        with recording(out):
            if out is not None:
                begin_folder(out, scenario, estimator, seed, paths, loop.plant)
            recorder = Recorder(out, loop.columns, old and old.place)
        stack.callback(recorder.release)
        checkpoints = Checkpoints(out, scenario.scenario.checkpoint, start)
        status, error = ("faulted", fault) if fault else loop.execute(recorder, checkpoints, progress)
        wall = perf_counter() - loop.begun
        policy = loop.policy
        with recording(out), uninterrupted():  # and before the FMUs are closed, which may take its time
            result = Run(
                scenario, loop.plant, estimator, seed, recorder.close(), status, error, policy.n_evaluations,
                policy.n_episodes, loop.latencies.by_step(), wall, out, policy.n_model_calls, policy.describe(),
                **policy.summary(), final_estimate=loop.estimates.final(), latency_steps=loop.latencies.stretches(),
            )  # fmt: skip
            if out is not None:
                _end_folder(result, out, slaves)
    if status == "interrupted":
        raise KeyboardInterrupt
    return result


def _opened(scenario: Scenario, paths: Mapping[str, Path], stack: ExitStack) -> dict[str, Slave | TableSlave]:
    """Return the slave of each component, which the stack closes."""
    options = scenario.scenario.slave_options
    slaves: dict[str, Slave | TableSlave] = {}
    for name, path in paths.items():
        component = scenario.components[name]
        with told_at(f"components.{name}.{component.file_key}"):
            slaves[name] = stack.enter_context(
                TableSlave(path, name)
                if is_table(path)
                else open_slave(path, name, **options, tolerance=component.tolerance)
            )
    return slaves


@contextmanager
def _locked_folder(out: Path, name: str, is_new: bool) -> Generator[None]:
    """Lock a run folder, which is made where the run is new. Raises FolderError where that holds a run already."""
    if is_new and not has_begun(out):
        new_run_folder(name, out)
    with locked(out):
        if is_new and has_begun(out):
            raise FolderError(f"{out} holds a run already.")
        yield


def _end_folder(result: Run, out: Path, slaves: Mapping[str, Slave | TableSlave]) -> None:
    """Write what a run folder has at the end, with the units that the FMUs define."""
    declared = [slave.description.unitDefinitions for slave in slaves.values()]
    units = {name: unit for d in declared for name, unit in defined_units(d).items()}
    of_formulas = written_variables(result.scenario, slaves)
    end_folder(result, out, units, {name: attribute(v, "unit") for name, v in of_formulas.items()})
