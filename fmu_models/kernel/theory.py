"""Text of an FMU's documentation."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Theory:
    """Equations of an FMU with explanations, as HTML."""

    equations: tuple[str, ...]
    """Equations, one a line."""
    notes: str
    """Meaning of symbols that the table of variables does not explain."""
    source: str = ""
    """Author, year, title and equation numbers."""


ADAPTIVE = " What an estimator finds is an input here, and used from a step on at which update_ready is true."
"""Text that an adaptive controller adds to the notes of the controller."""
