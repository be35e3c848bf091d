"""End of a suspicion: which parameters to return to, and the events."""

from dataclasses import dataclass

from ..events import Event
from ..space import Vector


@dataclass(frozen=True)
class Settled:
    """End of a suspicion."""

    undo: Vector | None
    """Parameters (d,) from before the onset, to return to; None where those in force stay."""
    events: tuple[Event, ...] = ()
    ends_search: bool = False
    """True where the search for parameters is at its end, too."""
