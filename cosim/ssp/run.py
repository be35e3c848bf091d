"""Simulation of a system without an estimator: all FMUs step in parallel, and every output is recorded.

At t_k, at the start too, every input takes its source's output at t_k, then all FMUs step: libcosim's default.
"""

from collections.abc import Mapping
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import FolderError, SlaveError, WiringError
from ..files import sha256, write_json
from ..fmi.ports import is_numeric
from ..fmi.types import Value
from ..runs.lock import locked
from ..runs.record import Recorder, recording
from ..runs.run_files import CSV, MANIFEST, RESULT, new_run_folder
from ..runs.series import write_csv
from ..scenarios.schema.record import RecordSettings
from ..scenarios.schema.simulation import SimulationSettings
from ..slaves.slave import Slave, open_slave
from ..system.master import Master, Wiring
from ..text_table import aligned
from ..units import IDENTITY, Linear
from .package import SystemStructure


@dataclass(frozen=True)
class SystemRun:
    """A finished simulation of a system. `run["plant.phi"]` is that output's series."""

    system: SystemStructure
    """The simulated system."""
    settings: SimulationSettings
    """Times and steps."""
    series: Mapping[str, NDArray[np.float64]]
    """Every output (n,), one value at each communication point."""
    status: Literal["done", "faulted", "interrupted"]
    """Outcome of the run."""
    fault: SlaveError | None
    """The FMU's failure that ended it."""
    wall: float
    """Wall time [s]."""
    folder: Path | None
    """Run folder, where there is one."""

    @property
    def error(self) -> str | None:
        """Reason why it faulted, in one line."""
        return None if self.fault is None else str(self.fault)

    @property
    def time(self) -> NDArray[np.float64]:
        """Communication points [s] (n,)."""
        return self.series["time"]

    def __getitem__(self, name: str) -> NDArray[np.float64]:
        """Return an output's series (n,), by `component.variable`. Raises KeyError."""
        return self.series[name]

    def summary(self) -> dict[str, Any]:
        """Return the run's figures as JSON values."""
        outputs = {name: s for name, s in self.series.items() if name != "time" and len(s)}
        figures = {
            name: {"first": float(s[0]), "last": float(s[-1]), "min": float(s.min()), "max": float(s.max())}
            for name, s in outputs.items()
        }
        return {
            "system": self.system.name, "stop_time": float(self.time[-1]) if len(self.time) else None,
            "macro_step": self.settings.macro_step, "outputs": figures, "wall_s": self.wall, "status": self.status,
            "error": self.error, "run": str(self.folder) if self.folder else None,
        }  # fmt: skip


def simulate(system: SystemStructure, settings: SimulationSettings, out: Path | None = None) -> SystemRun:
    """Simulate the system; with `out`, an absent or empty folder, everything is recorded there.

    A fault of an FMU ends the run with status `faulted`: the rows so far are kept. Raises WiringError,
    ModelDescriptionError and FolderError, where `out` has a run or is another command's, before any step;
    KeyboardInterrupt when interrupted and UnfinishedError when the disk is full, the rows so far recorded.
    """
    if out is not None and not (out / MANIFEST).exists():
        new_run_folder(system.name, out)
    with nullcontext() if out is None else locked(out):
        if out is not None and (out / MANIFEST).exists():
            raise FolderError(f"{out} holds a run already.")
        return _simulated(system, settings, out)


def _simulated(system: SystemStructure, settings: SimulationSettings, out: Path | None) -> SystemRun:
    begun = perf_counter()
    with ExitStack() as stack:
        slaves = {
            name: stack.enter_context(open_slave(component.fmu, name, **settings.slave_options))
            for name, component in system.components.items()
        }
        wiring = wiring_of(system, slaves)
        master = Master(slaves, wiring, [list(slaves)])
        fault = _initialize(master, settings)
        if out is not None:
            write_json(out / MANIFEST, _manifest(system, settings, "running"))
        recorder = Recorder(out, ("time", *master.names))
        stack.callback(recorder.release)
        status, fault = ("faulted", fault) if fault else _execute(master, settings, recorder)
        result = SystemRun(system, settings, recorder.close(), status, fault, perf_counter() - begun, out)
    if out is not None:
        with recording(out):
            write_json(out / RESULT, result.summary())
            if RecordSettings().is_small(len(result.time) * len(result.series)):
                write_csv(out / CSV, result.series)
            write_json(out / MANIFEST, _manifest(system, settings, status))
    if status == "interrupted":
        raise KeyboardInterrupt
    return result


def wiring_of(system: SystemStructure, slaves: Mapping[str, Slave]) -> dict[str, Wiring]:
    """Return each component's part in the simulation. Outputs are all declared ones that are numbers."""
    sources: dict[str, dict[str, str]] = {name: {} for name in slaves}
    conversions: dict[str, dict[str, Linear]] = {name: {} for name in slaves}
    for connection in system.connections:
        sources[connection.target.element][connection.target.connector] = str(connection.source)
        if connection.transform != IDENTITY:
            conversions[connection.target.element][connection.target.connector] = connection.transform
    outputs: dict[str, tuple[str, ...]] = {}
    for name, slave in slaves.items():
        declared = [v.name for v in slave.description.modelVariables if v.causality == "output" and is_numeric(v)]
        own = [c.source.connector for c in system.connections if c.source.element == name]
        outputs[name] = tuple(dict.fromkeys(chain(declared, own)))
    return {
        name: Wiring(sources[name], (), outputs[name], system.start.get(name, {}), conversions[name]) for name in slaves
    }


def _initialize(master: Master, settings: SimulationSettings) -> SlaveError | None:
    """Return the failure of an FMU, or None. Raises WiringError for a start value that is not passed on."""
    try:
        master.initialize(settings.start_time, settings.stop_time, is_propagated=True)
    except SlaveError as fault:
        if fault.function == "set":
            raise WiringError(f"{fault}.") from fault
        return fault
    return None


def _execute(
    master: Master, settings: SimulationSettings, recorder: Recorder
) -> tuple[Literal["done", "faulted", "interrupted"], SlaveError | None]:
    t = settings.start_time
    try:
        for k in range(settings.n_steps + 1):
            t = settings.time(k)
            recorder.row([t, *master.values])
            if k < settings.n_steps:
                master.finish(t, settings.macro_step, {})
    except SlaveError as fault:
        recorder.event(t, "fault", {"reason": str(fault)})
        return "faulted", fault
    except KeyboardInterrupt:
        return "interrupted", None
    return "done", None


def _manifest(system: SystemStructure, settings: SimulationSettings, status: str) -> dict[str, Any]:
    start: Mapping[str, Mapping[str, Value]] = system.start
    return {
        "status": status,
        "system": system.name,
        "fmus": {name: {"file": str(c.fmu), "sha256": sha256(c.fmu)} for name, c in system.components.items()},
        "start": start,
        "connections": {str(c.target): [str(c.source), *_numbers(c.transform)] for c in system.connections},
        "settings": settings.model_dump(mode="json"),
    }


def _numbers(transform: Linear) -> tuple[float, ...]:
    return () if transform == IDENTITY else (transform.factor, transform.offset)


def report(run: SystemRun) -> str:
    """Return the lines that `retune run` prints: each output's first and last value, and its range."""
    end = float(run.time[-1]) if len(run.time) else run.settings.start_time
    head = f"{run.system.name}: {end - run.settings.start_time:g} s simulated in {run.wall:.1f} s, no estimator"
    rows = [["output", "first", "last", "smallest", "largest"]]
    for name, f in run.summary()["outputs"].items():
        rows.append([name, *(f"{f[key]:.6g}" for key in ("first", "last", "min", "max"))])
    notes = [f"no component has the parameter '{name}': ignored" for name in run.system.ignored]
    return "\n".join([head, "", *aligned(rows), *notes, "", f"run folder {run.folder}"])
