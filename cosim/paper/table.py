"""The paper's table of estimates, errors and prediction times, beside what was measured here."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from estimator.methods import method_named

from ..plots.panels import RecordedEvent
from ..runs.result import Run

Theta = tuple[float, float, float, float]
"""Parameters m [kg], J_x, J_y, J_z [kg m2]."""


@dataclass(frozen=True)
class Quoted:
    """One row of the paper's table, as printed."""

    t: float
    """Instant [s]."""
    method: str
    """BO, IPM or SQP."""
    estimate: Theta
    """Estimated values."""
    mass_error: float
    """Error of the mass [kg]; not always the difference of the values beside it."""
    inertia_error: float
    """Norm of the error over the axes [kg m2]."""
    prediction_time: float
    """Time of 30 evaluations for BO, of a solve for the others [s], on the paper's computer."""


# Khan and Chatterjee (2020), table I, quoted.
PAPER_TRUTH: Final[dict[float, Theta]] = {
    1.5: (1.39, 3.47, 3.47, 6.77),
    5.0: (1.85, 6.02, 6.02, 9.32),
    8.0: (1.18, 3.44, 3.44, 6.74),
    11.0: (2.10, 6.39, 6.39, 9.69),
    14.0: (1.25, 3.30, 3.30, 6.60),
}
PAPER_ROWS: Final = (
    Quoted(1.5, "BO", (1.58, 3.57, 3.32, 5.53), 0.185, 1.255, 0.324),
    Quoted(1.5, "IPM", (2.41, 1.04, 1.03, 6.08), 1.011, 3.508, 0.028),
    Quoted(1.5, "SQP", (1.25, 1.10, 1.10, 2.20), 0.144, 5.662, 0.015),
    Quoted(5.0, "BO", (1.86, 3.91, 7.91, 10.2), 0.005, 2.966, 0.354),
    Quoted(5.0, "IPM", (1.87, 0.95, 4.76, 2.25), 0.024, 8.795, 0.026),
    Quoted(5.0, "SQP", (1.25, 1.10, 1.10, 2.20), 0.600, 9.954, 0.013),
    Quoted(8.0, "BO", (1.18, 2.61, 5.42, 9.87), 0.0004, 3.794, 0.354),
    Quoted(8.0, "IPM", (1.94, 1.06, 3.31, 4.59), 0.7622, 3.212, 0.037),
    Quoted(8.0, "SQP", (1.25, 1.10, 1.10, 2.20), 0.0684, 5.621, 0.012),
    Quoted(11.0, "BO", (2.12, 7.89, 5.78, 11.50), 0.018, 2.428, 0.354),
    Quoted(11.0, "IPM", (2.62, 1.02, 3.10, 1.87), 0.520, 10.032, 0.028),
    Quoted(11.0, "SQP", (1.25, 1.10, 1.10, 2.20), 0.850, 10.581, 0.014),
    Quoted(14.0, "BO", (1.25, 3.85, 1.57, 6.93), 0.004, 1.844, 0.384),
    Quoted(14.0, "IPM", (2.68, 2.31, 2.45, 3.82), 0.090, 5.064, 0.028),
    Quoted(14.0, "SQP", (1.20, 1.67, 2.26, 2.64), 0.087, 5.312, 0.013),
)
IN_PAPER: Final = {"paper": "BO", "ipm": "IPM", "ipm-scipy": "IPM", "sqp": "SQP"}
"""The paper's method by estimator here; any other is not in its table."""


def rows(runs: Mapping[str, Run], events: Mapping[str, Sequence[RecordedEvent]]) -> list[dict[str, Any]]:
    """Return the table as JSON values: a row for each estimator and instant, printed and measured values.

    runs: those of the quadrotor by estimator; events: their records. `none` and `true` estimate nothing: left out.
    """
    quoted = {(row.t, row.method): row for row in PAPER_ROWS}
    table: list[dict[str, Any]] = []
    for t in PAPER_TRUTH:
        for name, run in runs.items():
            if name not in ("none", "true"):
                row = quoted.get((t, IN_PAPER.get(name, "")))
                here = measured(run, events.get(name, ()), t)
                table.append({"t": t, "estimator": name, "paper": row and asdict(row), "measured": here})
    return table


def measured(run: Run, events: Sequence[RecordedEvent], t: float) -> dict[str, Any] | None:
    """Return truth at t [s], estimate, the errors' norms and prediction time; None after the run's end.

    The estimate is what the controller holds; during an episode, when that may be a candidate, what it held at the end
    of the episode before.
    """
    parameters = run.parameters_at(t)
    if not parameters:
        return None
    episode = _last_episode(events, t)
    held = run.parameters_at(episode[1]) if episode and _is_searching(events, t) else parameters
    truth, estimate = ([float(p[kind]) for p in of] for kind, of in (("true", parameters), ("estimated", held)))
    difference = np.abs(np.subtract(estimate, truth))
    return {
        "truth": truth,
        "estimate": estimate,
        "mass_error": float(difference[0]),
        "inertia_error": float(np.linalg.norm(difference[1:])),
        "prediction_time": prediction_time(run, events, t),
    }


def prediction_time(run: Run, events: Sequence[RecordedEvent], t: float) -> float | None:
    """Return the wall time [s] of all evaluations of the last episode completed by t [s]; for solvers, the last solve.

    None before the first, or if the record is missing.
    """
    episode = _last_episode(events, t)
    times = run.latency_times
    if times is None:  # a record of an earlier version
        times = sorted({float(e["t"]) for e in events if e.get("kind") == "candidate"})
    if episode is None or len(times) != len(run.latencies):
        return None
    spent = [sum(s) for at, s in zip(times, run.latencies, strict=True) if episode[0] <= at <= episode[1]]
    if not spent:
        return None
    is_solver = hasattr(method_named(run.estimator).estimator, "solve")
    return float(spent[-1] if is_solver else sum(spent))


def _last_episode(events: Sequence[RecordedEvent], t: float) -> tuple[float, float] | None:
    """Return begin and end [s] of the last episode completed by t [s]."""
    begun, last = None, None
    for event in events:
        if event.get("kind") == "trigger":
            begun = float(event["t"])
        elif event.get("kind") == "end" and begun is not None and float(event["t"]) <= t + 1e-9:
            last = begun, float(event["t"])
    return last


def _is_searching(events: Sequence[RecordedEvent], t: float) -> bool:
    """Return whether an episode goes on at t [s]."""
    kinds = [event.get("kind") for event in events if float(event.get("t", 0.0)) <= t + 1e-9]
    return next((kind == "trigger" for kind in reversed(kinds) if kind in ("trigger", "end")), False)


def markdown(
    runs: Mapping[str, Run], table: Sequence[Mapping[str, Any]], labels: Mapping[str, str], jobs: int = 1
) -> str:
    """Return the table in Markdown. labels: names of the estimators; jobs: concurrent runs, which slow one another."""
    seeds = ", ".join(sorted({str(run.seed) for run in runs.values()}))
    texts = [
        "# Estimates, errors and prediction times of the quadrotor",
        "Columns *paper* quote table I of Khan and Chatterjee (2020) as it is printed: their implementation, their "
        f"computer. Columns *here* were measured by `retune figures`, seed {seeds}: what the controller holds (during "
        "an episode: held at the end of the one before), against the truth at the instant. Mass error in kg, inertia "
        "error (norm over the axes) in kg m². Prediction time in s: of all evaluations of the last whole episode; of a "
        f"solve for IPM and SQP; {jobs} "
        f"{'run' if jobs == 1 else 'runs, which slow one another,'} at a time. A dash: "
        "not in the paper, or not there because the run had ended.",
        "\n".join(_errors(table, labels)),
        "True and estimated values: m in kg, J_x, J_y, J_z in kg m².",
        "\n".join(_values(runs, table, labels)),
    ]
    return "\n\n".join(texts) + "\n"


def _errors(table: Sequence[Mapping[str, Any]], labels: Mapping[str, str]) -> list[str]:
    keys = ("mass_error", "inertia_error", "prediction_time")
    names = [f"{key.replace('_', ' ')}, {who}" for key in keys for who in ("paper", "here")]
    lines = [_line(["t [s]", "method", *names]), _line(["---:", "---", *["---:"] * len(names)])]
    for row in table:
        paper, here = row["paper"] or {}, row["measured"] or {}
        cells = [text for key in keys for text in (_exact(paper.get(key)), _number(here.get(key)))]
        lines.append(_line([f"{row['t']:g}", labels[row["estimator"]], *cells]))
    return lines


def _values(runs: Mapping[str, Run], table: Sequence[Mapping[str, Any]], labels: Mapping[str, str]) -> list[str]:
    names = ("m", "J_x", "J_y", "J_z")
    lines = [_line(["t [s]", "", *(f"{n}, {who}" for n in names for who in ("paper", "here"))])]
    lines.append(_line(["---:", "---", *["---:"] * 8]))
    for t, truth in PAPER_TRUTH.items():
        found = [p for run in runs.values() if (p := run.parameters_at(t))]
        here = [p["true"] for p in found[0]] if found else [None] * 4
        lines.append(_line([f"{t:g}", "truth", *_pairs(truth, here)]))
        for row in table:
            if row["t"] == t:
                paper, mine = row["paper"] or {}, row["measured"] or {}
                pairs = _pairs(paper.get("estimate") or [None] * 4, mine.get("estimate") or [None] * 4)
                lines.append(_line([f"{t:g}", labels[row["estimator"]], *pairs]))
    return lines


def _pairs(paper: Sequence[float | None], here: Sequence[float | None]) -> list[str]:
    return [text for a, b in zip(paper, here, strict=True) for text in (_exact(a), _number(b))]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _exact(value: float | None) -> str:
    return "-" if value is None else f"{value:g}"


def _number(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"
