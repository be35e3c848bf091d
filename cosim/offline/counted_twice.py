"""Rows of logs that a fit would count several times, as if they had been measured anew each time."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

from .log_windows import Cut
from .logs import LogError


def counted_twice(logs: Sequence[Path], cuts: Sequence[Cut], validation: Sequence[Path] = ()) -> list[str]:
    """Return a warning for each log that is given more than once. Raises LogError where parts of a log overlap.

    cuts: parts of each log to use; one may end where the next begins. validation: logs that are not fitted to.
    """
    for (begin, end), (following, last) in pairwise(sorted(cuts)):
        if following < end:
            raise LogError(
                f"--window {begin:g}:{end:g} and {following:g}:{last:g} overlap: their rows would count twice."
            )
    fitted = {path.resolve() for path in logs}
    repeated = {path: n for path, n in Counter(path.resolve() for path in logs).items() if n > 1}
    return [
        f"{path.name} is given {n} times: its rows count as if they had been measured so often, and ± is too small."
        for path, n in repeated.items()
    ] + [
        f"{path.name} is fitted to as well: what --validate shows of it is no check."
        for path in validation
        if path.resolve() in fitted
    ]
