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
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import perf_counter

from benchmarks.native_fmus import FOREIGN, build_foreign
from benchmarks.report import Row, spread, write
from cosim import Scenario, run

REACH: Mapping[str, tuple[float, float | None]] = {
    "quadrotor": (6.0, 3.0),
    "pendulum": (12.0, None),
    "pendulum, roll-outs at a window of 50": (1.0, None),
    "axis, compiled FMUs, roll-outs at a window of 50": (5.0, None),
}
"""Multiple of real time that each should reach with `target`, and the most of the time of `none` that it may take."""
_OUTPUTS = {"estimation.objective": "rollout", "sampling.outputs": '{"plant.phi" = {noise = 0.01}}'}
OVERRIDES: Mapping[str, Mapping[str, str]] = {
    "quadrotor": {},
    "pendulum": {},
    "pendulum, roll-outs at a window of 50": _OUTPUTS | {"estimation.window": "50"},
    "axis, compiled FMUs, roll-outs at a window of 50": {
        "scenario.stop_time": "10", "estimation.objective": "rollout", "estimation.window": "50",
        "sampling.outputs": '{"plant.mass.s" = {noise = 1e-4}}',
    },
}  # fmt: skip


def main() -> None:
    """Measure each case; print and keep the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--parts", action="store_true", help="show a profile of each guarded run instead")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scenarios = {case: scenario_of(case, Path(folder)) for case in REACH}
        if options.parts:
            for case, scenario in scenarios.items():
                print(f"{case}\n{profile(scenario)}")
        else:
            write("real_time", [_row(case, scenario, options.repeats) for case, scenario in scenarios.items()])


def _row(case: str, scenario: Scenario, repeats: int) -> Row:
    """Return the times of a case, of runs in turns."""
    reach, most = REACH[case]
    span = scenario.scenario.stop_time - scenario.scenario.start_time
    for estimator in ("target", "none"):
        wall(scenario, estimator, 0)  # what is loaded once is loaded now
    times = [(wall(scenario, "target", k), wall(scenario, "none", k)) for k in range(repeats)]
    return {
        "run": case,
        "target, times real time": spread(span / target for target, _ in times),
        "reach": reach,
        "none, times real time": spread(span / none for _, none in times),
        "target by none": spread(target / none for target, none in times),
        "at most": most,
    }


def scenario_of(case: str, folder: Path) -> Scenario:
    """Return the scenario of a case; folder: for the FMUs that are compiled."""
    name = case.partition(",")[0]
    if name == "axis":
        build_foreign(folder)
        shutil.copytree(FOREIGN, folder, dirs_exist_ok=True)
        name = str(folder / "axis.toml")
    return Scenario.load(name, OVERRIDES[case])


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
