"""Changes of the plant, as only a simulation knows them, and what re-tuning made of each."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from .marks import is_named

_JUMP: Final = 0.05
"""Share of its whole range by which a value moves in one step, or else it drifts."""
_ISOLATED: Final = 5.0
"""Ratio of a jump to the steps beside it."""
_DRIFT: Final = 0.01
"""Share of its size by which a value drifts, or else it is constant."""
_CLOSE: Final = 0.05
"""Relative error of parameters that are found."""
_STILL: Final = 5
"""Number of steps without a change after which a value is constant."""
_ENDS: Final = ("end", "undo", "disturbance", "lag", "friction", "unexplained", "rest")
"""Kinds of events after which no search is under way."""


class PlantChange(NamedTuple):
    """Change of the plant, as only a simulation knows it, and what re-tuning made of it."""

    when: str
    what: str
    noticed: str
    taken_for: str
    written: str
    found: str


def plant_changes(run: Run, events: Sequence[RecordedEvent]) -> list[PlantChange]:
    """Return the changes of the plant in order: wrong parameters at the start, jumps and drifts."""
    if not len(run.time):
        return []
    series = _changing(run)
    jumps = {name: _jumps(values) for name, values in series.items()}
    jumped = {k for rows in jumps.values() for k in rows}
    moved = {k for values in series.values() for k in _onsets(values)}
    begins = sorted({0} | jumped | (moved - {k - 1 for k in jumped}))
    found: list[PlantChange] = []
    for begin, end in pairwise([*begins, len(run.time)]):
        what = [f"{name}: {_change(values, begin)}" for name, values in series.items() if begin in jumps[name]]
        what = what if begin else _wrong_at_first(run)
        stretch = slice(begin, end)
        what += [f"{name} {d}" for name, values in series.items() if (d := _drift(run.time[stretch], values[stretch]))]
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


def _onsets(values: Series) -> list[int]:
    """Return the last rows of stretches in which the values were constant for a while, and then drift."""
    if len(values) <= 2 * _STILL:
        return []
    windows = np.lib.stride_tricks.sliding_window_view(np.diff(values) != 0.0, 2 * _STILL)
    is_onset = ~windows[:, :_STILL].any(axis=1) & windows[:, _STILL:].all(axis=1)
    return (np.flatnonzero(is_onset) + _STILL).tolist()


def _drift(time: Series, values: Series) -> str:
    """Return between what values drift, and until when; empty for constant ones."""
    low, high = float(values.min()), float(values.max())
    if high - low <= _DRIFT * max(abs(low), abs(high)):
        return ""
    last = int(np.flatnonzero(np.diff(values))[-1]) + 1
    until = f" until {time[last]:.6g} s" if len(values) - last > _STILL else ""
    return f"drifts between {low:.4g} and {high:.4g}{until}"


def _held(run: Run) -> list[tuple[str, Series, Series]]:
    """Return name, true values and those in the controller of each parameter whose truth is known."""
    truth, held = run.true_parameters, run.estimates
    return [(name, truth[name], held[name]) for name in held if np.all(np.isfinite(truth[name]))]


def _answers(run: Run, events: Sequence[RecordedEvent], begin: int, end: int) -> tuple[str, str, str, str]:
    """Return how long after row begin, and before row end, the change was noticed, explained, written and found."""
    t0 = float(run.time[begin])
    t1 = float(run.time[end]) if end < len(run.time) else np.inf

    def delays(kind: str, of: Sequence[RecordedEvent] = events) -> list[float]:
        return [float(e["t"]) - t0 for e in of if e.get("kind") == kind and t0 - 1e-9 <= e["t"] < t1]

    errors = [
        np.abs(held[begin:end] - truth[begin:end]) - _CLOSE * np.abs(truth[begin:end]) for _, truth, held in _held(run)
    ]
    right = _right(run.time[begin:end] - t0, np.all(np.array(errors) <= 0.0, axis=0)) if errors else "-"
    triggers, writes = delays("trigger"), delays("write")
    causes = {
        "disturbance": "a disturbance", "lag": "late or limited inputs", "friction": "friction",
        "unexplained": "nothing that is known",
    }  # fmt: skip
    begun = [e for e in events if e.get("kind") == "unexplained" or is_named(e)]
    named = [(text, delays(kind, begun)) for kind, text in causes.items()]
    taken_for = ", ".join(f"{text} {_delay(found[0])}" for text, found in named if found)
    noticed = "a search was under way" if _is_searching(events, t0) else _first(triggers)
    written = _first([s for s in writes if s > 1e-9 or triggers[:1] == [0.0]])
    return noticed, taken_for or ("-" if written == "-" else "changed parameters"), written, right


def _right(since: Series, are_close: NDArray[np.bool_]) -> str:
    """Return from when on all parameters are close, until when if not to the end; since [s]: from the change on."""
    if are_close.all():
        return "right throughout"
    if not are_close.any():
        return "-"
    wrong = np.flatnonzero(~are_close)
    if are_close[-1]:
        return _delay(float(since[wrong[-1] + 1]))
    first, lost = int(np.flatnonzero(are_close)[0]), int(np.flatnonzero(are_close)[-1]) + 1
    begun = _delay(float(since[first])) if first else "right"
    return f"{begun}, lost {_delay(float(since[lost]))}"


def _first(delays: Sequence[float]) -> str:
    return _delay(delays[0]) if delays else "-"


def _is_searching(events: Sequence[RecordedEvent], t: float) -> bool:
    """Return whether a search had begun before t [s], and not ended, be it that something else was named."""
    kinds = [e["kind"] for e in events if e["t"] < t - 1e-9 and e.get("kind") in ("trigger", *_ENDS)]
    return kinds[-1:] == ["trigger"]


def _delay(seconds: float) -> str:
    return f"after {1e3 * seconds:.4g} ms" if seconds < 1.0 else f"after {seconds:.4g} s"
