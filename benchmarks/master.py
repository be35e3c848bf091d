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
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.master_peers import HELD, Absent, H, Steps, System, ecospy, fmpy_loop, fmpy_simulate, libcosimpy
from benchmarks.native_fmus import build_native, build_python
from benchmarks.report import Row, spread, write
from cosim.slaves.slave import Slave, open_slave
from cosim.system.master import Master, Wiring
from fmu_models.build import build


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
        yield _of_master(system, slaves) if system.connections else _of_slave(system, *slaves.values())


def _of_master(system: System, slaves: Mapping[str, Slave]) -> Steps:
    master = Master(slaves, {name: _wiring(system, name) for name in slaves}, system.groups)
    master.initialize(0.0, 1e9)

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            master.begin(i * H, H, {})
            master.finish(i * H, H, {})
        return master.values

    return steps


def _wiring(system: System, name: str) -> Wiring:
    """Return the wiring of one FMU, whose inputs that no output feeds are set at each step, too."""
    inputs, outputs = (tuple(v.name for v in system.variables(name, c)) for c in ("input", "output"))
    fed = {own: system.connections[f"{name}.{own}"] for own in inputs if f"{name}.{own}" in system.connections}
    held = tuple(own for own in inputs if own not in fed)
    return Wiring(fed, (), outputs, dict.fromkeys(held, HELD), disturbances=held)


def _of_slave(system: System, slave: Slave) -> Steps:
    inputs, outputs = ([v.name for v in system.variables(slave.name, c)] for c in ("input", "output"))
    slave.bind(inputs, (), outputs)
    slave.initialize({}, 0.0, 1e9)
    held = [HELD] * len(inputs)

    def steps(k: int, n: int) -> Sequence[float]:
        for i in range(k, k + n):
            values = slave.step(held, i * H, H)
        return values

    return steps


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
    with ExitStack() as stack:
        steppers: dict[str, Steps] = {}
        for name, make in MASTERS.items():
            rows[name] = {"system": system.name, "master": name}
            try:
                steppers[name] = stack.enter_context(make(system))
            except Absent as reason:
                rows[name]["skipped"] = str(reason)
        times, last = _in_turns(steppers, n_steps, n_blocks)
    for name in ("ours, in process", "ours, isolated"):
        if last[name] != last[YARDSTICK]:
            raise RuntimeError(f"{system.name}: {name} gave {last[name]}, FMPy's loop {last[YARDSTICK]}")
    yardstick = float(np.median(times[YARDSTICK]))
    for name, values in times.items():
        rows[name]["us a macro step"] = spread(values)
        rows[name]["us an FMU"] = float(np.median(values)) / len(system.fmus)
        rows[name]["times FMPy's loop"] = float(np.median(values)) / yardstick
    return list(rows.values())


def _in_turns(
    steppers: Mapping[str, Any], n_steps: int, n_blocks: int
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Return the microseconds a step of each master's blocks, and its outputs after the last."""
    times: dict[str, list[float]] = {name: [] for name in steppers}
    last: dict[str, list[float]] = {}
    for block in range(n_blocks + 1):
        for name, steps in steppers.items():
            prepared = {"fmu": steps.prepare()} if hasattr(steps, "prepare") else {}
            begun = perf_counter()
            last[name] = list(steps(block * n_steps, n_steps, **prepared))
            if block > 0:  # the first one warms up
                times[name].append((perf_counter() - begun) / n_steps * 1e6)
            if prepared:
                prepared["fmu"].freeInstance()
    return times, last


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
