"""The table that `retune run` prints."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..text_table import aligned, counted, with_std
from .diagnosis_report import diagnosis_report
from .recorded_events import RecordedEvent, read_events
from .result import Run

_ROLES = {"none": "nominal controller", "true": "true parameters (floor)"}


def report(run: Run, baselines: Mapping[str, Run]) -> str:
    """Return the report: tracking errors beside the baselines', parameters beside true ones, latency, guard, screen."""
    scenario = run.scenario.scenario
    duration = float(run.time[-1]) - scenario.start_time if len(run.time) else 0.0
    pace = f" in {run.wall:.1f} s, {duration / run.wall:.1f} times real time" if run.wall > 0.0 else " so far"
    judged = [f"candidates judged by {run.objective}"] if run.objective else []
    events = read_events(run.folder) if run.folder else []
    blocks = [
        [
            scenario.title,
            f"estimator {run.estimator}, seed {run.seed}; {duration:g} s simulated{pace}",
            *judged,
        ],
        _errors([*baselines.values(), run]),
        _parameters(run),
        _final_estimate(run),
        _latency(run),
        _oversight(run, events),
        diagnosis_report(run, events),
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
    """Return the table of true and held parameters at the scenario's instants and at the end."""
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
    places = [min(int(np.searchsorted(run.time, t - 1e-9)), len(run.time) - 1) for t in times]
    rows += [[name, *(f"{values[k]:.4g}" for k in places)] for name, values in run.gains.items()]
    return aligned(rows)


def _final_estimate(run: Run) -> list[str]:
    """Return the last estimate with its root mean square errors, and the findings on it."""
    if run.final_estimate is None:
        return []
    last = run.final_estimate
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
        f"{counted(figures['evaluations'], 'evaluation')} in {counted(figures['episodes'], 'episode')}; one takes "
        f"{latency['p50']:.1f} ms (median), {latency['p99']:.1f} ms (99th percentile), {latency['max']:.1f} ms (most)",
        f"deadline {figures['deadline_ms']:g} ms, the macro step: missed in {figures['missed_deadlines']} of "
        f"{counted(len(run.latencies), 'step')} with evaluations",
    ]


def _oversight(run: Run, events: Sequence[RecordedEvent]) -> list[str]:
    """Return lines on writes, vetoes and reverts of the guard, and on samples that were kept out."""
    lines: list[str] = []
    if guard := run.guard:
        n = guard.get("undecided", 0)  # of an older run
        undecided = f" ({n} of them while a disturbance explained the samples as well)" if n else ""
        written = f"{guard['written']} written{undecided}"
        counts = [written, f"{guard['vetoed']} vetoed", f"{guard['reverted']} reverted"]
        counts += [f"{guard[kind]} {kind}" for kind in ("limited", "held") if guard[kind]]
        stop = f"; re-tuning stopped at {guard['stopped_at']:g} s" if guard["stopped_at"] is not None else ""
        blind = guard.get("not_rolled_ahead")
        lines.append(
            f"guard: {', '.join(counts)}{stop}{f'; the loop was not simulated ahead: {blind}' if blind else ''}"
        )
        if n and n == guard["written"]:
            lines.append("if such a disturbance acted, the estimates and their ± are wrong: no write speaks against it")
        vetoes = [e for e in events if e.get("kind") == "veto"]
        if vetoes:
            lines.append(f"the last veto, at t = {vetoes[-1]['t']:g} s: {vetoes[-1].get('reason', '')}")
    return lines + screened(run.observations)


def screened(seen: Mapping[str, Any] | None) -> list[str]:
    """Return a line on the samples that were kept out, if any were."""
    lines: list[str] = []
    if seen and seen["kept_out"]:
        most = sorted(seen["found"].items(), key=lambda item: -item[1])
        findings = ", ".join(f"{name} ({n})" for name, n in most[:4])
        failed = f"; bad at the end: {', '.join(seen['failed'])}" if seen["failed"] else ""
        more = f" and {len(most) - 4} more" if len(most) > 4 else ""
        lines.append(f"{counted(seen['kept_out'], 'sample')} kept out: {findings}{more}{failed}")
    return lines


def ending(run: Run) -> str | None:
    """Return the reason why the run did not finish, and where its rows are, in one line; or None."""
    if run.status == "done":
        return None
    reason = (run.error or "").rstrip(
        "."
    ) or f"{run.status} at t = {run.time[-1]:.3f} s: a tracked error passed limits.divergence"
    until = f"up to {run.time[-1]:.3f} s " if len(run.time) else ""
    return f"{reason}; rows {until}are in {run.folder}." if run.folder else f"{reason}."
