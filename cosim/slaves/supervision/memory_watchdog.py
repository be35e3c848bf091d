"""A look at an FMU's process from time to time, while the thread that steps it waits for an answer.

An FMU that takes ever more memory is ended before the whole machine suffers. One that has died is told to who waits,
even where a child of it has inherited the channel and keeps it open.
"""

import os
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final

from ..channel import Channel

PERIOD_S: Final = 0.05
"""Between two looks [s]; in it a process can touch about 100 MB."""
_MB: Final = 1e6


def half_of_memory() -> float:
    """Half of this machine's memory [MB]."""
    if sys.platform == "win32":
        return float("inf")
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2 / _MB


class Watch:
    """A thread that looks after one process, the leader of its group, until `end`. Elsewhere than on Linux: nothing."""

    def __init__(self, process_id: int, channel: Channel, memory_limit: float) -> None:
        """memory_limit: resident memory that the process may have [MB]."""
        self.reason: str | None = None
        """Why the process has been ended, in words that follow "the FMU's process"."""
        self._id, self._channel, self._limit = process_id, channel, memory_limit
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._look, name=f"watch of {process_id}", daemon=True)
        if sys.platform == "linux":
            self._thread.start()

    def end(self) -> None:
        """Look no more; idempotent. To be called before the process is buried: its id may be another's then."""
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
                    self._channel.hang_up()
                    return
