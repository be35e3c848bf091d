"""Cores of FMUs' processes: a fast one shares the core of the thread that waits for it, a slow one runs on any.

Waking a process on a core that sleeps costs 20 to 50 us (an interrupt, in a virtual machine an exit and an entry too),
on the core that goes to wait itself 2 us. Left alone, the scheduler chooses the sleeping core. FMUs that share a core
take turns; so those whose steps take longer than any waking-up may go where they run at the same time.
Nothing but time depends on it.
"""

import ctypes
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any, Final

REVIEW: Final = 64
"""Number of steps between two reviews of how long they take."""
SLOW_S: Final = 150e-6
"""Time [s] from which on a step is not worth a shared core; one of half of it is again."""

_libc: Any = ctypes.CDLL(None) if sys.platform == "linux" else None
_ASK, _NO_RANDOM_ADDRESSES = 0xFFFFFFFF, 0x0040000  # personality(2)


@contextmanager
def same_addresses() -> Generator[None]:
    """Lay out the memory of a process started in this context as that of every other such process.

    Processes that take turns on a core then share what its branch predictors have learnt of the interpreter; with
    addresses chosen at random three FMUs take twice as long. Where the system does not permit it, it stays like that.
    """
    before = _libc.personality(_ASK) if _libc is not None else -1
    if _libc is None or before == -1 or _libc.personality(before | _NO_RANDOM_ADDRESSES) == -1:
        yield
        return
    try:
        yield
    finally:
        _libc.personality(before)


class Placement:
    """The core that one FMU's process shares with the thread that waits for it, if any."""

    def __init__(self, process_id: int) -> None:
        self._process_id = process_id
        self._everywhere = os.sched_getaffinity(0) if sys.platform == "linux" else set[int]()
        self._core: int | None = None  # that they share now
        self._is_shared = len(self._everywhere) > 1

    def follow(self) -> None:
        """Move the process to the calling thread's core, if they are to share one; to be called before a step."""
        if self._is_shared and _libc is not None and (core := _libc.sched_getcpu()) != self._core:
            self._place({core})
            self._core = core

    def review(self, step_s: float) -> None:
        """Decide whether they share a core, given the shortest time of a step [s]."""
        is_shared = len(self._everywhere) > 1 and step_s < (SLOW_S if self._is_shared else SLOW_S / 2)
        if self._is_shared and not is_shared:
            self._place(self._everywhere)
            self._core = None
        self._is_shared = is_shared

    def let_run(self) -> None:
        """Let the process run before the calling thread waits for it; to be called after a step is requested.

        A thread that sleeps is woken on another, idle core; one that is only next in the queue stays.
        """
        if sys.platform == "linux" and self._core is not None:
            os.sched_yield()

    def _place(self, cores: set[int]) -> None:
        if sys.platform == "linux":
            with suppress(OSError):  # it has ended, which the next message shows
                os.sched_setaffinity(self._process_id, cores)
