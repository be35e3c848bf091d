"""Calls that are made once more where the process of an FMU was killed from outside.

That is no fault of the FMU, as where the machine has run out of memory, and must change no result.
"""

from collections.abc import Callable
from typing import Final, TypeVar

from ..errors import SlaveError

KILLED: Final = "process was ended by SIGKILL"
"""Part of the reason of a fault that no FMU has by itself; one that takes too much memory has another."""

_T = TypeVar("_T")


def unless_killed(call: Callable[[], _T], forget: Callable[[], object]) -> _T:
    """Return what a call returns; made once more, after forget(), where the process that it uses was killed.

    forget: lets the next call start a new process. Raises what the call raises, SlaveError if it is killed twice.
    """
    try:
        return call()
    except SlaveError as fault:
        if KILLED not in fault.reason:
            raise
        forget()
        return call()
