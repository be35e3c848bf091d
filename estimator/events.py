"""What happened in a run, for its record."""

from dataclasses import dataclass, field
from typing import Any, Literal


@dataclass(frozen=True)
class Event:
    """One thing that happened, for the record."""

    t: float
    """Communication point [s]."""
    kind: Literal[
        "trigger", "candidate", "write", "end",
        "limit", "hold", "veto", "confirm", "revert", "stop", "guard",
        "observation", "sensor",
    ]  # fmt: skip
    """What it was: the loop's, the guard's, the screen's of the samples."""
    detail: dict[str, Any] = field(default_factory=dict[str, Any])
    """JSON values."""
