"""Wall time of the guarded `target` run by that of `--estimator none`, in turns, and both in multiples of real time.

    python -m benchmarks.real_time [--repeats 5]

Every FMU has a process of its own, the guard is on, and everything is recorded in a folder. The ratio is that of two
runs one after the other on one machine: what else the machine does is in both. Whole runs count, the start of the FMUs
included, but not the imports: `benchmarks.startup` has those. `--parts` keeps the share of each part in guarded runs.
"""

import argparse
import shutil
import signal
import tempfile
from collections import Counter
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter
from types import FrameType
from typing import Final

from benchmarks.native_fmus import FOREIGN, build_foreign
from benchmarks.report import Row, spread, write
from cosim import Scenario, run

Stack = list[tuple[str, str]]
REACH: Mapping[str, tuple[float, float | None]] = {
    "quadrotor": (6.0, 3.0),
    "pendulum": (12.0, None),
    "pendulum, roll-outs at a window of 50": (1.0, None),
    "axis, compiled FMUs, roll-outs at a window of 50": (5.0, None),
}
"""Multiple of real time that each should reach with `target`, and the most of the time of `none` that it may take."""
PARTS: Final = (
    ("loop simulated ahead", "retuning/lookahead.py", ""),
    ("guard", "retuning/guard.py", ""),
    ("screen", "sampling/screen.py", ""),
    ("proposals judged", "retuning/diagnosing.py", "_judged"),
    ("suspicions settled", "diagnosis/sample_diagnosis.py", "settle"),
    ("samples observed", "diagnosis/sample_diagnosis.py", "observe"),
    ("episodes diagnosed", "diagnosis/episode_diagnosis.py", ""),
    ("filter between searches", "estimator/parameter_filter.py", ""),
    ("search", "estimator/retuning/retuner.py", ""),
    ("rest of re-tuning", "retuning/supervisor.py", ""),
    ("exchange with the FMUs", "cosim/system/master.py", ""),
    ("recording and checkpoints", "cosim/runs/record.py", ""),
    ("recording and checkpoints", "cosim/runs/checkpoint.py", ""),
    ("other work at a step", "cosim/runs/loop.py", "_step"),
    ("start and end of a run", "", ""),
)
"""Parts of a run: name, end of the file and function that its stacks have, any where empty; the first that fits."""
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
            rows = [row for case, s in scenarios.items() for row in parts(case, s, options.repeats)]
            write("real_time_parts", rows, "Shares of the wall time of guarded runs, by the stack at each millisecond.")
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


def parts(case: str, scenario: Scenario, repeats: int) -> list[Row]:
    """Return the share of each part in the wall time of guarded runs of a case, by the stack at each millisecond."""
    wall(scenario, "target", 0)
    with sampled_stacks() as stacks:
        for k in range(repeats):
            wall(scenario, "target", k)
    counts = Counter(_part_of(stack) for stack in stacks)
    return [{"run": case, "part": part, "share": n / len(stacks)} for part, n in counts.most_common()]


@contextmanager
def sampled_stacks(every: float = 1e-3) -> Generator[list[Stack]]:
    """Yield a list that gets the main thread's stack, file and function of each frame, `every` so many seconds [s].

    By a signal, which calls that are blocked are interrupted by: a thread would be let in where this one waits.
    """
    found = list[Stack]()

    def sample(_: int, frame: FrameType | None) -> None:
        stack: Stack = []
        while frame is not None:
            stack.append((frame.f_code.co_filename, frame.f_code.co_name))
            frame = frame.f_back
        found.append(stack)

    before = signal.signal(signal.SIGALRM, sample)
    signal.setitimer(signal.ITIMER_REAL, every, every)
    try:
        yield found
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _part_of(stack: Stack) -> str:
    """Return the part of a run that a stack is in: the first of `PARTS` that has a frame there."""
    return next(
        part
        for part, file, function in PARTS
        if any(name.endswith(file) and function in ("", of) for name, of in stack)
    )


if __name__ == "__main__":
    main()
