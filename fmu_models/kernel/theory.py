"""The text of an FMU's documentation."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Theory:
    """What an FMU computes, as HTML."""

    equations: tuple[str, ...]
    """One equation a line."""
    notes: str
    """What their letters mean beyond the table of variables."""
    source: str = ""
    """Author, year, title and equation numbers."""


ADAPTIVE = " What an estimator finds is an input here, and used from a step on at which update_ready is true."
"""What the notes of an adaptive controller add to those of the controller."""
