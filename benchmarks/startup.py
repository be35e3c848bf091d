"""Time from the start of `retune` to its help text, and to the end of its first macro step.

    python -m benchmarks.startup [--repeats 5] [--imports]

The run ends with its first macro step and closes its series right after; the time stamp of that file is what counts, so
nothing is measured inside. Every command is a process of its own. After the first one the files are in the cache of the
operating system, so the first time is shown apart. `--imports` lists the slowest imports of the command and of an FMU's
process (python -X importtime).
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.report import spread, write

HELP_REACH, STEP_REACH = 0.3, 1.0
"""Times that should be reached [s]."""
_RETUNE = (sys.executable, "-c", "import sys; from cosim.cli import main; sys.exit(main())")
_RUN = ("run", "quadrotor", "--only", "--set", "scenario.stop_time=0.01", "--set", "estimation.instants=[]")


def main() -> None:
    """Measure each command; print and keep the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--imports", action="store_true", help="list the slowest imports instead")
    options = parser.parse_args()
    if options.imports:
        print(f"retune run\n{slowest_imports([*_RETUNE[1:], *_RUN])}\n")
        print(f"an FMU's process\n{slowest_imports(['-c', 'import cosim.slaves.child'])}")
        return
    rows: list[dict[str, object]] = []
    cases: tuple[tuple[str, float, Callable[[], float]], ...] = (
        ("retune --help", HELP_REACH, help_shown),
        ("retune run quadrotor, first macro step", STEP_REACH, lambda: first_step("target")),
        ("the same, --estimator none", STEP_REACH, lambda: first_step("none")),
        ("retune run quadrotor of one macro step, to its end", STEP_REACH, lambda: first_step("target", to_end=True)),
    )
    for name, reach, measure in cases:
        seconds = [measure() for _ in range(options.repeats + 1)]
        rows.append({"from process start to": name, "s": spread(seconds[1:]), "first": seconds[0], "reach": reach})
    write("startup", rows)


def help_shown() -> float:
    """Return the wall time of `retune --help` [s]."""
    begun = time.perf_counter()
    subprocess.run([*_RETUNE, "--help"], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - begun


def first_step(estimator: str, to_end: bool = False) -> float:
    """Return the wall time from the start of `retune run` to the end of its first macro step, or of the run [s]."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        begun = time.time_ns()
        command = [*_RETUNE, *_RUN, "--estimator", estimator, "--out", str(out)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        ended = time.time_ns() if to_end else (out / "series.arrow").stat().st_mtime_ns
        return 1e-9 * (ended - begun)


def slowest_imports(arguments: Sequence[str], n: int = 25) -> str:
    """Return the imports of a Python program with the longest cumulative times, a line for each: [ms], module."""
    with tempfile.TemporaryDirectory() as folder:
        program = [sys.executable, "-X", "importtime", *arguments]
        path = os.pathsep.join(str(Path(p).resolve()) for p in sys.path if p)
        environment = os.environ | {"PYTHONPATH": path}
        done = subprocess.run(program, cwd=folder, env=environment, check=True, capture_output=True, text=True)
    found = re.findall(r"^import time: +\d+ \| +(\d+) \| +(\S+)$", done.stderr, flags=re.MULTILINE)
    largest = sorted(((int(us) / 1e3, module) for us, module in found), reverse=True)[:n]
    return "\n".join(f"{ms:8.1f}  {module}" for ms, module in largest)


if __name__ == "__main__":
    main()
