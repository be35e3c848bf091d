"""Report of a replay on a log: in words for the terminal, and as files."""

import csv
import io
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from estimator import ParameterSpace, Vector
from estimator.events import Event
from estimator.offline.identifiability_report import at_bounds, bounds_met

from ..files import write_json, write_text
from ..runs.diagnosis_report import diagnosed, resting
from ..runs.report import screened
from ..runs.run_files import ESTIMATES
from ..ssv.document import ParameterValue, to_ssv
from ..text_table import aligned, counted
from .fit_report import with_std
from .online import Online, Watched


def report(found: Online) -> str:
    """Return the report for the terminal: of consecutive writes only the last."""
    request, windows = found.request, found.watched
    n_rows, n_candidates = sum(len(w.window.time) for w in windows), sum(w.n_candidates for w in windows)
    judged = f"triggered {found.times('trigger')}, written {found.times('write')}"
    lines = [
        f"{request.fmu.name}, {', '.join(path.name for path in request.logs)}: {counted(n_rows, 'row')} as if online, "
        f"{judged if found.is_judged else 'nothing judged'}",
        f"{counted(n_candidates, 'candidate')}, each on {counted(found.n_samples, 'sample')}, method {request.method}, "
        f"seed {request.seed}, {found.seconds:.1f} s",
        *dict.fromkeys(w.how for w in windows if w.not_begun is None),
        *(f"warning: {warning}" for warning in found.warnings),
    ]
    for w in windows:
        if w.not_begun is not None:
            continue
        lines += [
            "",
            *([w.window.name] if len(windows) > 1 else []),
            *_table(found, w),
            *(at_bounds(found.understood.space, w.theta) if _is_written(w) else []),
            *(diagnosed(told) + resting(told) if (told := w.found["diagnosis"]) else []),
        ]
        lines += screened(w.found["observations"])
    return "\n".join(lines)


def summary(found: Online) -> dict[str, Any]:
    """Return the whole result as JSON values."""
    request, space = found.request, found.understood.space
    return {
        "fmu": str(request.fmu),
        "logs": [str(path) for path in request.logs],
        "method": request.method,
        "seed": request.seed,
        "samples": found.n_samples,
        "parameters": {p.name: {"unit": p.unit, "lower": p.lower, "upper": p.upper, "scale": p.scale} for p in space},
        "noise": dict(zip(request.measured, found.understood.noise.tolist(), strict=True)),
        "start": space.named(found.understood.nominal),
        "windows": [
            {
                "name": w.window.name,
                "rows": len(w.window.time),
                "how": w.how,
                "candidates": w.n_candidates,
                "failure": w.failure,
                "not_begun": w.not_begun,
                "diagnosis": w.found["diagnosis"],
                "observations": w.found["observations"],
                "start": space.named(w.start),
                "events": [{"time": e.t, "event": e.kind, **e.detail} for e in w.events],
                "end": space.named(w.theta),
                "at_bounds": bounds_met(space, w.theta),
            }
            for w in found.watched
        ],
        "warnings": found.warnings,
        "seconds": found.seconds,
    }


def write_files(found: Online, folder: Path) -> None:
    """Write online.json, online.csv with a row for each event, and estimates.ssv. Raises FolderError."""
    write_json(folder / "online.json", summary(found))
    write_text(folder / "online.csv", _csv(found))
    write_text(folder / ESTIMATES, estimates_ssv(found))


def estimates_ssv(found: Online) -> str:
    """Return the parameters in use at the end of the last window as SSV, with their units."""
    understood = found.understood
    end = found.watched[-1].theta.tolist()
    values = [ParameterValue(p.name, v, p.unit) for p, v in zip(understood.space, end, strict=True)]
    return to_ssv(f"{found.request.fmu.stem} online", values, understood.component.units)


def _table(found: Online, watched: Watched) -> list[str]:
    space, n = found.understood.space, len(found.understood.space)
    cells = [["time [s]", "event", *(f"{p.name} [{p.unit}]" for p in space)]]
    texts = [""]
    start = watched.window.time[0]
    cells.append([f"{start:.6g}", "start", *(f"{v:.6g}" for v in watched.start)])
    texts.append("in force")
    for event, text in _shown(watched.events):
        values = [""] * n
        if event.kind == "undo":
            values = [f"{v:.6g}" for v in event.detail["theta"]]
        if event.kind == "write":
            theta, std = event.detail["theta"], event.detail["std"]
            values = [_value(*known) for known in zip(theta, std, space.slope(theta).tolist(), strict=True)]
        cells.append([f"{event.t:.6g}", event.kind, *values])
        texts.append(text + _at_bounds(space, event))
    return [f"{line}  {text}".rstrip() for line, text in zip(_padded(aligned(cells)), texts, strict=True)]


def _is_written(watched: Watched) -> bool:
    return any(event.kind == "write" for event in watched.events)


def _at_bounds(space: ParameterSpace, event: Event) -> str:
    """Return, in words behind a reason, which parameters a write puts at a bound."""
    met = bounds_met(space, np.array(event.detail["theta"])) if event.kind == "write" else {}
    return "".join(f", {name} at its {side} bound" for name, side in met.items())


def _value(value: float, std: float, width: float) -> str:
    """Return value and standard deviation; the latter is left out where it is about as wide as the bounds."""
    return with_std(value, std) if std < 0.5 * width else f"{value:.4g} (held)"


def _padded(lines: Sequence[str]) -> list[str]:
    width = max(map(len, lines))
    return [line.ljust(width) for line in lines]


def _shown(events: Sequence[Event]) -> Iterator[tuple[Event, str]]:
    """Yield the events that a table shows, each with its reason."""
    told = [event for event in events if event.kind != "evidence"]  # which has no reason, but scores
    ordered = sorted(told, key=lambda e: (e.t, e.kind == "end"))  # an episode ends with its last write
    for kind, group in groupby(ordered, key=lambda e: e.kind):
        together = list(group)
        for event in together[-1:] if kind == "write" else together:
            if kind == "trigger":
                yield event, event.detail["reason"]
            elif kind == "write":
                last = f"the last of {len(together)}: " if len(together) > 1 else ""
                yield event, last + event.detail["reason"]
            elif kind == "observation":
                yield event, f"{event.detail['fault']} {event.detail['sensor']}"
            elif kind == "undo":
                yield event, f"back to these: {event.detail['reason']}"
            elif kind == "end":
                yield event, f"episode {event.detail['episode']}"
            else:
                yield event, event.detail["reason"]


def _csv(found: Online) -> str:
    space: ParameterSpace = found.understood.space
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = [name for p in space for name in (f"{p.name} [{p.unit}]", f"std {p.name} [{p.unit}]")]
    writer.writerow(["window", "time [s]", "event", "episode", *columns, "reason"])
    for number, watched in enumerate(found.watched):
        episode = 0
        for event in watched.events:
            episode = event.detail.get("episode", episode)
            values = _interleaved(event.detail.get("theta"), event.detail.get("std"), len(space))
            writer.writerow([number, f"{event.t:.12g}", event.kind, episode, *values, event.detail.get("reason", "")])
    return text.getvalue()


def _interleaved(theta: Vector | None, std: Vector | None, n: int) -> list[str]:
    if theta is None or std is None:
        return [""] * (2 * n)
    return [repr(float(v)) for v in np.column_stack([theta, std]).reshape(-1)]
