"""Processes that an FMU has started and left behind, found by a mark in their environment.

Most end with the FMU's process group. One with a session of its own (a daemon) has left the group and its parent, but
still has its environment. Linux only.
"""

import ctypes
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

VARIABLE: Final = "FMU_RETUNE_PROCESS"
NO_MARK: Final = "0" * 16
"""Mark of a process that runs no FMU."""
_PR_SET_CHILD_SUBREAPER: Final = 36
_MOST_LOOKS: Final = 20


def new_mark() -> str:
    """Return a mark for the environment of one FMU's process."""
    return os.urandom(8).hex()


def adopt_orphans() -> None:
    """Make this process the parent of descendants whose parents end, so that they can be found."""
    if sys.platform == "linux":
        libc: Any = ctypes.CDLL(None)
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def has_children() -> bool:
    """Return whether this process has any children, its own or adopted."""
    if sys.platform != "linux":
        return False
    with suppress(OSError):
        return any(task.joinpath("children").read_text() for task in Path("/proc/self/task").iterdir())
    return True


def end_marked(mark: str) -> None:
    """End every other process with this mark, those included that are started meanwhile."""
    if sys.platform != "linux":
        return
    entry, n_quiet = f"{VARIABLE}={mark}".encode(), 0
    for _ in range(_MOST_LOOKS):
        n_quiet = 0 if _ended_any(entry) else n_quiet + 1
        if n_quiet == 2:  # one that forks and exits may be between two names of a list
            return


def _ended_any(entry: bytes) -> bool:
    with suppress(OSError):  # no more files may be opened: the FMU has limited its process so
        return sum([_has_ended(int(name), entry) for name in os.listdir("/proc") if name.isdecimal()]) > 0
    return False


def _has_ended(process_id: int, entry: bytes) -> bool:
    """End a process if it is another one with this entry in its environment; return whether it was."""
    with suppress(OSError):
        environment = Path(f"/proc/{process_id}/environ").read_bytes()
        if entry in environment.split(b"\0") and process_id != os.getpid():
            os.kill(process_id, signal.SIGKILL)
            return True
    return False
