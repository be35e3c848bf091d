"""The row of a run in a study's table: its figures, by column."""

from typing import Any, Final

import numpy as np

from ..runs.result import Run

WALL_TIMES: Final = ("latency p50 [ms]", "latency p99 [ms]", "latency max [ms]", "missed deadlines", "wall time [s]")
"""Columns that no two runs agree in: all others are the same, whatever machine and engine made the run."""


def row_of(run: Run) -> dict[str, Any]:
    """Return the figures of a run: tracking, parameters at the end, what re-tuning did, wall times."""
    summary = run.summary()
    guard, diagnosis, latency = summary["guard"] or {}, summary["diagnosis"] or {}, summary["latency_ms"]
    changes = _changes(run)
    known = [e for e in run.mse if np.isfinite(e)]
    return {
        "status": run.status,
        "error": run.error,
        "end [s]": float(run.time[-1]) if len(run.time) else None,
        "mse": sum(known) if known else None,
        **{f"mse {name}": mse for name, mse in zip(run.scenario.tracking, run.mse, strict=True)},
        "largest error": run.max_error,
        **{f"error {p['name']} [{p['unit']}]": p["estimated"] - p["true"] for p in summary["parameters"]},
        "evaluations": run.n_evaluations,
        "triggers": run.n_episodes,
        "first write [s]": float(run.time[changes[0]]) if len(changes) else None,
        "writes": guard.get("written", len(changes)),
        "vetoes": guard.get("vetoed"),
        "reverts": guard.get("reverted"),
        "disturbances": diagnosis.get("disturbance"),
        "unexplained": diagnosis.get("unexplained"),
        "rests": diagnosis.get("rest"),
        **dict(zip(WALL_TIMES, (*(latency[k] for k in ("p50", "p99", "max")), summary["missed_deadlines"], run.wall),
                   strict=True)),
    }  # fmt: skip


def _changes(run: Run) -> Any:
    """Return the numbers of the communication points at which the controller's parameters changed."""
    held = np.array(list(run.estimates.values()))
    return 1 + np.flatnonzero(np.any(np.diff(held) != 0.0, axis=0)) if held.size else np.empty(0, dtype=int)


def record_of(run: Run) -> dict[str, Any]:
    """Return the run's summary with further figures for a comparison, as JSON values."""
    references = [run.series[b] for b in run.scenario.tracking.values()]
    return {
        **run.summary(),
        "end": float(run.time[-1]) if len(run.time) else None,
        "reference_mean_square": [float(np.mean(r * r)) if len(r) else None for r in references],
        "latencies_ms": [[1e3 * s for s in step] for step in run.latencies],
    }
