"""Speed of the whole quadrotor scenario with `target`, each FMU in its own process, and the time of each part.

    python -m benchmarks.run [--seeds 5] [--scenario quadrotor] [--estimator target]

Each seed is run twice, with and without a clock around the calls of each part; the difference is what the clock costs.
The clock is outside our code: it wraps the methods of the classes while it runs. The time of a part does not include
that of the parts it calls. The FMUs' own time is that of the same steps, repeated by each FMU alone in a process; in a
group of FMUs that step at the same time the slowest counts. What the master waits beyond that is the exchange.
"""

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.report import spread, write
from cosim.runs import simulation
from cosim.runs.loop import Loop
from cosim.runs.record import Recorder
from cosim.sampling.sampler import Sampler
from cosim.scenarios.scenario import Scenario
from cosim.slaves.slave import Slave, open_slave
from cosim.system.fmu_cache import fmu_paths
from cosim.system.master import Master
from estimator import DerivativeResidual, PaperBO, ResidualWindow, TargetVector, triggers

REACH = 6.0
"""Multiple of real time that a whole run should reach."""
PARTS: tuple[tuple[str, type[Any], tuple[str, ...]], ...] = (
    ("start of the FMUs", Loop, ("initialize",)),
    ("FMUs and exchange", Master, ("begin", "finish")),
    ("sampling", Sampler, ("take", "row")),
    ("trigger", triggers.InnovationTrigger, ("__call__",)),
    ("trigger", triggers.TrackingTrigger, ("__call__",)),
    ("model calls", DerivativeResidual, ("__call__",)),
    ("window", ResidualWindow, ("append", "residual", "residuals", "explain")),
    ("ask", TargetVector, ("ask",)),
    ("ask", PaperBO, ("ask",)),
    ("tell", TargetVector, ("tell", "rescore")),
    ("tell", PaperBO, ("tell",)),
    ("estimate", TargetVector, ("estimate",)),
    ("estimate", PaperBO, ("estimate",)),
    ("recording", Recorder, ("row", "event", "close")),
    ("loop", Loop, ("execute",)),
)
"""Parts of a run: name, class and methods."""
_STEPS = "FMUs and exchange"


class Clock:
    """Own time of each part [s], taken by wrapped methods."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.steps: dict[str, list[tuple[Any, ...]]] = defaultdict(list)
        """Arguments of each FMU's steps."""
        self._inner: list[float] = []

    @contextmanager
    def running(self) -> Generator[None]:
        """Wrap the methods of the parts until the block ends."""
        places = [(owner, name, part) for part, owner, names in PARTS for name in names]
        original = [(owner, name, owner.__dict__[name]) for owner, name, _ in places]
        begin_step = Slave.begin_step
        try:
            for owner, name, part in places:
                setattr(owner, name, self.timed(owner.__dict__[name], part))
            Slave.begin_step = self._noted(begin_step)
            yield
        finally:
            Slave.begin_step = begin_step
            for owner, name, function in original:
                setattr(owner, name, function)

    def timed(self, function: Any, part: str) -> Any:
        """Return the function, made to add its own time to that of a part."""
        seconds, inner = self.seconds, self._inner

        def timed(*arguments: Any, **named: Any) -> Any:
            begun = perf_counter()
            inner.append(0.0)
            try:
                return function(*arguments, **named)
            finally:
                total = perf_counter() - begun
                seconds[part] += total - inner.pop()
                if inner:
                    inner[-1] += total

        return timed

    def _noted(self, function: Any) -> Any:
        def noted(slave: Slave, inputs: Sequence[float], t: float, h: float, tunables: Any = None) -> None:
            self.steps[slave.name].append((tuple(inputs), t, h, None if tunables is None else tuple(tunables)))
            function(slave, inputs, t, h, tunables)

        return noted


def main() -> None:
    """Measure the runs; print and keep the time of each part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", default="quadrotor")
    parser.add_argument("--estimator", default="target")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    scenario = Scenario.load(options.scenario)
    runs = [measured(scenario, options.estimator, seed) for seed in range(options.seeds)]
    span = scenario.scenario.stop_time - scenario.scenario.start_time
    whole = spread(span / r["whole run"] for r in runs)["median"]
    write("run", rows(runs, span), f"{whole:.2f} times real time, starting the FMUs included; reach {REACH:g}.")


def rows(runs: Sequence[Mapping[str, float]], span: float) -> list[dict[str, object]]:
    """Return a row for each part: wall time [s] in a run of span [s], median and quartiles over the runs."""
    return [
        {"part": part, "s": spread(r[part] for r in runs), "times real time": spread(span / r[part] for r in runs)}
        for part in runs[0]
        if min(r[part] for r in runs) > 0.0
    ]


def measured(scenario: Scenario, estimator: str, seed: int) -> dict[str, float]:
    """Return the wall time [s] of each part of one run, and of the whole without a clock."""
    plain, folder_seconds = _run(scenario, estimator, seed)
    clock = Clock()
    with clock.running():
        clocked, _ = _run(scenario, estimator, seed)
    parts = dict(clock.seconds)
    own = _alone(scenario, clock.steps)
    exchange = parts.pop(_STEPS) - own
    stepping = sum(s for part, s in clock.seconds.items() if part != "start of the FMUs")
    start = plain.wall - stepping * plain.wall / clocked.wall
    return {
        "whole run": plain.wall,
        "from the first step on": plain.wall - start,
        "start of the FMUs": start,
        "FMUs": own,
        "exchange": exchange,
        **{part: s for part, s in parts.items() if part != "start of the FMUs"},
        "end of the folder": folder_seconds,
        "the clock itself": clocked.wall - plain.wall,
    }


def _run(scenario: Scenario, estimator: str, seed: int) -> tuple[Any, float]:
    """Return a recorded run, and the time taken to complete its folder after its last step [s]."""
    with tempfile.TemporaryDirectory() as folder:
        begun = perf_counter()
        result = simulation.run(scenario, estimator, seed, Path(folder))
        return result, perf_counter() - begun - result.wall


def _alone(scenario: Scenario, steps: Mapping[str, Sequence[tuple[Any, ...]]]) -> float:
    """Return the time [s] that the FMUs themselves need for all macro steps."""
    seconds: dict[str, Any] = {}
    for name, path in fmu_paths(scenario).items():
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            seconds[name] = np.array(pool.submit(_steps_of, scenario, name, path, list(steps[name])).result())
    controllers = {p.writes.partition(".")[0] for p in scenario.estimation.parameters}
    groups = [[n for n in seconds if n in controllers], [n for n in seconds if n not in controllers]]
    return sum(float(np.sum(np.max([seconds[n] for n in group], axis=0))) for group in groups if group)


def _steps_of(scenario: Scenario, name: str, path: Path, steps: Sequence[tuple[Any, ...]]) -> list[float]:
    """Return the wall time [s] of each of these steps of one FMU in this process."""
    settings = scenario.scenario
    begun = [r.partition(".") for r in scenario.connections if r.startswith(f"{name}.")]
    written = [*scenario.changes, *(p.writes for p in scenario.estimation.parameters)]
    seconds: list[float] = []
    with open_slave(path, name, isolation="none") as slave:
        outputs = [v.name for v in slave.description.modelVariables if v.causality == "output"]
        tunables = [r.partition(".")[2] for r in written if r.startswith(f"{name}.")]
        slave.bind([variable for _, _, variable in begun], tunables, outputs)
        slave.initialize(scenario.components[name].start, settings.start_time, settings.stop_time)
        for inputs, t, h, values in steps:
            before = perf_counter()
            slave.step(inputs, t, h, values)
            seconds.append(perf_counter() - before)
    return seconds


if __name__ == "__main__":
    main()
