"""Coverage of the truth by 95 % intervals: Monte Carlo on the named scenarios.

    python -m benchmarks.coverage [--scenarios pendulum ...] [--how frozen runs] [--estimators target ...] [--seeds N]

`frozen`: one episode on a frozen window of the nominal controller's run, with fresh noise for each seed. `runs`: whole
runs, FMUs and all; the estimate is compared with the truth at the end of each episode, and at the scenario's instants
(whatever has happened since the episode). The truth is what the plant had when it came to the newest sample. The
interval is estimate ± 1.96 std in the parameter's scale: where that is `log`, theta exp(± 1.96 std / theta). Parameters
that the estimate calls not identifiable are only counted. Counts are kept in raw/coverage.json: an interrupted
measurement goes on from there, as does one that is given more seeds; `--fresh` drops those asked for.
results/coverage.json has a row for each scenario, way of measuring and estimator.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import report
from benchmarks.frozen import estimated, noisy_samples, truth_at
from benchmarks.report import Row
from cosim.blas_threads import one_thread
from cosim.runs.result import Run
from cosim.runs.run_files import EVENTS
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from estimator import ParameterSpace, Vector
from estimator.baselines import LeastSquaresSettings

FROZEN = {"pendulum": (3.35, 30, 1), "quadrotor": (5.0, 10, 5), "stiction": (4.0, 100, 1), "rigid-body": (2.6, 10, 5)}
"""Time of the newest sample [s], number of samples and macro steps between them, for each scenario."""
SEEDS = {"frozen": 200, "runs": 40}
ESTIMATORS = {"frozen": ("target", "least-squares"), "runs": ("target", "least-squares", "ukf", "rls")}
QUANTILE = 1.96
COUNTS = ("seeds", "identifiable", "not", "covered", "sum of squares", "free", "free covered")
"""Counts for one parameter: seeds; intervals where it was identifiable, or not; those that covered the truth; the sum
of the squared errors in standard deviations; intervals of estimates that hold no direction at its old value, and how
many of them covered the truth."""
BATCH = 10
"""Seeds between two writings of the file."""


class Interval(NamedTuple):
    """An estimate at one time, and the true values at that time."""

    when: str
    theta: Vector
    std: Vector
    is_identifiable: Sequence[bool]
    reason: str
    truth: Vector


def main() -> None:
    """Measure what is missing, keep and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=list(FROZEN))
    parser.add_argument("--how", nargs="+", choices=list(ESTIMATORS), default=list(ESTIMATORS))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS["runs"]))
    parser.add_argument("--seeds", type=int, help="(default: 200 frozen windows, 40 runs)")
    parser.add_argument("--fresh", action="store_true", help="measure again what there is")
    options = parser.parse_args()
    asked = [
        key
        for key in product(options.scenarios, options.how, options.estimators)
        if key[2] in ESTIMATORS[key[1]] and _is_possible(key[0], key[2])
    ]
    rows = [row for row in report.stored(report.RAW, "coverage") if not (options.fresh and _key(row) in asked)]
    with one_thread():
        for key in asked:
            rows = measure(rows, key, options.seeds or SEEDS[key[1]])
    report.write("coverage", report.updated("coverage", summary(rows), "scenario", "how", "estimator"))


def measure(rows: list[Row], key: tuple[str, str, str], n_seeds: int) -> list[Row]:
    """Return the rows with the missing seeds added, keeping them on the way."""
    scenario, how, estimator = key
    mine = [row for row in rows if _key(row) == key]
    others = [row for row in rows if _key(row) != key]
    tally = {(row["when"], row["parameter"]): row for row in mine}
    intervals = partial(frozen if how == "frozen" else whole, scenario, estimator)
    space = Scenario.load(scenario).estimation.space
    for seed in range(mine[0]["seeds"] if mine else 0, n_seeds):
        for interval in intervals(seed):
            count(tally, space, dict(zip(("scenario", "how", "estimator"), key, strict=True)), interval)
        for row in tally.values():
            row["seeds"] = seed + 1
        if (seed + 1) % BATCH == 0 or seed + 1 == n_seeds:
            report.keep(report.RAW, "coverage", [*others, *tally.values()])
    return [*others, *tally.values()]


def count(
    tally: dict[tuple[str, str], Row], space: ParameterSpace, labels: Mapping[str, str], interval: Interval
) -> None:
    """Add one estimate's intervals to the tally, which has a row for each time and parameter."""
    z = deviations(space, interval)
    for name, z_i, is_identifiable in zip(space.names, z, interval.is_identifiable, strict=True):
        new = {**labels, "when": interval.when, "parameter": name} | dict.fromkeys(COUNTS, 0)
        row = tally.setdefault((interval.when, name), new)
        if not is_identifiable:
            row["not"] += 1
            continue
        is_covered = bool(abs(z_i) <= QUANTILE)
        row["identifiable"] += 1
        row["covered"] += is_covered
        row["sum of squares"] += min(float(z_i * z_i), 1e6)
        if "held" not in interval.reason:
            row["free"] += 1
            row["free covered"] += is_covered


def deviations(space: ParameterSpace, interval: Interval) -> Vector:
    """Return estimate minus truth (d,), in the standard deviations claimed, in each parameter's scale."""
    is_log = np.array([p.scale == "log" for p in space])
    theta, truth = (np.log(v, where=is_log, out=v.copy()) for v in (interval.theta, interval.truth))
    std = interval.std / np.where(is_log, interval.theta, 1.0)
    return (theta - truth) / np.maximum(std, 1e-300)


def frozen(scenario: str, estimator: str, seed: int) -> Iterator[Interval]:
    """Yield the estimate after one episode on a frozen window."""
    recorded = _nominal(scenario)
    at, window, stride = FROZEN[scenario]
    samples = noisy_samples(recorded, at, window, stride, np.random.default_rng([seed, 1]))
    n = recorded.scenario.estimation.budget if estimator == "target" else LeastSquaresSettings().max_evaluations
    found = estimated(recorded, samples, estimator, n, np.random.default_rng([seed, 2]))
    yield Interval(f"{at:g} s", found.theta, found.std, found.is_identifiable, found.reason, truth_at(recorded, at))


def whole(scenario: str, estimator: str, seed: int) -> Iterator[Interval]:
    """Yield the estimates of one run, at the end of each episode and at the instants."""
    with tempfile.TemporaryDirectory() as folder:
        result = run(Scenario.load(scenario, {"scenario.isolation": "none"}), estimator, seed, Path(folder))
        lines = (Path(folder) / EVENTS).read_text(encoding="utf-8").splitlines()
    estimates = [event for event in map(json.loads, lines) if "std" in event]
    for event in estimates:
        if event["kind"] == "end":
            yield _interval(result, "end of episode", event, event["t"])
    for t in result.scenario.estimation.instants:
        until = [event for event in estimates if event["t"] <= t + 1e-9]
        if until and t <= result.time[-1] + 1e-9:
            yield _interval(result, f"{t:g} s", until[-1], t)


def summary(rows: Sequence[Row]) -> list[Row]:
    """Return a line for each scenario, way of measuring and estimator: all identifiable parameters, and the worst."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["scenario"], _way(row), row["estimator"]), []).append(row)
    return [
        dict(zip(("scenario", "how", "estimator"), key, strict=True)) | _figures(group) for key, group in groups.items()
    ]


def _figures(rows: Sequence[Row]) -> Row:
    names = dict.fromkeys(row["parameter"] for row in rows)
    shares = {name: share([row for row in rows if row["parameter"] == name]) for name in names}
    known = {name: part for name, part in shares.items() if part is not None}
    worst = min(known, key=lambda name: known[name], default="")
    n = sum(row["identifiable"] for row in rows)
    return {
        "seeds": rows[0]["seeds"],
        "intervals": n,
        "not identifiable": sum(row["not"] for row in rows),
        "covered": percent(share(rows)),
        "rms": float(np.sqrt(sum(row["sum of squares"] for row in rows) / n)) if n else float("nan"),
        "least": f"{worst} {percent(known[worst])}" if known else "-",
        "nothing held": f"{percent(share(rows, 'free covered', 'free'))} of {sum(row['free'] for row in rows)}",
    }


def share(rows: Sequence[Row], covered: str = "covered", of: str = "identifiable") -> float | None:
    """Return the share of the intervals of identifiable parameters that cover the truth; None if there are none."""
    n = sum(row[of] for row in rows)
    return sum(row[covered] for row in rows) / n if n else None


def percent(part: float | None) -> str:
    """Return a share in percent, as text."""
    return "-" if part is None else f"{100.0 * part:.1f} %"


def _way(row: Row) -> str:
    if row["how"] == "frozen":
        return "frozen"
    return "end of episode" if row["when"] == "end of episode" else "instants"


def _interval(result: Run, when: str, event: Row, t: float) -> Interval:
    sampled = truth_at(result, t - result.scenario.scenario.macro_step)  # with which the plant came to the sample at t
    return Interval(
        when, np.array(event["theta"]), np.array(event["std"]), event["is_identifiable"], event["reason"], sampled
    )


def _is_possible(scenario: str, estimator: str) -> bool:
    return estimator != "rls" or Scenario.load(scenario).estimation.linear is not None


@cache
def _nominal(scenario: str) -> Run:
    return run(Scenario.load(scenario), "none")


def _key(row: Row) -> tuple[str, str, str]:
    return row["scenario"], row["how"], row["estimator"]


if __name__ == "__main__":
    main()
