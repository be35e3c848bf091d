"""The table that `retune run` prints."""

from collections.abc import Mapping, Sequence
from math import floor, isfinite, log10

import numpy as np

from .result import Run

_ROLES = {"none": "nominal controller", "true": "true parameters (floor)"}


def report(run: Run, baselines: Mapping[str, Run]) -> str:
    """Tracking errors beside the baselines', estimated beside true parameters, latency against the macro step."""
    scenario = run.scenario.scenario
    title = f"{scenario.name}: {scenario.description}" if scenario.description else scenario.name
    duration = float(run.time[-1]) - scenario.start_time if len(run.time) else 0.0
    pace = f", {duration / run.wall:.1f} times real time" if duration else ""
    blocks = [
        [title, f"estimator {run.estimator}, seed {run.seed}; {duration:g} s simulated in {run.wall:.1f} s{pace}"],
        _errors([*baselines.values(), run]),
        _parameters(run),
        _belief(run),
        _latency(run),
        [f"run folder {run.folder}"] if run.folder else [],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block)


def _errors(runs: Sequence[Run]) -> list[str]:
    header = ["mean squared tracking error", *runs[0].errors, "largest |e|"]
    rows = [header]
    for run in runs:
        role = _ROLES.get(run.estimator, f"re-tuned by {run.estimator}")
        ending = f"{run.status} at {run.time[-1]:g} s" if run.status != "done" and len(run.time) else ""
        rows.append([role, *(f"{e:.4g}" for e in run.mse), f"{run.max_error:.4g} {ending}".strip()])
    return aligned(rows)


def _parameters(run: Run) -> list[str]:
    """True and held values at the scenario's instants and at the end."""
    if not len(run.time):
        return []
    end = float(run.time[-1])
    instants = [t for t in run.scenario.estimation.instants if t <= end]
    times = instants if instants and instants[-1] >= end - 1e-9 else [*instants, end]
    rows = [["parameter, true / in the controller", *(f"t = {t:g} s" for t in times)]]
    columns = [run.parameters_at(t) for t in times]
    for i, parameter in enumerate(columns[0]):
        values = [f"{c[i]['true']:.4g} / {c[i]['estimated']:.4g}" for c in columns]
        rows.append([f"{parameter['name']} [{parameter['unit']}]", *values])
    return aligned(rows)


def _belief(run: Run) -> list[str]:
    """What was estimated last, its root mean square errors, and what the data do not fix."""
    if run.belief is None:
        return []
    last = run.belief
    columns = zip(last.names, last.units, last.values, last.std, last.is_identifiable, strict=True)
    rows = [
        [f"{name} [{unit}]", with_std(value, std), "" if known else "not fixed by the data"]
        for name, unit, value, std, known in columns
    ]
    return aligned([[f"last estimate, at t = {last.t:g} s", "estimate ± std", ""], *rows]) + list(last.findings)


def _latency(run: Run) -> list[str]:
    figures = run.summary()
    latency = figures["latency_ms"]
    if latency["p50"] is None:
        return []
    return [
        f"{figures['evaluations']} evaluations in {figures['episodes']} episodes, one in {latency['p50']:.1f} ms "
        f"(median), {latency['p99']:.1f} ms (99 %), {latency['max']:.1f} ms (longest)",
        f"macro step {figures['deadline_ms']:g} ms: missed by {figures['missed_deadlines']} "
        f"of {len(run.latencies)} steps with evaluations",
    ]


def ending(run: Run) -> str | None:
    """Why the run did not finish, and where its rows are, in one line; None where it did."""
    if run.status == "done":
        return None
    reason = (run.error or "").rstrip(
        "."
    ) or f"{run.status} at t = {run.time[-1]:.3f} s: a tracked error passed limits.divergence"
    until = f"up to {run.time[-1]:.3f} s " if len(run.time) else ""
    return f"{reason}; rows {until}are in {run.folder}." if run.folder else f"{reason}."


def with_std(value: float, std: float) -> str:
    """`1.3000 ± 0.0012`: as many digits as two of the standard deviation need."""
    if not (isfinite(std) and std > 0.0):
        return f"{value:.6g}"
    digits = 1 - floor(log10(std))
    if digits > 7 or max(abs(value), std) >= 1e6:
        return f"{value:.{max(1, digits + floor(log10(abs(value) or 1.0)) + 1)}g} ± {std:.2g}"
    return f"{value:.{max(digits, 0)}f} ± {std:.{max(digits, 0)}f}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows as a table: the first column to the left, the others to the right."""
    widths = np.max([[len(cell) for cell in row] for row in rows], axis=0)
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    ]
