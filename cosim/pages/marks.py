"""Events of a run as marks of a picture and rows of a table: their names, signs and reasons."""

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final, NamedTuple

from ..plots.palette import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION
from ..runs.diagnosis_report import friction_term, limit_text
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run
from ..text_table import with_std


class Sign(NamedTuple):
    """Sign of a kind of event in a picture."""

    text: str
    """Name of the kind."""
    marker: str
    """Bokeh's name of the marker."""
    colour: str


SIGNS: Final[Mapping[str, Sign]] = {
    "trigger": Sign("noticed", "triangle", ORANGE),
    "write": Sign("written", "circle", BLUE),
    "confirm": Sign("proven", "circle_dot", GREEN),
    "end": Sign("search ended", "dash", GREY),
    "veto": Sign("refused by the guard", "x", VERMILION),
    "limit": Sign("limited by the guard", "asterisk", VERMILION),
    "hold": Sign("held back in part", "cross", VERMILION),
    "revert": Sign("reverted by the guard", "inverted_triangle", BLACK),
    "undo": Sign("undone", "inverted_triangle", PURPLE),
    "stop": Sign("re-tuning stopped", "square", BLACK),
    "disturbance": Sign("disturbance", "diamond", PURPLE),
    "lag": Sign("late or limited inputs, or their end", "diamond_dot", PURPLE),
    "friction": Sign("friction, or its end", "circle_cross", PURPLE),
    "unexplained": Sign("unexplained", "diamond_cross", PURPLE),
    "rest": Sign("rest, or its end", "square_cross", PURPLE),
    "observation": Sign("sample kept out", "square_x", SKY),
    "sensor": Sign("sensor", "square_pin", SKY),
    "guard": Sign("guard", "hex", GREY),
    "fault": Sign("fault", "star", BLACK),
    "interrupt": Sign("interrupted", "square_dot", GREY),
}
"""Kinds of events that are marks of their own, from top to bottom; candidates are in the picture of the evidence."""
MOST_MARKS: Final = 5000
"""Number of marks of one kind up to which all are drawn."""
REFUSALS: Final = ("veto", "revert", "stop", "limit", "hold", "sensor", "observation", "undo", "rest")
"""Kinds of events by which something was not done, or taken back; the most important first."""
_LAGS: Final = {"time_constant": "time constant", "dead_time": "dead time"}
"""Names of what an event `lag` has."""
_NAMED: Final = {"disturbance": ("size",), "lag": (*_LAGS, "rates", "limits"), "friction": ("terms",)}
"""What an event has that names something, by its kind; empty or zero where that is over."""
_BACK: Final = ("revert", "undo")
"""Kinds of events whose parameters are earlier ones."""
_NUMBER: Final = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", re.IGNORECASE)


def reason_of(event: RecordedEvent, run: Run) -> str:
    """Return the reason and the content of an event in a line, as far as it has any."""
    parts = [str(event["reason"])] if event.get("reason") else []
    if event.get("kind") == "observation":
        parts.append(f"{event.get('sensor')}: {event.get('fault')}")
    if isinstance(size := event.get("size"), dict) and size:
        parts.append(", ".join(f"{channel} {_number(value)}" for channel, value in size.items()))
    if event.get("kind") == "friction":
        with suppress(LookupError, TypeError, ValueError):  # a record of anybody's
            parts += map(friction_term, event["terms"])
    parts += [f"{text} {_number(value)} s" for key, text in _LAGS.items() if (value := event.get(key))]
    if isinstance(rates := event.get("rates"), list) and (limits := [_number(r) for r in rates if r is not None]):
        parts.append(f"rate limited to {' and '.join(limits)} per second")
    with suppress(AttributeError, TypeError, ValueError):
        parts += [f"{name} {limit_text(*of)}" for name, of in event.get("limits", {}).items()]
    if held := values_of(event, run):
        parts.append(f"back to {held}" if event.get("kind") in _BACK else held)
    if isinstance(event.get("cost"), int | float):
        parts.append(f"sum of squares {event['cost']:.4g}")
    return "; ".join(parts)


def is_named(event: RecordedEvent) -> bool:
    """Return whether an event names a disturbance, a lag or friction; False where it says that they are over."""
    found = [event.get(key) for key in _NAMED.get(str(event.get("kind")), ())]
    return any(any(x is not None for x in value) if isinstance(value, list) else value for value in found)


def thinned(events: Sequence[RecordedEvent]) -> Sequence[RecordedEvent]:
    """Return the events, of many every nth: as many as are drawn at most."""
    return events[:: -(-len(events) // MOST_MARKS) or 1]


def values_of(event: RecordedEvent, run: Run) -> str:
    """Return the parameters of an event with their standard deviations; empty for one without."""
    theta, std = event.get("theta"), event.get("std")
    if not isinstance(theta, list):
        return ""
    stds = std if isinstance(std, list) and len(std) == len(theta) else [None] * len(theta)
    texts = [
        f"{p.name} {_value(value, s)} {'' if p.unit == '1' else p.unit}".rstrip()
        for p, value, s in zip(run.scenario.estimation.parameters, theta, stds, strict=False)
    ]
    return ", ".join(texts)


def _value(value: Any, std: Any) -> str:
    if not isinstance(value, int | float):
        return "?"
    return with_std(float(value), float(std)) if isinstance(std, int | float) and std else _number(value)


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else "?"


class Refusal(NamedTuple):
    """Refusals of one kind and with one reason, but for the numbers in it."""

    what: str
    """Name of the kind."""
    why: str
    """Reason of the first one."""
    times: str
    """When, and how often."""


def refusals(run: Run, events: Sequence[RecordedEvent]) -> list[Refusal]:
    """Return what was refused, taken back or kept out, and why; the same reasons together, with their times."""
    groups: dict[tuple[str, str], list[RecordedEvent]] = {}
    for event in events:
        if event.get("kind") in REFUSALS:
            reason = _NUMBER.sub("#", str(event.get("reason") or f"{event.get('fault')} {event.get('sensor')}"))
            groups.setdefault((str(event["kind"]), reason), []).append(event)
    return [
        Refusal(SIGNS[kind].text, reason_of(same[0], run), _times([float(e["t"]) for e in same]))
        for (kind, _), same in sorted(groups.items(), key=lambda group: REFUSALS.index(group[0][0]))
    ]


def _times(times: Sequence[float]) -> str:
    if len(times) == 1:
        return f"{times[0]:.6g} s"
    return f"{len(times)} times, {times[0]:.6g} to {times[-1]:.6g} s"
