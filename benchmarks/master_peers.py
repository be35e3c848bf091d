"""Other people's masters on the FMUs of a system: FMPy's two ways, libcosim and ecos.

Each context manager opens the FMUs and yields a function that makes macro steps, or raises Absent. libcosim and ecos
are imported there, so that one which is missing does not affect the others.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, instantiate_fmu, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave

H = 0.01
"""Macro step [s]."""
HELD = 0.1
"""Value of the inputs that no output feeds."""
Steps = Callable[[int, int], Sequence[float]]
"""Function that makes the macro steps k .. k + n - 1 and returns all outputs after them."""


class Absent(Exception):
    """Raised for a master that cannot take part; the message says why."""


@dataclass(frozen=True)
class System:
    """FMUs and their connections."""

    name: str
    fmus: Mapping[str, Path]
    """Files by instance name."""
    connections: Mapping[str, str]
    """Outputs by the inputs that they feed; any other input is held at HELD."""
    groups: Sequence[Sequence[str]]
    """Groups of FMUs that step at the same time; the groups step one after another."""

    @cached_property
    def descriptions(self) -> dict[str, Any]:
        """FMPy's model description of each FMU."""
        return {name: read_model_description(str(path)) for name, path in self.fmus.items()}

    def variables(self, name: str, causality: str) -> list[Any]:
        """Return the variables of this causality of one FMU."""
        return [v for v in self.descriptions[name].modelVariables if v.causality == causality]

    def free_inputs(self) -> list[tuple[str, Any]]:
        """Return (instance, variable) of the inputs that no output feeds."""
        inputs = [(name, v) for name in self.fmus for v in self.variables(name, "input")]
        return [(name, v) for name, v in inputs if f"{name}.{v.name}" not in self.connections]

    def outputs(self) -> list[tuple[str, str]]:
        """Return the (instance, variable) of all outputs, in the order in which Steps returns them."""
        return [(name, v.name) for name in self.fmus for v in self.variables(name, "output")]


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
    place = {f"{name}.{output}": i for i, (name, output) in enumerate(system.outputs())}
    values = [0.0] * len(place)
    for name, path in system.fmus.items():
        fmu = fmpy_slave(path, name, system.descriptions[name])
        inputs = system.variables(name, "input")
        sources = [system.connections.get(f"{name}.{v.name}") for v in inputs]
        outputs = [v.valueReference for v in system.variables(name, "output")]
        first = min(i for source, i in place.items() if source.startswith(f"{name}."))
        values[first : first + len(outputs)] = fmu.getReal(outputs)
        fmus[name], gets[name] = fmu, (outputs, slice(first, first + len(outputs)))
        sets[name] = [v.valueReference for v in inputs], [s and place[s] for s in sources]

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            for group in system.groups:
                taken = [[HELD if s is None else values[s] for s in sets[name][1]] for name in group]
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
        signal[u] = HELD

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
    for name, v in system.free_inputs():
        manipulator.slave_real_values(index[name], [v.valueReference], [HELD])
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
            for name, v in system.free_inputs():
                simulation.set_real(f"{name}::{v.name}", HELD)
            wanted = [f"{name}::{output}" for name, output in system.outputs()]

            def steps(k: int, n: int) -> Sequence[float]:
                for _ in range(n):
                    simulation.step()
                    values = [simulation.get_real(name) for name in wanted]
                return values

            yield steps
            simulation.terminate()
