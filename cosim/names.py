"""Suggestions for misspelt names. Imports nothing heavy."""

from collections.abc import Iterable
from difflib import get_close_matches


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?` for the closest known name, or the empty string."""
    closest = close_match(name, known)
    return f"; did you mean '{closest}'?" if closest else ""


def close_match(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that is closest, or None: first one that differs in upper and lower case only."""
    names = list(known)
    same = next((other for other in names if other.casefold() == name.casefold()), None)
    return same or next(iter(get_close_matches(name, names, n=1)), None)
