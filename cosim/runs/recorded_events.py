"""Events of a run folder, read as far as they were written."""

import json
from collections.abc import Mapping
from contextlib import suppress
from math import isfinite
from pathlib import Path
from typing import Any, Final

from ..files import readable
from .run_files import EVENTS

RecordedEvent = Mapping[str, Any]
"""One line of the record: `t` [s], `kind`, and what belongs to that kind."""


_TYPES: Final[Mapping[str, Any]] = {
    "kind": str, "reason": str, "fault": str, "sensor": str, "cost": int | float, "theta": list, "std": list,
    "size": dict, "scores": dict, "explained": list, "n_samples": int, "is_known": bool,
}  # fmt: skip
"""Types of the content that is drawn or told; anything else is left out."""


def read_events(folder: Path) -> list[RecordedEvent]:
    """Return the events of a run folder, as far as they can be read and make sense; none if there is no file."""
    events: list[Any] = []
    with suppress(OSError), open(readable(folder / EVENTS), encoding="utf-8", errors="replace") as file:
        for text in file:
            with suppress(ValueError):  # the last line of a run that was killed
                events.append(json.loads(text))
    return [_sound(e) for e in events if isinstance(e, dict) and _is_number(e.get("t"))]


def _sound(event: dict[str, Any]) -> RecordedEvent:
    known = {key: value for key, value in event.items() if isinstance(value, _TYPES.get(key, object))}
    for key in ("theta", "std"):
        if key in known:
            known[key] = [value if _is_number(value) else None for value in known[key]]
    for key in ("size", "scores"):
        if key in known:
            known[key] = {name: value if _is_number(value) else None for name, value in known[key].items()}
    return known


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and isfinite(value)
