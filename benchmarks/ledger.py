"""What a study costs beside its runs: the ledger's time a run, and time and memory of table, summary and pictures.

    python -m benchmarks.ledger [--commits 1000] [--rows 100000]

Commits go to a ledger in the current folder's file system. The rows are those of one real run with other errors, over
two factors and four seeds; they are entered where that is fast, and summarised in a process of its own.
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.report import write
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.studies.definition import checked_definition
from cosim.studies.folder import read_study, write_study
from cosim.studies.ledger import LEDGER, open_ledger
from cosim.studies.plan import Study
from cosim.studies.row import row_of
from cosim.terminal.study_output import tell_study

SETTINGS = {"scenario.stop_time": "0.1", "scenario.isolation": "none"}


def main() -> None:
    """Measure, print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--commits", type=int, default=1000)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--summarise", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.summarise:
        print("\n" + json.dumps(summarised_in(options.summarise)))
        return
    row = row_of(run(Scenario.load("pendulum", SETTINGS), "target"))
    with TemporaryDirectory(dir=".") as folder:
        commit_ms = 1e3 * filled(Path(folder), row, options.commits) / options.commits
    with TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as folder:
        filled(Path(folder), row, options.rows)
        command = [sys.executable, "-m", "benchmarks.ledger", "--summarise", folder]
        told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    commits = {"what": f"{options.commits} commits", "ms a run": commit_ms, "reach": "5 ms"}
    table = {"what": f"{options.rows} rows", **json.loads(told.splitlines()[-1]), "reach": "5 s, 500 MB"}
    write("ledger", [commits, table])


def filled(folder: Path, row: dict[str, object], n: int) -> float:
    """Make the folder of a study of n runs that are done; return the time of leases and commits [s]."""
    tables = {
        "study": {"name": "rows", "scenarios": ["pendulum"], "estimators": ["none", "target"], "seeds": 4},
        "factors": {
            "m": {"set": 'changes."plant.m"', "grid": [2.0, 5.0, 10]},
            "l": {"set": 'changes."plant.l"', "grid": [0.5, 1.5, max(1, n // 80)]},
        },
    }
    study = Study(checked_definition(tables, "rows"), (Scenario.load("pendulum"),), ("pendulum",))
    write_study(folder, study, "study")
    rng, keys = np.random.default_rng(0), [f"{k:064x}" for k in range(n)]
    points = [
        {"scenario": "pendulum", "point": k // 8, "seed": k // 2 % 4, "estimator": ("none", "target")[k % 2],
         "m": 2.0 + k // 8 % 10 / 3.0, "l": 0.5 + k // 80 / n * 80}
        for k in range(n)
    ]  # fmt: skip
    with open_ledger(folder / LEDGER) as ledger:
        ledger.plan(zip(keys, points, strict=True))
        errors = rng.lognormal(-6.0, 1.0, n).tolist()
        begun = perf_counter()
        for key, mse in zip(keys, errors, strict=True):
            ledger.finish(key, ledger.lease(key), row | {"mse": mse}, None, is_done=True)
        return perf_counter() - begun


def summarised_in(folder: Path) -> dict[str, float]:
    """Return time [s] and peak memory [MB] of table, summary and pictures of a study's folder, in this process."""
    study, _ = read_study(folder)
    begun = perf_counter()
    with open_ledger(folder / LEDGER) as ledger:
        tell_study(study, ledger, folder, is_json=False)
    seconds = perf_counter() - begun
    return {"s": seconds, "MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024}


if __name__ == "__main__":
    main()
