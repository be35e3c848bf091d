"""Answers to a reader's first questions: how it went, what changed, what was noticed when, and what was written."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from ..text_table import counted
from .marks import values_of

_JUMP: Final = 0.05
"""Share of its whole range by which a value moves in one step, or else it drifts."""
_ISOLATED: Final = 5.0
"""Ratio of a jump to the steps beside it."""
_DRIFT: Final = 0.01
"""Share of its size by which a value drifts, or else it is constant."""
_CLOSE: Final = 0.05
"""Relative error of parameters that are found."""
MOST_CHAPTERS: Final = 500
"""Number of rows of a table up to which all are shown."""


def verdict(run: Run, baselines: Mapping[str, Run], events: Sequence[RecordedEvent]) -> list[str]:
    """Return how the run ended, how well it tracked, and how often what was done: a sentence each."""
    name = "the nominal controller" if run.estimator == "none" else f"re-tuning by {run.estimator}"
    if run.estimator == "true":
        name = "the controller with the true parameters"
    stop = run.scenario.scenario.stop_time
    at = f"t = {run.time[-1]:.6g} s" if len(run.time) else "the start"
    endings = {
        "done": f"{name[0].upper()}{name[1:]} kept the loop to its end at {at}.",
        "diverged": f"The loop was lost with {name}: at {at} a tracked error passed the limit of divergence.",
        "faulted": f"The run ended at {at} by a fault: {run.error or 'no reason is recorded'}.",
        "running": f"The run goes on: {at} of {stop:g} s.",
        "unfinished": f"The run was stopped at {at} of {stop:g} s, and can be resumed.",
        "interrupted": f"The run was interrupted at {at} of {stop:g} s, and can be resumed.",
    }
    return [
        endings[run.status],
        *_compared(run, baselines),
        *([] if run.estimator in ("none", "true") else [_counts(events)]),
    ]


def _compared(run: Run, baselines: Mapping[str, Run]) -> Iterator[str]:
    """Yield the ratios of the mean squared tracking error to those of nominal and true parameters."""
    error = sum(run.mse)
    texts = {"none": "the nominal controller's", "true": "that of a controller with the true parameters"}
    found = {
        text: error / least
        for other, text in texts.items()
        if other in baselines and other != run.estimator and baselines[other].status == "done" == run.status
        if (least := sum(baselines[other].mse)) > 0.0 and np.isfinite(error / least)
    }
    if found:
        yield f"Its mean squared tracking error is {' and '.join(f'{_ratio(r)} {text}' for text, r in found.items())}."


def _ratio(ratio: float) -> str:
    if ratio < 0.1:
        return f"1/{float(f'{1.0 / ratio:.3g}'):,.0f} of" if ratio > 0.0 else "0 times"
    return f"{ratio:.3g} times"


def _counts(events: Sequence[RecordedEvent]) -> str:
    def n(*kinds: str) -> int:
        return sum(e.get("kind") in kinds for e in events)

    named = sum(e.get("kind") == "disturbance" and bool(e.get("size")) for e in events)
    counts = [
        f"It was triggered {_often(n('trigger'))} and wrote parameters {_often(n('write'))}",
        f"the guard refused {counted(n('veto'), 'write')} and reverted {n('revert')}",
        f"{counted(named, 'disturbance')} {'was' if named == 1 else 'were'} named",
    ]
    return "; ".join(counts) + "."


def _often(n: int) -> str:
    return {0: "never", 1: "once", 2: "twice"}.get(n, f"{n} times")


class PlantChange(NamedTuple):
    """Change of the plant, as only a simulation knows it, and what re-tuning made of it."""

    when: str
    what: str
    noticed: str
    written: str
    found: str


def plant_changes(run: Run, events: Sequence[RecordedEvent]) -> list[PlantChange]:
    """Return the changes of the plant in order: wrong parameters at the start, jumps and drifts."""
    if not len(run.time):
        return []
    series = _changing(run)
    jumps = {name: _jumps(values) for name, values in series.items()}
    begins = sorted({0, *(k for rows in jumps.values() for k in rows)})
    found: list[PlantChange] = []
    for begin, end in pairwise([*begins, len(run.time)]):
        what = [f"{name}: {_change(values, begin)}" for name, values in series.items() if begin in jumps[name]]
        what = what if begin else _wrong_at_first(run)
        what += [f"{name} drifts {d}" for name, values in series.items() if (d := _drift(values[begin:end]))]
        if what:
            when = f"{run.time[begin]:.6g} s" if begin else "at the start"
            found.append(PlantChange(when, "; ".join(what), *_answers(run, events, begin, end)))
    return found


def _wrong_at_first(run: Run) -> list[str]:
    """Return the parameters that are wrong in the controller at the start."""
    return [
        f"{name} is {truth[0]:.4g}, the controller has {held[0]:.4g}"
        for name, truth, held in _held(run)
        if abs(held[0] - truth[0]) > _DRIFT * abs(truth[0])
    ]


def _changing(run: Run) -> dict[str, Series]:
    """Return the true parameters and whatever else the scenario changes, by name, as far as it is recorded."""
    found = {p.name: run.true_parameters[p.name] for p in run.scenario.estimation.parameters}
    parameters = {run.scenario.true_reference(p) for p in run.scenario.estimation.parameters}
    for reference in run.scenario.changes:
        column = next((c for c in (str(reference), f"held.{reference}") if c in run.series), None)
        if reference not in parameters and column is not None:
            found[reference.variable] = run[column]
    return {name: values for name, values in found.items() if np.all(np.isfinite(values))}


def _jumps(values: Series) -> list[int]:
    """Return the rows at which the values jump."""
    steps = np.abs(np.diff(values))
    around = np.concatenate([[0.0], steps, [0.0]])
    beside = np.maximum(around[:-2], around[2:])
    is_jump = (steps > _JUMP * np.ptp(values)) & (steps > _ISOLATED * beside)
    return (np.flatnonzero(is_jump) + 1).tolist()


def _change(values: Series, k: int) -> str:
    return f"{values[k - 1]:.4g} → {values[k]:.4g}"


def _drift(values: Series) -> str:
    low, high = float(values.min()), float(values.max())
    is_constant = high - low <= _DRIFT * max(abs(low), abs(high))
    return "" if is_constant else f"between {low:.4g} and {high:.4g}"


def _held(run: Run) -> list[tuple[str, Series, Series]]:
    """Return name, true values and those in the controller of each parameter whose truth is known."""
    truth, held = run.true_parameters, run.estimates
    return [(name, truth[name], held[name]) for name in held if np.all(np.isfinite(truth[name]))]


def _answers(run: Run, events: Sequence[RecordedEvent], begin: int, end: int) -> tuple[str, str, str]:
    """Return how long after row begin, and before row end, the change was noticed, written and found."""
    t0 = float(run.time[begin])
    t1 = float(run.time[end]) if end < len(run.time) else np.inf

    def delays(kind: str) -> list[float]:
        return [float(e["t"]) - t0 for e in events if e.get("kind") == kind and t0 - 1e-9 <= e["t"] < t1]

    errors = [
        np.abs(held[begin:end] - truth[begin:end]) - _CLOSE * np.abs(truth[begin:end]) for _, truth, held in _held(run)
    ]
    right = np.flatnonzero(np.all(np.array(errors) <= 0.0, axis=0)) if errors else np.empty(0)
    found = (
        "-" if not len(right) else _delay(float(run.time[begin + right[0]]) - t0) if right[0] else "right throughout"
    )
    triggers, writes = delays("trigger"), delays("write")
    noticed = "a search was under way" if _is_searching(events, t0) else _first(triggers)
    return noticed, _first([s for s in writes if s > 1e-9 or triggers[:1] == [0.0]]), found


def _first(delays: Sequence[float]) -> str:
    return _delay(delays[0]) if delays else "-"


def _is_searching(events: Sequence[RecordedEvent], t: float) -> bool:
    """Return whether a search had begun before t [s], and not ended."""
    kinds = [e["kind"] for e in events if e["t"] < t - 1e-9 and e.get("kind") in ("trigger", "end")]
    return kinds[-1:] == ["trigger"]


def _delay(seconds: float) -> str:
    return f"after {1e3 * seconds:.4g} ms" if seconds < 1.0 else f"after {seconds:.4g} s"


class Chapter(NamedTuple):
    """One search: what began it, and what came of it."""

    t: float
    noticed: str
    n_candidates: int
    written: str
    refused: str


def chapters(run: Run, events: Sequence[RecordedEvent]) -> list[Chapter]:
    """Return the searches in order, each from its trigger to the next one."""
    begins = [i for i, e in enumerate(events) if e.get("kind") == "trigger"]
    found: list[Chapter] = []
    for begin, end in pairwise([*begins, len(events)]):
        part = events[begin:end]
        writes = [e for e in part if e.get("kind") == "write"]
        after = [f"{_VERBS[kind]} {_often(n)}" for kind in _VERBS if (n := sum(e.get("kind") == kind for e in part))]
        written = f"{counted(len(writes), 'write')}, the last: {values_of(writes[-1], run)}" if writes else "nothing"
        reason = str(part[0].get("reason") or "")
        n_candidates = sum(e.get("kind") == "candidate" for e in part)
        found.append(Chapter(float(part[0]["t"]), reason, n_candidates, written, ", ".join(after)))
    return found


_VERBS: Final = {
    "veto": "refused", "limit": "limited", "hold": "held back in part", "revert": "reverted", "undo": "undone",
    "disturbance": "a disturbance named or over", "unexplained": "not explained", "stop": "re-tuning stopped",
}  # fmt: skip
