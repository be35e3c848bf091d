"""Coverage of the truth by 95 % intervals: Monte Carlo on the named scenarios.

    retune study benchmarks/studies/coverage.toml --out OUT
    python -m benchmarks.coverage OUT                                     # of the study's runs
    python -m benchmarks.coverage --frozen pendulum ... [--estimators target ...] [--seeds N]

In whole runs, FMUs and all, the estimate is compared with the truth at the end of each episode, and at the scenario's
instants (whatever has happened since the episode). `--frozen` makes no runs: one episode on a frozen window of the
nominal controller's run, with fresh noise for each seed. The truth is what the plant had when it came to the newest
sample. The interval is estimate ± 1.96 std in the parameter's scale: where that is `log`, theta exp(± 1.96 std /
theta). Parameters that the estimate calls not identifiable are only counted. results/coverage.json has a row for each
scenario, way of measuring and estimator, each replaced when it is measured again.
"""

import argparse
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import report
from benchmarks.frozen import estimated, noisy_samples, truth_at
from benchmarks.report import Row
from cosim.blas_threads import one_thread
from cosim.errors import CosimError
from cosim.runs.result import Run, read_run
from cosim.runs.run_files import EVENTS
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.studies.folder import RUNS
from cosim.studies.ledger import LEDGER, open_ledger
from estimator import ParameterSpace, Vector
from estimator.baselines.solvers import LeastSquaresSettings

FROZEN = {"pendulum": (3.35, 30, 1), "quadrotor": (5.0, 10, 5), "stiction": (4.0, 100, 1), "rigid-body": (2.6, 10, 5)}
"""Time of the newest sample [s], number of samples and macro steps between them, for each scenario."""
QUANTILE = 1.96
COUNTS = ("seeds", "identifiable", "not", "covered", "sum of squares", "free", "free covered")
"""Counts for one parameter: seeds; intervals where it was identifiable, or not; those that covered the truth; the sum
of the squared errors in standard deviations; intervals of estimates that hold no direction at its old value, and how
many of them covered the truth."""


class Interval(NamedTuple):
    """An estimate at one time, and the true values at that time."""

    when: str
    theta: Vector
    std: Vector
    is_identifiable: Sequence[bool]
    reason: str
    truth: Vector


def main() -> None:
    """Count what is asked for, keep and print it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", type=Path, metavar="OUT", help="folder of the study coverage.toml")
    parser.add_argument("--frozen", nargs="+", default=[], choices=list(FROZEN), metavar="SCENARIO")
    parser.add_argument("--estimators", nargs="+", default=["target", "least-squares"], help="for frozen windows")
    parser.add_argument("--seeds", type=int, default=200, help="of frozen windows (default: 200)")
    options = parser.parse_args()
    try:
        rows = [row for folder in options.folders for row in of_study(folder)]
    except CosimError as e:
        parser.error(str(e))
    with one_thread():
        for scenario in options.frozen:
            rows += [
                row for name in options.estimators for row in tallied(
                    (scenario, "frozen", name), (frozen(scenario, name, seed) for seed in range(options.seeds))
                )
            ]  # fmt: skip
    report.write("coverage", report.updated("coverage", summary(rows), "scenario", "how", "estimator"))


def of_study(folder: Path) -> list[Row]:
    """Return the counts of a study whose runs are kept: of those that have ended. Raises CosimError."""
    runs: dict[tuple[str, str, str], list[Path]] = {}
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        for entry in ledger.entries():
            if entry.result and entry.point["estimator"] != "none":
                key = entry.point["scenario"], "runs", entry.point["estimator"]
                runs.setdefault(key, []).append(folder / RUNS / entry.result["run"])
    return [row for key, places in runs.items() for row in tallied(key, map(whole, places))]


def tallied(key: tuple[str, str, str], seeds: Iterable[Iterator[Interval]]) -> list[Row]:
    """Return the counts for each time and parameter over the seeds of a scenario, a way of measuring, an estimator."""
    tally: dict[tuple[str, str], Row] = {}
    labels = {"scenario": key[0], "how": key[1], "estimator": key[2]}
    space = Scenario.load(key[0]).estimation.space
    found = [list(intervals) for intervals in seeds]
    for interval in chain.from_iterable(found):
        count(tally, space, labels, interval)
    return [row | {"seeds": len(found)} for row in tally.values()]


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


def whole(folder: Path) -> Iterator[Interval]:
    """Yield the estimates of the run in a folder, at the end of each episode and at the instants."""
    result = read_run(folder)
    lines = (folder / EVENTS).read_text(encoding="utf-8").splitlines()
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


@cache
def _nominal(scenario: str) -> Run:
    return run(Scenario.load(scenario), "none")


if __name__ == "__main__":
    main()
