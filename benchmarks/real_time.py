"""Wall time of the guarded `target` run by that of `--estimator none`, in turns, and both in multiples of real time.

    python -m benchmarks.real_time [--repeats 5]

Every FMU has a process of its own, the guard is on, and everything is recorded in a folder. The ratio is that of two
runs one after the other on one machine: what else the machine does is in both. Whole runs count, the start of the FMUs
included, but not the imports: `benchmarks.startup` has those. `--parts` says how long each part of the last guarded run
took, by cProfile, which makes everything slower.
"""

import argparse
import cProfile
import io
import pstats
import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter

from benchmarks.report import spread, write
from cosim import Scenario, run

REACH: Mapping[str, tuple[float, float | None]] = {
    "quadrotor": (6.0, 3.0),
    "pendulum": (12.0, None),
    "pendulum, roll-outs at a window of 50": (1.0, None),
}
"""Multiple of real time that each should reach with `target`, and the most of the time of `none` that it may take."""
_OUTPUTS = {"estimation.objective": "rollout", "sampling.outputs": '{"plant.phi" = {noise = 0.01}}'}
OVERRIDES: Mapping[str, Mapping[str, str]] = {
    "quadrotor": {},
    "pendulum": {},
    "pendulum, roll-outs at a window of 50": _OUTPUTS | {"estimation.window": "50"},
}


def main() -> None:
    """Measure each case; print and keep the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--parts", action="store_true", help="show a profile of each guarded run instead")
    options = parser.parse_args()
    if options.parts:
        for case in REACH:
            print(f"{case}\n{profile(scenario_of(case))}")
        return
    rows: list[dict[str, object]] = []
    for case, (reach, most) in REACH.items():
        scenario = scenario_of(case)
        span = scenario.scenario.stop_time - scenario.scenario.start_time
        for estimator in ("target", "none"):
            wall(scenario, estimator, 0)  # what is loaded once is loaded now
        times = [(wall(scenario, "target", k), wall(scenario, "none", k)) for k in range(options.repeats)]
        rows.append(
            {
                "run": case,
                "target, times real time": spread(span / target for target, _ in times),
                "reach": reach,
                "none, times real time": spread(span / none for _, none in times),
                "target by none": spread(target / none for target, none in times),
                "at most": most,
            }
        )
    write("real_time", rows)


def scenario_of(case: str) -> Scenario:
    """Return the scenario of a case."""
    return Scenario.load(case.partition(",")[0], OVERRIDES[case])


def wall(scenario: Scenario, estimator: str, seed: int) -> float:
    """Return the wall time of a whole run with its folder [s]."""
    with tempfile.TemporaryDirectory() as folder:
        begun = perf_counter()
        run(scenario, estimator, seed, Path(folder) / "run")
        return perf_counter() - begun


def profile(scenario: Scenario, n: int = 40) -> str:
    """Return the functions with the longest own times in a guarded run."""
    wall(scenario, "target", 0)
    profiler = cProfile.Profile()
    profiler.runcall(wall, scenario, "target", 0)
    text = io.StringIO()
    pstats.Stats(profiler, stream=text).sort_stats("tottime").print_stats(n)
    return text.getvalue()


if __name__ == "__main__":
    main()
