"""Wall time of a macro step of one FMU, and of three coupled ones: our master and others on the same FMUs.

    python -m benchmarks.master [--systems NAME ...] [--steps 1000] [--blocks 15]

A macro step sets every input, steps every FMU and gets all outputs back to Python. All masters are open in one process
and take turns, block by block; a figure is the median of the blocks. `oscillator` and `3 oscillators` (a ring) cost
next to nothing themselves; one kind is native (C), the other by pythonfmu. `pendulum` is the scenario's plant with its
two Runge-Kutta steps, `pendulum loop` the plant with its controller and reference.

Three pythonfmu FMUs in one process share modules of the same name, and the second runs the code of the first. Here that
does no harm, as they come from one file or from the same sources. In `ours, isolated` each has a process of its own.

FMPy's simulate_fmu takes one FMU only, and its time includes recording. libcosim and ecos pass outputs to inputs one
macro step later than our sequential coupling of the pendulum does: as many calls, other numbers.
"""

import argparse
import tempfile
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave

from benchmarks.native_fmus import build_native, build_python
from benchmarks.report import Row, spread, write
from cosim.slaves.slave import open_slave
from cosim.system.master import Master, Wiring
from fmu_models.build import build

H = 0.01
"""Macro step [s]."""
Steps = Callable[[int, int], Sequence[float]]
"""Function that makes the macro steps k .. k + n - 1 and returns all outputs after them."""


class Absent(Exception):
    """A master that cannot take part; the message says why."""


@dataclass(frozen=True)
class System:
    """FMUs and their connections."""

    name: str
    fmus: Mapping[str, Path]
    """Files by instance name."""
    connections: Mapping[str, str]
    """Outputs by the inputs that they feed; any other input is held at 0.1."""
    groups: Sequence[Sequence[str]]
    """Groups of FMUs that step at the same time; the groups step one after another."""

    @cached_property
    def descriptions(self) -> dict[str, Any]:
        """FMPy's model description of each FMU."""
        return {name: read_model_description(str(path)) for name, path in self.fmus.items()}

    def variables(self, name: str, causality: str) -> list[Any]:
        """Return the variables of this causality of one FMU."""
        return [v for v in self.descriptions[name].modelVariables if v.causality == causality]

    def outputs(self) -> list[tuple[str, str]]:
        """Return the (instance, variable) of all outputs, in the order in which Steps returns them."""
        return [(name, v.name) for name in self.fmus for v in self.variables(name, "output")]


def systems(folder: Path) -> Iterator[System]:
    """Yield the systems that are measured; one that cannot be built is named and left out."""
    ring = {f"o{i}.u": f"o{(i - 1) % 3}.x" for i in range(3)}
    for kind, make in (("native", build_native), ("pythonfmu", build_python)):
        try:
            fmu = make(folder)
        except RuntimeError as error:
            print(f"{kind} oscillator skipped: {error}")
            continue
        yield System(f"oscillator, {kind}", {"o": fmu}, {}, [["o"]])
        names = ["o0", "o1", "o2"]
        yield System(f"3 oscillators, {kind}", dict.fromkeys(names, fmu), ring, [names])
    pendulum, controller, reference = (build(f"Pendulum{kind}", folder) for kind in ("", "Controller", "Reference"))
    yield System("pendulum", {"plant": pendulum}, {}, [["plant"]])
    loop = {"plant.u": "controller.u"}
    loop |= {f"controller.{x}": f"plant.{x}" for x in ("phi", "phi_dot")}
    loop |= {f"controller.{x}_ref": f"reference.{x}_ref" for x in ("phi", "phi_dot")}
    fmus = {"plant": pendulum, "controller": controller, "reference": reference}
    yield System("pendulum loop", fmus, loop, [["controller"], ["plant", "reference"]])


@contextmanager
def ours(system: System, isolation: Any) -> Generator[Steps]:
    """Open one FMU as a Slave, or several under a Master."""
    with ExitStack() as stack:
        slaves = {n: stack.enter_context(open_slave(p, n, isolation=isolation)) for n, p in system.fmus.items()}
        wiring = {
            name: Wiring(
                {v.name: system.connections[f"{name}.{v.name}"] for v in system.variables(name, "input")}
                if system.connections else {},
                (), tuple(v.name for v in system.variables(name, "output")), {},
            ) for name in slaves
        }  # fmt: skip
        if system.connections:
            master = Master(slaves, wiring, system.groups)
            master.initialize(0.0, 1e9)

            def steps(k: int, n: int) -> Sequence[float]:
                for i in range(k, k + n):
                    master.begin(i * H, H, {})
                    master.finish(i * H, H, {})
                return master.values

        else:
            ((name, slave),) = slaves.items()
            inputs = [v.name for v in system.variables(name, "input")]
            slave.bind(inputs, (), wiring[name].outputs)
            slave.initialize({}, 0.0, 1e9)
            held = [0.1] * len(inputs)

            def steps(k: int, n: int) -> Sequence[float]:
                for i in range(k, k + n):
                    values = slave.step(held, i * H, H)
                return values

        yield steps


def fmpy_slave(fmu: Path, name: str, description: Any) -> FMU2Slave:
    """Return an FMU as FMPy's FMU2Slave, initialised at t = 0."""
    slave = FMU2Slave(
        guid=description.guid, unzipDirectory=extract(str(fmu)), instanceName=name,
        modelIdentifier=description.coSimulation.modelIdentifier,
    )  # fmt: skip
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    return slave


@contextmanager
def fmpy_loop(system: System) -> Generator[Steps]:
    """Open FMUs as FMPy's FMU2Slave and call setReal, doStep and getReal, names resolved before."""
    fmus, sets, gets = {}, {}, {}
    place = {name: i for i, name in enumerate(system.outputs())}
    values = [0.0] * len(place)
    for name, path in system.fmus.items():
        fmu = fmpy_slave(path, name, system.descriptions[name])
        inputs = system.variables(name, "input")
        sources = [system.connections.get(f"{name}.{v.name}") for v in inputs]
        outputs = [v.valueReference for v in system.variables(name, "output")]
        first = min(i for (owner, _), i in place.items() if owner == name)
        values[first : first + len(outputs)] = fmu.getReal(outputs)
        fmus[name], gets[name] = fmu, (outputs, slice(first, first + len(outputs)))
        sets[name] = [v.valueReference for v in inputs], [s and place[tuple(s.split("."))] for s in sources]

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            for group in system.groups:
                taken = [[0.1 if s is None else values[s] for s in sets[name][1]] for name in group]
                for name, inputs in zip(group, taken, strict=True):
                    fmu, (outputs, where) = fmus[name], gets[name]
                    if inputs:
                        fmu.setReal(sets[name][0], inputs)
                    fmu.doStep(currentCommunicationPoint=i * H, communicationStepSize=H)
                    values[where] = fmu.getReal(outputs)
        return values

    yield steps
    for fmu in fmus.values():
        fmu.terminate()
        fmu.freeInstance()


@contextmanager
def fmpy_simulate(system: System) -> Generator[Steps]:
    """Call simulate_fmu from t = 0 with an instance that has been loaded before."""
    if len(system.fmus) > 1:
        raise Absent("takes one FMU only")
    ((name, path),) = system.fmus.items()
    description, folder = system.descriptions[name], extract(str(path))
    inputs = [v.name for v in system.variables(name, "input")]
    outputs = [v.name for v in system.variables(name, "output")]
    signal = np.zeros(1, dtype=[("time", float), *((u, float) for u in inputs)])
    for u in inputs:
        signal[u] = 0.1

    def prepare() -> Any:
        return instantiate_fmu(folder, description, "CoSimulation")

    def steps(k: int, n: int, fmu: Any = None) -> Sequence[float]:
        result = simulate_fmu(
            folder, model_description=description, fmu_instance=fmu, stop_time=n * H, output_interval=H,
            input=signal, output=outputs, validate=False,
        )  # fmt: skip
        if len(result) != n + 1:
            raise RuntimeError(f"simulate_fmu made {len(result) - 1} steps for {n}")
        return [result[o][-1] for o in outputs]

    steps.prepare = prepare  # type: ignore[attr-defined]
    yield steps


@contextmanager
def libcosimpy(system: System) -> Generator[Steps]:
    """Open libcosim's fixed-step algorithm: one step a call, outputs by its last-value observer."""
    try:
        from libcosimpy.CosimExecution import CosimExecution
        from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
        from libcosimpy.CosimManipulator import CosimManipulator
        from libcosimpy.CosimObserver import CosimObserver
        from libcosimpy.CosimSlave import CosimLocalSlave
    except (ImportError, OSError) as error:
        raise Absent(f"{error}") from error
    log_output_level(CosimLogLevel.ERROR)
    execution = CosimExecution.from_step_size(round(H * 1e9))
    slaves = {name: CosimLocalSlave(str(path), name) for name, path in system.fmus.items()}
    index = {name: execution.add_local_slave(slave) for name, slave in slaves.items()}
    reference = {
        f"{name}.{v.name}": (index[name], v.valueReference)
        for name in system.fmus for v in system.descriptions[name].modelVariables
    }  # fmt: skip
    for target, source in system.connections.items():
        execution.connect_real_variables(*reference[source], *reference[target])
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    execution.add_observer(observer)
    execution.add_manipulator(manipulator)
    for name in system.fmus:
        for v in system.variables(name, "input"):
            if f"{name}.{v.name}" not in system.connections:
                manipulator.slave_real_values(index[name], [v.valueReference], [0.1])
    wanted = [(index[name], [v.valueReference for v in system.variables(name, "output")]) for name in system.fmus]

    def steps(k: int, n: int) -> Sequence[float]:
        for _ in range(n):
            if not execution.step():
                raise RuntimeError("libcosim: step failed")
            values = [observer.last_real_values(slave, references) for slave, references in wanted]
        return [x for part in values for x in part]

    yield steps


@contextmanager
def ecospy(system: System) -> Generator[Steps]:
    """Open ecos: one step a call, outputs by get_real."""
    try:
        from ecospy import EcosSimulation, EcosSimulationStructure
    except (ImportError, OSError) as error:
        raise Absent(f"{error}") from error
    with EcosSimulationStructure() as structure:
        for name, path in system.fmus.items():
            structure.add_model(name, str(path))
        for target, source in system.connections.items():
            structure.make_real_connection(source.replace(".", "::"), target.replace(".", "::"))
        with EcosSimulation(structure=structure, step_size=H) as simulation:
            simulation.init()
            for name in system.fmus:
                for v in system.variables(name, "input"):
                    if f"{name}.{v.name}" not in system.connections:
                        simulation.set_real(f"{name}::{v.name}", 0.1)
            wanted = [f"{name}::{output}" for name, output in system.outputs()]

            def steps(k: int, n: int) -> Sequence[float]:
                for _ in range(n):
                    simulation.step()
                    values = [simulation.get_real(name) for name in wanted]
                return values

            yield steps
            simulation.terminate()


MASTERS: Mapping[str, Callable[[System], Any]] = {
    "ours, in process": partial(ours, isolation="none"),
    "ours, isolated": partial(ours, isolation="process"),
    "FMPy, low level": fmpy_loop,
    "FMPy, simulate_fmu": fmpy_simulate,
    "libcosimpy": libcosimpy,
    "ecospy": ecospy,
}
YARDSTICK = "FMPy, low level"


def measure(system: System, n_steps: int, n_blocks: int) -> list[Row]:
    """Return a row for each master. Raises RuntimeError if ours and FMPy's loop, which make the same calls, differ."""
    rows: dict[str, Row] = {}
    times: dict[str, list[float]] = {}
    last: dict[str, Sequence[float]] = {}
    with ExitStack() as stack:
        steppers: dict[str, Steps] = {}
        for name, make in MASTERS.items():
            rows[name] = {"system": system.name, "master": name}
            try:
                steppers[name] = stack.enter_context(make(system))
            except Absent as reason:
                rows[name]["skipped"] = str(reason)
        for block in range(-1, n_blocks):  # the first one warms up
            for name, steps in steppers.items():
                prepared = {"fmu": steps.prepare()} if hasattr(steps, "prepare") else {}
                begun = perf_counter()
                last[name] = list(steps((block + 1) * n_steps, n_steps, **prepared))
                if block >= 0:
                    times.setdefault(name, []).append((perf_counter() - begun) / n_steps * 1e6)
                if prepared:
                    prepared["fmu"].freeInstance()
    for name in ("ours, in process", "ours, isolated"):
        if last[name] != last[YARDSTICK]:
            raise RuntimeError(f"{system.name}: {name} gave {last[name]}, FMPy's loop {last[YARDSTICK]}")
    yardstick = float(np.median(times[YARDSTICK]))
    for name, values in times.items():
        rows[name]["us a macro step"] = spread(values)
        rows[name]["us an FMU"] = float(np.median(values)) / len(system.fmus)
        rows[name]["times FMPy's loop"] = float(np.median(values)) / yardstick
    return list(rows.values())


def main(arguments: Sequence[str] | None = None) -> None:
    """Build and measure the systems; print and keep the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--systems", nargs="+", help="those whose names contain one of these (default: all)")
    parser.add_argument("--steps", type=int, default=1000, help="of a block")
    parser.add_argument("--blocks", type=int, default=15)
    options = parser.parse_args(arguments)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        for system in systems(Path(folder)):
            if not options.systems or any(part in system.name for part in options.systems):
                rows += measure(system, options.steps, options.blocks)
    notes = (
        f"{options.blocks} blocks of {options.steps} steps; median [quartiles]; ours gave FMPy's values bit for bit."
    )
    write("master", rows, notes)


if __name__ == "__main__":
    main()
