"""Events of a run, for its record."""

from dataclasses import dataclass, field
from typing import Any, Literal

EventKind = Literal[
    "trigger", "candidate", "write", "end", "evidence", "disturbance", "lag", "friction", "unexplained", "rest", "undo",
    "limit", "hold", "veto", "confirm", "revert", "stop", "guard",
    "observation", "sensor",
]  # fmt: skip
"""Kind of event: of the loop, of the guard, or of the screening of the samples."""


@dataclass(frozen=True)
class Event:
    """Event of a run, for its record."""

    t: float
    """Communication point [s]."""
    kind: EventKind
    detail: dict[str, Any] = field(default_factory=dict[str, Any])
    """JSON values."""
