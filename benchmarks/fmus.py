"""Wall time of a step of Quadrotor.fmu: four inputs set, two Runge-Kutta steps of 5 ms, all 33 outputs got.

    python -m benchmarks.fmus [--steps 1000] [--blocks 15]

The FMU is stepped by FMPy's low-level calls in this process, and by a C program that loads it and embeds Python
(LD_PRELOAD of libpython); the same slave is also called without FMI. All three give the same numbers, bit for bit. The
C program runs its blocks in a process of its own between those of the others. Beside them: the time of the model alone.
"""

import argparse
import os
import subprocess
import sys
import sysconfig
import tempfile
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from fmpy import extract, platform, read_model_description

from benchmarks.master_peers import Steps, fmpy_slave
from benchmarks.native_fmus import SOURCES, compile_c
from benchmarks.report import Row, spread, write
from fmu_models import quadrotor
from fmu_models.build import build
from fmu_models.kernel.ode import rk4_step
from fmu_models.quadrotor.plant import Quadrotor

H = 0.01
"""Communication step [s]."""
U = (40.0, 0.02, -0.01, 0.005)
"""Inputs F [N] and M [N m], off hover so that every state moves."""
DIRECT, IMPORTER = "slave called directly", "FMI, C importer"
"""Names of the yardstick and of the way that may be missing."""


def directly() -> Steps:
    """Return steps of the slave as a Python object, called as PythonFMU calls it."""
    slave = Quadrotor(instance_name="quadrotor")
    inputs, outputs = _references(slave.variables)
    slave.setup_experiment(0.0)
    slave.exit_initialization_mode()

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            slave.set_real(inputs, list(U))
            slave.do_step(i * H, H)
            values = slave.get_real(outputs)
        return values

    return steps


def by_fmpy(fmu: Path) -> Steps:
    """Return steps by FMPy's setReal, doStep and getReal."""
    description = read_model_description(str(fmu))
    slave = fmpy_slave(fmu, "quadrotor", description)
    inputs, outputs = _references(description.modelVariables)

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            slave.setReal(inputs, U)
            slave.doStep(currentCommunicationPoint=i * H, communicationStepSize=H)
            values = slave.getReal(outputs)
        return values

    return steps


class Importer:
    """The compiled importer.c. Raises RuntimeError if it cannot be compiled, or without a shared libpython."""

    def __init__(self, fmu: Path, folder: Path) -> None:
        self._program = compile_c(SOURCES / "importer.c", folder / "importer", "-ldl")
        library = Path(sysconfig.get_config_var("LIBDIR") or "", sysconfig.get_config_var("INSTSONAME") or "none")
        if not library.exists() or ".so" not in library.name:
            raise RuntimeError("this Python has no shared libpython")
        self._environment = os.environ | {"LD_PRELOAD": str(library), "PYTHONHOME": sys.base_prefix}
        unpacked = Path(extract(str(fmu)))
        description = read_model_description(str(fmu))
        inputs, outputs = _references(description.modelVariables)
        self._fmu = (
            unpacked / "binaries" / platform / f"{description.coSimulation.modelIdentifier}.so",
            description.guid, (unpacked / "resources").as_uri(),
        )  # fmt: skip
        self._variables = [
            len(inputs), *(x for pair in zip(inputs, U, strict=True) for x in pair), len(outputs), *outputs,
        ]  # fmt: skip

    def run(self, n_steps: int, n_blocks: int) -> tuple[list[float], list[float]]:
        """Return the microseconds a step of each block, and the outputs after the last."""
        arguments = [self._program, *self._fmu, n_steps, n_blocks, *self._variables]
        result = subprocess.run(
            [*map(str, arguments)], env=self._environment, capture_output=True, text=True, timeout=600
        )
        if result.returncode:
            raise RuntimeError(f"the C importer failed: {result.stderr.strip().splitlines()[-1]}")
        times, values = result.stdout.splitlines()[-2:]
        return [*map(float, times.split())], [*map(float, values.split())]


def model_parts(n: int) -> dict[str, float]:
    """Return the microseconds of the model's own functions."""
    x, p = tuple(float(i in (6, 10, 14)) for i in range(18)), (1.25, 1.1, 1.1, 2.2, 9.81)

    def f(x: Any) -> Any:
        return quadrotor.derivative(x, U, *p)

    parts: dict[str, Callable[[], Any]] = {
        "derivative alone": lambda: f(x),
        "one Runge-Kutta step alone": lambda: rk4_step(f, x, H / 2),
    }
    times = {}
    for name, part in parts.items():
        begun = perf_counter()
        for _ in range(n):
            part()
        times[name] = (perf_counter() - begun) / n * 1e6
    return times


def _references(variables: Sequence[Any]) -> tuple[list[int], list[int]]:
    """Return the value references of U's inputs and the outputs, which are the places of the variables in the table."""
    inputs, outputs = ([i for i, v in enumerate(variables) if v.causality == c] for c in ("input", "output"))
    return inputs[: len(U)], outputs


def main(arguments: Sequence[str] | None = None) -> None:
    """Build the FMU and measure its steps; print and keep the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=1000, help="of a block")
    parser.add_argument("--blocks", type=int, default=15)
    options = parser.parse_args(arguments)
    skipped: list[Row] = []
    with tempfile.TemporaryDirectory() as directory:
        fmu = build("Quadrotor", directory)
        try:
            importer = Importer(fmu, Path(directory))
        except RuntimeError as reason:
            importer = None
            skipped.append({"way": IMPORTER, "skipped": str(reason)})
        times = measure(fmu, importer, options.steps, options.blocks)
    yardstick = spread(times[DIRECT])["median"]
    rows: list[Row] = [
        {"way": name, "us a step": spread(t), "times direct": spread(t)["median"] / yardstick}
        for name, t in times.items()
    ]
    notes = f"{options.blocks} blocks of {options.steps} steps of 10 ms; median [quartiles]; equal outputs bit for bit."
    write("fmus", rows + skipped, notes)


def measure(fmu: Path, importer: Importer | None, n: int, n_blocks: int) -> dict[str, list[float]]:
    """Return the microseconds a step of each block of n steps, the ways taking turns.

    Raises RuntimeError if the ways do not give the same numbers.
    """
    ways = {DIRECT: directly(), "FMI, FMPy low level": by_fmpy(fmu)}
    times: dict[str, list[float]] = defaultdict(list)
    values: dict[str, Sequence[float]] = {}
    for k in range(n_blocks):
        for name, steps in ways.items():
            begun = perf_counter()
            values[name] = steps(k * n, n)
            times[name].append((perf_counter() - begun) / n * 1e6)
        for name, time in model_parts(n).items():
            times[name].append(time)
        if importer is not None:
            its_times, _ = importer.run(n, 2)  # the first block warms up
            times[IMPORTER].append(its_times[1])
    if importer is not None:
        _, values[IMPORTER] = importer.run(n, n_blocks)
    for name, found in values.items():
        if list(found) != list(values[DIRECT]):
            raise RuntimeError(f"{name} does not give what the slave gives when it is called directly")
    return times


if __name__ == "__main__":
    main()
