"""A thread that checks an FMU's process periodically, while another waits for an answer from it.

An FMU that takes ever more memory is ended before the whole machine suffers. Its death is reported to the waiting
thread, even if a child of it has inherited the channel and keeps it open.
"""

import os
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

PERIOD_S: Final = 0.05
"""Time between two checks [s], in which a process can touch about 100 MB."""
_MB: Final = 1e6


def half_of_memory() -> float:
    """Return half of this machine's memory [MB]."""
    if sys.platform == "win32":
        return float("inf")
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2 / _MB


class MemoryWatchdog:
    """A thread that watches one process, the leader of its group, until `end`; on Linux only."""

    def __init__(self, process_id: int, on_death: Callable[[], None], memory_limit: float) -> None:
        """memory_limit: resident memory that the process may have [MB]; on_death: called once it has ended."""
        self.reason: str | None = None
        """Reason why the process has been ended, in words that follow "the FMU's process"."""
        self._id, self._on_death, self._limit = process_id, on_death, memory_limit
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._look, name=f"memory watchdog of {process_id}", daemon=True)
        if sys.platform == "linux":
            self._thread.start()

    def end(self) -> None:
        """Stop watching; idempotent. To be called before the process is waited for: its id may be another's then."""
        self._is_over.set()
        if self._thread.is_alive():
            self._thread.join()

    def _look(self) -> None:
        statm = Path(f"/proc/{self._id}/statm")
        page = os.sysconf("SC_PAGE_SIZE")
        while not self._is_over.wait(PERIOD_S):
            with suppress(OSError):
                used = int(statm.read_text().split()[1]) * page / _MB
                if used > self._limit:
                    self.reason = f"took {used:.0f} MB of memory, more than its limit of {self._limit:.0f} MB,"
                    os.killpg(self._id, signal.SIGKILL)
            with suppress(OSError):
                if os.waitid(os.P_PID, self._id, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
                    self._on_death()
                    return
