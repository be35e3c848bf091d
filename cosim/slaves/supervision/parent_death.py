"""Ending an FMU's process after the one that has started it, even where the FMU lets no other Python code run.

A Python FMU may keep the interpreter's lock for ever (a sum over a huge range, a call through ctypes.PyDLL): no thread
of ours gets its turn then. So the kernel does it. The parent keeps the other end of a pipe that is never written to.
When the last process that holds that end has ended, the kernel sends a signal, for which the C library's own `alarm` is
the handler; it takes the signal's number as seconds, after which SIGALRM ends the process, unless it has ended before.
"""

import ctypes
import os
import signal
import sys
from typing import Any


def end_after(parent_pipe: int) -> None:
    """End this process when the other end of parent_pipe is closed, after time to clean up: 10 s for most processors.

    To be called in the main thread. Linux; elsewhere it does nothing.
    """
    if sys.platform != "linux":
        return
    import fcntl

    libc: Any = ctypes.CDLL(None)
    libc.signal.argtypes = [ctypes.c_int, ctypes.c_void_p]
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM, signal.SIGUSR1})
    libc.signal(signal.SIGUSR1, ctypes.cast(libc.alarm, ctypes.c_void_p))
    fcntl.fcntl(parent_pipe, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(
        parent_pipe, fcntl.F_SETSIG, signal.SIGUSR1
    )  # not PR_SET_PDEATHSIG: that follows a thread, not a process
    fcntl.fcntl(parent_pipe, fcntl.F_SETFL, fcntl.fcntl(parent_pipe, fcntl.F_GETFL) | os.O_ASYNC)
