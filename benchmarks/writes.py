"""Writes in the loop that leave a parameter farther from the truth than it was.

    python -m benchmarks.writes [--scenarios quadrotor ...] [--estimators target ...] [--seeds N] [--jobs J]

A write is a change of the parameters in the controller from one communication point to the next; the error before it
is that of the former values for the plant of then. Those at the first three samples after a jump of the plant's
parameters are left out, as the samples say little of them yet. Noise alone makes many a small error larger by a fifth:
of an estimate that is unbiased, the error is now and then near zero by chance. So the table has how much larger it is,
too, in shares of the true value. results/writes.json has a row for each scenario and estimator.
"""

import argparse
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import report
from cosim.blas_threads import one_thread
from cosim.runs.result import Run
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

_WORSE = 1.2
"""Factor by which an error must grow to be counted."""
_AFTER_JUMP = 3
"""Number of samples after a jump whose writes are left out."""
_JUMP = 0.02
"""Change of a parameter from one communication point to the next, as a share of its value, that is a jump."""


def main() -> None:
    """Measure, keep and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=["quadrotor"])
    parser.add_argument("--estimators", nargs="+", default=["target"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time; no number depends on it")
    options = parser.parse_args()
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for scenario, estimator in product(options.scenarios, options.estimators):
            tasks = [(scenario, estimator, seed) for seed in range(options.seeds)]
            rows.append({"scenario": scenario, "estimator": estimator} | summary([*pool.map(_measured, tasks)]))
    report.write("writes", report.updated("writes", rows, "scenario", "estimator"))


def _measured(task: tuple[str, str, int]) -> NDArray[np.float64]:
    scenario, estimator, seed = task
    with one_thread():
        return errors(run(Scenario.load(scenario, {"scenario.isolation": "none"}), estimator, seed))


def errors(result: Run) -> NDArray[np.float64]:
    """Return the errors (n, 2) before and after each move of a parameter by a write, as shares of its true value."""
    truth, held = (np.column_stack([*of.values()]) for of in (result.true_parameters, result.estimates))
    jumps = np.flatnonzero(np.any(np.abs(np.diff(truth, axis=0)) > _JUMP * np.abs(truth[1:]), axis=1)) + 1
    is_early = np.zeros(len(truth), bool)
    for k in (0, *jumps):
        is_early[k : k + _AFTER_JUMP + 1] = True
    moved = (held[1:] != held[:-1]) & ~is_early[1:, None]
    true = truth[1:][moved]
    return np.column_stack([np.abs(of[moved] - true) / np.abs(true) for of in (held[:-1], held[1:])])


def summary(runs: list[NDArray[np.float64]]) -> dict[str, Any]:
    """Return how many moves of these runs make an error larger, and by how much."""
    before, after = np.vstack(runs).T
    grown = (after - before)[after > _WORSE * before]
    return {
        "seeds": len(runs),
        "moves": len(before),
        "worse by a fifth": len(grown),
        "by 0.001 of the truth": int(np.sum(grown > 1e-3)),
        "by 0.01": int(np.sum(grown > 1e-2)),
        "by 0.2": int(np.sum(grown > 0.2)),
        "largest": float(max(grown, default=0.0)),
    }


if __name__ == "__main__":
    main()
