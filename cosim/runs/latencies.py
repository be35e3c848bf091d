"""Wall times of a run's evaluations."""

from array import array
from collections.abc import Sequence
from itertools import islice
from typing import Final

_DIGITS: Final = 7


class Latencies:
    """Wall times of evaluations, stored compactly: an hour's tuples would take 30 MB."""

    def __init__(self) -> None:
        self._seconds, self._counts = array("d"), array("L")
        self._stretches: list[tuple[int, int]] = []

    def append(self, k: int, seconds: Sequence[float]) -> None:
        """Append the wall times of macro step k [s], if there are any."""
        if seconds:
            self._seconds.extend(seconds)
            self._counts.append(len(seconds))
            first, last = self._stretches.pop() if self._stretches else (k, k)
            self._stretches += [(first, k)] if last >= k - 1 else [(first, last), (k, k)]

    def by_step(self) -> tuple[tuple[float, ...], ...]:
        """Return the wall time of each evaluation [s], to 0.1 us, a tuple for each macro step that had any."""
        seconds = (round(s, _DIGITS) for s in self._seconds)
        return tuple(tuple(islice(seconds, n)) for n in self._counts)

    def stretches(self) -> tuple[tuple[int, int], ...]:
        """Return which macro steps these are: first and last number of each stretch without a gap."""
        return tuple(self._stretches)
