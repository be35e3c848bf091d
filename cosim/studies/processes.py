"""Processes of this machine that calls are made in, several at a time: a `concurrent.futures.Executor`.

Where a process dies only its own call is lost: those of the standard library and of loky break as a whole then, and
leave a process that tracks resources until the program ends; the former also run the user's script once more. A process
ends with the one that has started it, however that ends, and so do the FMUs that it runs.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from typing import Any, Final, NoReturn, ParamSpec, TypeVar

from .. import former_names
from ..blas_threads import ONE_THREAD
from ..fmi.folder import PrivateFolder, folders_kept, remove_tree
from ..slaves.boot import boot_command
from ..slaves.channel import Channel, channel_pair, open_channel
from ..slaves.supervision.fork_server import forked_processes
from ..warnings_log import warnings_logged

CLOSE_TIMEOUT_S: Final = 10.0
"""Time for an interrupted call to end its FMUs."""

_P = ParamSpec("_P")
_T = TypeVar("_T")


class LocalProcesses(Executor):
    """Processes that make calls, each waited for by a thread of its own. Leaving the context ends them at once."""

    def __init__(self, jobs: int) -> None:
        self._threads = ThreadPoolExecutor(jobs)
        self._own = threading.local()
        self._lock = threading.Lock()
        self._processes: set[_WorkerProcess] = set()
        self._is_closed = False

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> "Future[_T]":
        """Make a call in a process. Its future raises BrokenExecutor where that process has died."""
        return self._threads.submit(self._in_process, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End all processes, whatever they are doing, and their FMUs."""
        with self._lock:
            self._is_closed = True
            processes = list(self._processes)
        self._threads.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.interrupt()
        for process in processes:
            process.wait()
        self._threads.shutdown(wait=True)
        for process in processes:
            process.close()

    def _in_process(self, fn: Callable[..., _T], /, *args: Any, **kwargs: Any) -> _T:
        """Make a call in the process of this thread; a process that has died is followed by another."""
        process: _WorkerProcess | None = getattr(self._own, "process", None)
        if process is None:
            with self._lock:
                if self._is_closed:
                    raise BrokenExecutor("the processes have been ended")
                process = self._own.process = _WorkerProcess()
                self._processes.add(process)
        try:
            return process.call(fn, *args, **kwargs)
        except BrokenExecutor:
            del self._own.process
            with self._lock:
                is_ours = not self._is_closed
                self._processes.discard(process)
            if is_ours:
                process.close()
            raise


class _WorkerProcess:
    """A process that makes one call after the other. `main` ends when its standard input is closed."""

    def __init__(self) -> None:
        self._temporary = PrivateFolder()  # an interrupt may come before FMUs clear up theirs
        temporary = self._temporary.path
        self._channel, theirs = channel_pair()
        group: dict[str, Any] = {} if sys.platform == "win32" else {"process_group": 0}  # Ctrl-C is not for it
        try:
            self._process = subprocess.Popen[bytes](
                boot_command(__name__, theirs.argument, temporary),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                env=os.environ | ONE_THREAD | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), temporary),
                **group,
                **theirs.popen_arguments(),
            )
        except BaseException:
            self._channel.close()
            self._temporary.remove()
            raise
        finally:
            theirs.close()

    def call(self, fn: Callable[..., _T], /, *args: Any, **kwargs: Any) -> _T:
        """Return what the call returns, or raise what it raises. Raises BrokenExecutor where the process has died."""
        try:
            self._channel.send(pickle.dumps((fn, args, kwargs)))
            outcome = self._channel.receive(None)
        except (EOFError, OSError) as e:
            self.interrupt()
            self.wait()
            raise BrokenExecutor(f"its process has ended with exit code {self._process.returncode}") from e
        is_raised, value = pickle.loads(outcome)  # of our own child
        if is_raised:
            raise value
        return value

    def interrupt(self) -> None:
        """Make the process end, with its FMUs, whatever it is doing."""
        if self._process.stdin is not None:
            self._process.stdin.close()

    def wait(self) -> None:
        """Wait for the process to end; kill it after CLOSE_TIMEOUT_S."""
        try:
            self._process.wait(CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def close(self) -> None:
        """Close our end of the channel, once no thread waits there, and remove the temporary folder."""
        self._channel.close()
        self._temporary.remove()


def main(channel_argument: str, temporary: str) -> NoReturn:
    """Make the calls that the parent requests, in a process of its own, until its standard input ends.

    temporary: the folder made for it and its calls, which it removes at the end: its parent may have ended.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)
    channel = open_channel(channel_argument)
    lifeline = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    former_names.LOG.disabled = True  # the parent has logged them
    with contextlib.suppress(KeyboardInterrupt):  # it may come where the channel's end has been seen already
        with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
            threading.Thread(target=_interrupt_at_end_of, args=(lifeline,), daemon=True).start()
            _make_calls(channel)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    remove_tree(temporary)
    os._exit(0)


def _make_calls(channel: Channel) -> NoReturn:
    with warnings_logged(), folders_kept(), forked_processes():
        while True:
            channel.send(_outcome(channel.receive(None)))


def _outcome(call: bytes) -> bytes:
    """Return the pickled outcome of a pickled call: whether it raised, and what it raised or returned."""
    try:
        fn, args, kwargs = pickle.loads(call)  # of our own parent
        return pickle.dumps((False, fn(*args, **kwargs)))
    except Exception as e:
        try:
            return pickle.dumps((True, e))
        except Exception:  # its content cannot be sent
            return pickle.dumps((True, RuntimeError(f"{type(e).__name__}: {e}")))


def _interrupt_at_end_of(lifeline: int) -> None:
    while os.read(lifeline, 1):
        pass
    if sys.platform == "win32":
        os._exit(130)
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # cuts a wait for an FMU short


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt
