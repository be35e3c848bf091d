"""Whether 95 % intervals cover the truth as often as they say: Monte Carlo on the named scenarios.

    python -m benchmarks.coverage [--scenarios pendulum ...] [--how frozen runs] [--estimators target ...] [--seeds 200]

`frozen`: one episode on a frozen window of the nominal controller's run, fresh noise a seed. `runs`: whole runs, FMUs
and all; the belief is compared with the truth at the end of each episode, and at the scenario's instants (whatever has
happened since the episode). The truth is that with which the plant came to the newest sample. The interval is estimate
± 1.96 std in the parameter's scale: where that is `log`, theta exp(± 1.96 std / theta). Of parameters that the estimate
calls not identifiable only the number is told. Results accumulate in benchmarks/results/coverage.json: an interrupted
measurement goes on, as does one that is given more seeds; `--fresh` drops what is there of the rows asked for.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.frozen import estimated, noisy_samples, truth_at
from benchmarks.report import RESULTS, keep, table
from cosim.runs.result import Run
from cosim.runs.run_files import EVENTS
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from estimator import ParameterSpace, Vector
from estimator.baselines import LeastSquaresSettings

FROZEN = {"pendulum": (3.35, 30, 1), "quadrotor": (5.0, 10, 5), "stiction": (4.0, 100, 1), "rigid-body": (2.6, 10, 5)}
"""Of each scenario: time of the newest sample [s], samples, macro steps between them."""
ESTIMATORS = {"frozen": ("target", "least-squares"), "runs": ("target", "least-squares", "ukf", "rls")}
QUANTILE = 1.96
COUNTS = ("seeds", "identifiable", "not", "covered", "sum of squares", "free", "free covered")
"""Of one parameter: intervals of which it was identifiable, or not; those that covered the truth; sum of the squared
errors in standard deviations; and those of estimates that hold no direction at its old value."""
BATCH = 10
"""Seeds between two writings of the file."""


class Interval(NamedTuple):
    """An estimate at one time, and the truth there."""

    when: str
    theta: Vector
    std: Vector
    is_identifiable: Sequence[bool]
    reason: str
    truth: Vector


def main() -> None:
    """Parse, measure what is missing, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=list(FROZEN))
    parser.add_argument("--how", nargs="+", choices=list(ESTIMATORS), default=list(ESTIMATORS))
    parser.add_argument("--estimators", nargs="+", default=list(ESTIMATORS["runs"]))
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--fresh", action="store_true")
    options = parser.parse_args()
    asked = [
        key
        for key in product(options.scenarios, options.how, options.estimators)
        if key[2] in ESTIMATORS[key[1]] and _is_possible(key[0], key[2])
    ]
    rows = [row for row in _stored() if not (options.fresh and _key(row) in asked)]
    with threadpool_limits(1):
        for key in asked:
            rows = measure(rows, key, options.seeds)
    print(table(summary(rows)))


def measure(rows: list[dict[str, Any]], key: tuple[str, str, str], n_seeds: int) -> list[dict[str, Any]]:
    """The rows with the seeds added that are missing; kept on the way."""
    scenario, how, estimator = key
    mine = [row for row in rows if _key(row) == key]
    others = [row for row in rows if _key(row) != key]
    tally = {(row["when"], row["parameter"]): row for row in mine}
    beliefs = partial(frozen, scenario, estimator) if how == "frozen" else partial(whole, scenario, estimator)
    space = Scenario.load(scenario).estimation.space
    for seed in range(mine[0]["seeds"] if mine else 0, n_seeds):
        for belief in beliefs(seed):
            count(tally, space, dict(zip(("scenario", "how", "estimator"), key, strict=True)), belief)
        for row in tally.values():
            row["seeds"] = seed + 1
        if (seed + 1) % BATCH == 0 or seed + 1 == n_seeds:
            keep("coverage", [*others, *tally.values()])
    return [*others, *tally.values()]


def count(
    tally: dict[tuple[str, str], dict[str, Any]], space: ParameterSpace, labels: dict[str, str], belief: Interval
) -> None:
    """Add one belief to the tally, a row a parameter."""
    for name, z, is_identifiable in zip(space.names, deviations(space, belief), belief.is_identifiable, strict=True):
        new = {**labels, "when": belief.when, "parameter": name} | dict.fromkeys(COUNTS, 0)
        row = tally.setdefault((belief.when, name), new)
        if not is_identifiable:
            row["not"] += 1
            continue
        row["identifiable"] += 1
        row["covered"] += abs(z) <= QUANTILE
        row["sum of squares"] += min(float(z * z), 1e6)
        if "held" not in belief.reason:
            row["free"] += 1
            row["free covered"] += abs(z) <= QUANTILE


def deviations(space: ParameterSpace, belief: Interval) -> Vector:
    """Estimate minus truth (d,), in the standard deviations claimed, in each parameter's scale."""
    is_log = np.array([p.scale == "log" for p in space])
    theta, truth = (np.log(v, where=is_log, out=v.copy()) for v in (belief.theta, belief.truth))
    std = belief.std / np.where(is_log, belief.theta, 1.0)
    return (theta - truth) / np.maximum(std, 1e-300)


def frozen(scenario: str, estimator: str, seed: int) -> Iterator[Interval]:
    """The belief after one episode on a frozen window."""
    recorded = _nominal(scenario)
    at, window, stride = FROZEN[scenario]
    samples = noisy_samples(recorded, at, window, stride, np.random.default_rng([seed, 1]))
    n = recorded.scenario.estimation.budget if estimator == "target" else LeastSquaresSettings().max_evaluations
    found = estimated(recorded, samples, estimator, n, np.random.default_rng([seed, 2]))
    yield Interval(f"{at:g} s", found.theta, found.std, found.is_identifiable, found.reason, truth_at(recorded, at))


def whole(scenario: str, estimator: str, seed: int) -> Iterator[Interval]:
    """The beliefs of one run: at the end of each episode, and at the instants."""
    with tempfile.TemporaryDirectory() as folder:
        result = run(Scenario.load(scenario, {"scenario.isolation": "none"}), estimator, seed, Path(folder))
        lines = (Path(folder) / EVENTS).read_text(encoding="utf-8").splitlines()
    told = [event for event in map(json.loads, lines) if "std" in event]
    for event in told:
        if event["kind"] == "end":
            yield _belief(result, "end of episode", event, event["t"])
    for t in result.scenario.estimation.instants:
        until = [event for event in told if event["t"] <= t + 1e-9]
        if until and t <= result.time[-1] + 1e-9:
            yield _belief(result, f"{t:g} s", until[-1], t)


def summary(rows: list[dict[str, Any]]) -> list[dict[str, object]]:
    """A line a scenario, way of measuring and estimator: of the identifiable parameters, all and the worst one."""
    lines: list[dict[str, object]] = []
    groups = dict.fromkeys((*_key(row), _group(row)) for row in rows)
    for key in groups:
        of_key = [row for row in rows if (*_key(row), _group(row)) == key]
        names = dict.fromkeys(row["parameter"] for row in of_key)
        each = {name: share([row for row in of_key if row["parameter"] == name]) for name in names}
        known = {name: s for name, s in each.items() if s is not None}
        n = sum(row["identifiable"] for row in of_key)
        worst = min(known, key=lambda name: known[name], default="")
        lines.append({
            "scenario": key[0], "how": key[3], "estimator": key[2], "seeds": of_key[0]["seeds"], "intervals": n,
            "not identifiable": sum(row["not"] for row in of_key),
            "covered": percent(share(of_key)),
            "rms": float(np.sqrt(sum(row["sum of squares"] for row in of_key) / n)) if n else float("nan"),
            "least": f"{worst} {percent(known[worst])}" if known else "-",
            "nothing held": f"{percent(share(of_key, 'free covered', 'free'))} of {sum(r['free'] for r in of_key)}",
        })  # fmt: skip
    return lines


def share(rows: Sequence[dict[str, Any]], covered: str = "covered", of: str = "identifiable") -> float | None:
    """Of the intervals of identifiable parameters, those that cover the truth; None of none."""
    n = sum(row[of] for row in rows)
    return sum(row[covered] for row in rows) / n if n else None


def percent(part: float | None) -> str:
    """A share in percent."""
    return "-" if part is None else f"{100.0 * part:.1f} %"


def _group(row: dict[str, Any]) -> str:
    if row["how"] == "frozen":
        return "frozen"
    return "end of episode" if row["when"] == "end of episode" else "instants"


def _belief(result: Run, when: str, event: dict[str, Any], t: float) -> Interval:
    sampled = truth_at(result, t - result.scenario.scenario.macro_step)  # with which the plant came to the sample at t
    return Interval(
        when, np.array(event["theta"]), np.array(event["std"]), event["is_identifiable"], event["reason"], sampled
    )


def _is_possible(scenario: str, estimator: str) -> bool:
    return estimator != "rls" or Scenario.load(scenario).estimation.linear is not None


@cache
def _nominal(scenario: str) -> Run:
    return run(Scenario.load(scenario), "none")


def _stored() -> list[dict[str, Any]]:
    path = RESULTS / "coverage.json"
    return json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []


def _key(row: dict[str, Any]) -> tuple[str, str, str]:
    return row["scenario"], row["how"], row["estimator"]


if __name__ == "__main__":
    main()
