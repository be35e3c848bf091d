"""Tables and figures as text, for a terminal."""

from collections.abc import Sequence
from math import floor, isfinite, log10


def with_std(value: float, std: float) -> str:
    """Return `1.3000 ± 0.0012`, with digits enough for two significant ones of the standard deviation."""
    if not (isfinite(std) and std > 0.0):
        return f"{value:.6g}"
    digits = 1 - floor(log10(std))
    if digits > 7 or max(abs(value), std) >= 1e6:
        return f"{value:.{max(1, digits + floor(log10(abs(value) or 1.0)) + 1)}g} ± {std:.2g}"
    return f"{value:.{max(digits, 0)}f} ± {std:.{max(digits, 0)}f}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table, the first column aligned left and the others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    ]


def counted(n: int, noun: str) -> str:
    """Return a count with its noun: `1 episode`, `2 episodes`."""
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
