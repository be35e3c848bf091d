"""Warnings about the states in which windows of a log start, where no column tells them."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import Final

from ..fmi.component import Component
from .log_windows import LogWindow

MOVING: Final = ("output", "local")
"""Causalities of variables that change while the FMU runs: with a start value, they are states."""


def start_warnings(
    component: Component,
    start: Mapping[str, str | float],
    sought: Sequence[str],
    own: Collection[str],
    windows: Sequence[LogWindow],
) -> list[str]:
    """Return a warning for each window that starts later than its log, and each estimated state that several share.

    start: columns or values by variable; sought: variables that are estimated; own: those with a value for each log.
    """
    states = [name for name in dict.fromkeys((*start, *sought)) if component.variables[name].causality in MOVING]
    but = f" but for {', '.join(states)}, given or estimated" if states else ""
    later = [w.name for w in windows if w.time[0] > w.origin and not w.start]
    shared = {name: _n_sharing(windows, name in own) for name in states if name in sought}
    return [
        *(f"{w}: it does not begin with the log, and starts in the FMU's own start state{but}." for w in later),
        *(
            f"{n} windows start with the same estimate of {name}; where they do not, give --start {name}=COLUMN in its "
            f"place, or each a log of its own and --own {name}."
            for name, n in shared.items()
            if n > 1
        ),
    ]


def _n_sharing(windows: Sequence[LogWindow], is_own: bool) -> int:
    """Return the number of windows that start with one value: all, or those of the log that has most."""
    return max(Counter(w.log for w in windows).values()) if is_own else len(windows)
