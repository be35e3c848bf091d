"""Events of a run folder, read as far as they were written."""

import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from ..files import readable
from .run_files import EVENTS

RecordedEvent = Mapping[str, Any]
"""One line of the record: `t` [s], `kind`, and what belongs to that kind."""


def read_events(folder: Path) -> list[RecordedEvent]:
    """Return the events of a run folder, as far as they can be read; none if there is no file."""
    events: list[Any] = []
    with suppress(OSError), open(readable(folder / EVENTS), encoding="utf-8", errors="replace") as file:
        for text in file:
            with suppress(ValueError):  # the last line of a run that was killed
                events.append(json.loads(text))
    return [e for e in events if isinstance(e, dict) and isinstance(e.get("t"), int | float)]
