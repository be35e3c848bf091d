"""Error of the estimates in the loop, over the Cramér-Rao bound of all samples since the last change.

    python -m benchmarks.limit [--scenarios pendulum ...] [--estimators target ...] [--seeds N] [--jobs J]

At the scenario's instants, whole runs, FMUs and all. The bound is that of the samples that the run itself made since
the plant's parameters changed last: no unbiased estimator that knows when they changed, and nothing of before, has a
smaller variance (Kay (1993), "Fundamentals of Statistical Signal Processing", section 3.8). Instants at which a
parameter drifts have no such bound and are left out. An error is in the parameters' scaled bounds; a row pools the
seeds, and all parameters whose bound is below a tenth of the bounds. Every run is kept in raw/limit.json, from where an
interrupted measurement goes on; results/limit.json has a row for each scenario, instant and estimator.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import product
from math import sqrt
from typing import Any

import numpy as np

from benchmarks import report
from benchmarks.report import Row
from cosim.blas_threads import one_thread
from cosim.runs.result import Run
from cosim.runs.simulation import run
from cosim.sampling.sampler import recorded_samples
from cosim.scenarios.scenario import Scenario
from cosim.user_code import load
from estimator import DerivativeResidual, Sample, Vector
from estimator.differences import central_differences

SCENARIOS = ("pendulum", "quadrotor", "rigid-body", "stiction", "magnetic-levitation")
ESTIMATORS = ("target", "least-squares", "ukf")
SEEDS = 200
_DRIFT = 5
"""Number of macro steps for which the parameters must have been constant."""
_UNSEEN = 0.1
"""Bound, as a share of the scaled bounds, above which the samples say too little of a parameter."""


def main() -> None:
    """Measure what is missing, keep and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--jobs", type=int, default=2, help="runs at a time; no number depends on it")
    options = parser.parse_args()
    asked = [*product(options.scenarios, options.estimators, range(options.seeds))]
    rows = report.stored(report.RAW, "limit")
    known = {(row["scenario"], row["estimator"], row["seed"]) for row in rows}
    missing = [task for task in asked if task not in known]
    with ProcessPoolExecutor(options.jobs) as pool:
        for i, found in enumerate(pool.map(_measured, missing)):
            rows.extend(found)
            if i % 10 == 9 or i + 1 == len(missing):
                report.keep(report.RAW, "limit", rows)
    rows = [row for row in rows if (row["scenario"], row["estimator"], row["seed"]) in set(asked)]
    report.write("limit", report.updated("limit", summary(rows), "scenario", "instant", "estimator"))


def summary(rows: list[Row]) -> Iterator[Row]:
    """Yield a row for each scenario, instant and estimator, and one for all instants of a scenario."""
    instants = sorted({(row["scenario"], row["t"]) for row in rows if row["t"] is not None})
    names = sorted({row["estimator"] for row in rows})
    for (scenario, t), name in product(instants, names):
        yield from _pooled(rows, scenario, name, t)
    for scenario, name in product(sorted({scenario for scenario, _ in instants}), names):
        yield from _pooled(rows, scenario, name, None)


def _pooled(rows: list[Row], scenario: str, name: str, t: float | None) -> Iterator[Row]:
    """Yield the root mean square of errors over bounds, of one instant or, None, of all."""
    mine = [
        row for row in rows
        if (row["scenario"], row["estimator"]) == (scenario, name) and row["t"] is not None and t in (None, row["t"])
    ]  # fmt: skip
    ratios = np.array([ratio for row in mine for ratio in row["ratios"]])
    if len(ratios):
        yield {
            "scenario": scenario,
            "instant": "all" if t is None else f"{t:g} s",
            "estimator": name,
            "seeds": len({row["seed"] for row in mine}),
            "rms error / bound": sqrt(float(np.mean(ratios**2))),
            "median": float(np.median(np.abs(ratios))) / 0.6745,
            "worst": float(np.abs(ratios).max()),
        }


def _measured(task: tuple[str, str, int]) -> list[Row]:
    """Return the errors of a run over their bounds, a row an instant; one without instant where there is none."""
    scenario, estimator, seed = task
    with one_thread():
        result = run(Scenario.load(scenario, {"scenario.isolation": "none"}), estimator, seed)
        found = [{"t": t, "ratios": ratios.tolist()} for t, ratios in error_ratios(result)]
    labels: dict[str, Any] = {"scenario": scenario, "estimator": estimator, "seed": seed}
    return [labels | row for row in found or [{"t": None, "ratios": []}]]


def error_ratios(result: Run) -> Iterator[tuple[float, Vector]]:
    """Yield each instant with the errors of the parameters that are seen, over their bounds."""
    space, time = result.scenario.estimation.space, result.time
    truth = np.column_stack(list(result.true_parameters.values()))
    estimates = np.column_stack(list(result.estimates.values()))
    for t in result.scenario.estimation.instants:
        k = int(np.searchsorted(time, t - 1e-9))
        if k >= len(time):
            continue
        differs = np.flatnonzero(np.any(truth[: k + 1] != truth[k], axis=1))
        changed = int(differs[-1]) + 1 if len(differs) else 0
        if k - changed < _DRIFT:
            continue
        bound = cramer_rao(result, range(changed + 1, k + 1), truth[k])
        seen = bound < _UNSEEN
        if seen.any():
            yield t, ((space.to_unit(estimates[k]) - space.to_unit(truth[k])) / bound)[seen]


def cramer_rao(result: Run, rows: range, truth: Vector) -> Vector:
    """Return the least standard deviation (d,), in the unit cube, of an unbiased estimate from these samples."""
    scenario = result.scenario
    space, sigma = scenario.estimation.space, [n.noise for n in scenario.sampling.derivatives.values()]
    assert scenario.estimation.model is not None
    model = load(scenario.estimation.model, scenario.folder)
    residual = DerivativeResidual(model, space, result.plant.channels, tuple(sigma))
    z, information = space.to_unit(truth), np.zeros((len(space), len(space)))
    for sample in recorded_samples(scenario, result.plant, result.series, rows):
        if sample is not None:
            J = central_differences(partial(_at, residual, sample), z, np.full(len(z), 1e-5))
            information += J.T @ J
    values, directions = np.linalg.eigh(information)
    return np.sqrt(np.sum(directions**2 / np.maximum(values, 1e-12), axis=1))


def _at(residual: DerivativeResidual, sample: Sample, z: Vector) -> Vector:
    """Return the residual (c,) at z (d,), in standard deviations of the noise."""
    return residual(residual.space.beyond(z), sample)


if __name__ == "__main__":
    main()
