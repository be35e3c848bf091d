"""Results of many runs: the figures of each estimator over seeds, and of each run relative to its floor."""

import math
import os
import os.path
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from ..files import to_json
from ..runs.manifest import versions
from ..scenarios.scenario import Scenario

ROUNDING: Final = 1e-18
"""A floor's mean squared error below this part of the reference's mean square is rounding; nothing is divided by it."""

Record = Mapping[str, Any]
"""A run's summary with `end` [s], `reference_mean_square` and `latencies_ms`, as `row.record_of` makes it."""


@dataclass(frozen=True)
class ComparisonFigures:
    """Runs of several estimators with the same seeds, and their figures."""

    scenario: Scenario
    """Scenario of all runs."""
    estimators: tuple[str, ...]
    """Names of the estimators, in the order of the rows: `none` and `true` first."""
    seeds: tuple[int, ...]
    """Seeds of noise and search."""
    runs: tuple[Record, ...]
    """One record per run, by estimator, then by seed; none is left out, however it ended."""
    jobs: int
    """Runs at a time."""
    cpus: int = os.cpu_count() or 1
    """Processors of the machine."""
    folder: Path | None = None
    """Folder of the files written, if any."""
    is_open_loop: bool = False
    """True where the runs replay one record: they differ in their estimates, not in their tracking."""

    @property
    def groups(self) -> dict[str, tuple[str, ...]]:
        """Estimated parameters of the same unit, by label: `m [kg]`, `J [kg.m2]`."""
        by_unit: dict[str, list[str]] = {}
        for p in self.scenario.estimation.parameters:
            by_unit.setdefault(p.unit, []).append(p.name)
        return {f"{_common_name(names)} [{unit}]": tuple(names) for unit, names in by_unit.items()}

    @property
    def instants(self) -> tuple[float, ...]:
        """Times [s] at which parameters are compared: the scenario's, or the end where it has none in the run."""
        stop = self.scenario.scenario.stop_time
        return tuple(t for t in self.scenario.estimation.instants if t <= stop + 1e-9) or (stop,)

    def rows(self) -> list[dict[str, Any]]:
        """Return the figures of each estimator over all seeds, in the order of the estimators."""
        return [self._row(name, [r for r in self.runs if r["estimator"] == name]) for name in self.estimators]

    def ratio(self, record: Record) -> float | None:
        """Return the run's sum of mean squared errors over that of the true parameters with the same seed.

        None where either has no rows, or where the floor is zero but for rounding.
        """
        floor = next((r for r in self.runs if r["estimator"] == "true" and r["seed"] == record["seed"]), None)
        if floor is None or not _are_finite([*floor["mse"], *floor["reference_mean_square"], *record["mse"]]):
            return None
        least = sum(floor["mse"])
        return sum(record["mse"]) / least if least > ROUNDING * sum(floor["reference_mean_square"]) else None

    def parameter_error(self, record: Record, t: float, names: Sequence[str]) -> float | None:
        """Return the Euclidean norm of the parameter errors at t [s], in their unit; None after the run's end."""
        at = {i["t"]: i["parameters"] for i in record["instants"]}
        if t == self.scenario.scenario.stop_time and record["end"] is not None and record["end"] > t - 1e-9:
            at.setdefault(t, record["parameters"])
        held = at.get(t)
        return math.hypot(*(p["estimated"] - p["true"] for p in held if p["name"] in names)) if held else None

    def summary(self) -> dict[str, Any]:
        """Return everything as JSON values; times ending in _ms are wall times in ms, others in s."""
        settings = self.scenario.scenario
        return {
            "scenario": settings.name,
            "seeds": list(self.seeds),
            "jobs": self.jobs,
            "cpus": self.cpus,
            "deadline_ms": 1e3 * settings.macro_step,
            "estimators": self.rows(),
            "runs": [{k: v for k, v in r.items() if k != "latencies_ms"} for r in self.runs],
            "settings": self.scenario.model_dump(mode="json"),
            "versions": versions(),
            "folder": str(self.folder) if self.folder else None,
        }

    def to_json(self, indent: int | None = None) -> str:
        """Return one JSON object, with null for missing values."""
        return to_json(self.summary(), indent)

    def _row(self, name: str, records: Sequence[Record]) -> dict[str, Any]:
        tracked = enumerate(self.scenario.tracking)
        latencies = [ms for r in records for step in r["latencies_ms"] for ms in step]
        p50, p99 = np.percentile(latencies, [50, 99]).tolist() if latencies else (None, None)
        unfinished = {
            status: [{"seed": r["seed"], "t": r["end"], "error": r["error"]} for r in records if r["status"] == status]
            for status in ("diverged", "faulted")
        }
        return {
            "estimator": name,
            "runs": len(records),
            "mse": {output: _figure(r["mse"][i] for r in records) for i, output in tracked},
            "ratio": _figure(map(self.ratio, records)),
            "parameter_errors": [
                {
                    "t": t,
                    "errors": {
                        label: _figure(self.parameter_error(r, t, names) for r in records)
                        for label, names in self.groups.items()
                    },
                }
                for t in self.instants
            ],
            "evaluations": _figure(r["evaluations"] for r in records),
            "model_calls": _figure(r["model_calls"] for r in records),
            "latency_ms": {"p50": p50, "p99": p99, "n": len(latencies)},
            "missed_deadlines": sum(r["missed_deadlines"] for r in records),
            "steps_with_evaluations": sum(len(r["latencies_ms"]) for r in records),
            **unfinished,
        }


def _figure(values: Iterable[float | None]) -> dict[str, Any]:
    """Return median, largest and number of those values that are finite."""
    known = [float(v) for v in values if v is not None and math.isfinite(v)]
    return {"median": median(known) if known else None, "worst": max(known, default=None), "n": len(known)}


def _are_finite(values: Sequence[float | None]) -> bool:
    return all(v is not None and math.isfinite(v) for v in values)


def _common_name(names: Sequence[str]) -> str:
    """Return a name for several parameters: their common prefix, or all names."""
    if len(names) == 1:
        return names[0]
    return os.path.commonprefix(list(names)).rstrip("_.") or ", ".join(names)  # noqa: RUF071  not a path
