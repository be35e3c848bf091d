"""A server that FMUs' processes are forked from, for many of them one after the other: Python starts but once.

    with forked_processes():        # within it, and in this thread, SupervisedProcess takes them from here
        ...

A fresh interpreter takes 60 ms to start and to import what serves an FMU; a copy of one that has done so, 3 ms. It
starts while the caller goes on. No FMU has been loaded where the copies come from, so that none finds anything of an
earlier one. A copy is made twice over, so
that the kernel hands it to this process: it is a child of ours, like one that we have started. It begins when it is
told to, which follows once it is known here. Linux only.
"""

import ctypes
import json
import os
import select
import socket
import subprocess
import sys
import threading
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import RawIOBase
from typing import Any, Final

from ..boot import boot_command
from ..channel import ChildEnd
from .descendants import NO_MARK, VARIABLE
from .environment import variables
from .fork_server_child import GO
from .placement import same_addresses

_START_TIMEOUT_S: Final = 60.0
_PR_SET_CHILD_SUBREAPER: Final = 36
_PR_GET_CHILD_SUBREAPER: Final = 37
_SERVERS: Final[ContextVar["ForkServers | None"]] = ContextVar("fork servers", default=None)
_ADOPTION: Final = threading.Lock()  # it is a property of the whole process


@contextmanager
def forked_processes(environment: Sequence[str] | None = None) -> Generator[None]:
    """Take FMUs' processes from servers in this context, which run until its end; where there are none it does nothing.

    environment: names of the variables of those for which a server begins to start now; None for none. Within another
    such context the servers are those of that one. Nothing but time depends on it.
    """
    if not _is_possible():
        yield
        return
    outer = _SERVERS.get()
    servers = outer if outer is not None and outer.are_ours else ForkServers()
    token = _SERVERS.set(servers)
    try:
        if environment is not None:
            servers.begin(variables(environment, NO_MARK))
        yield
    finally:
        _SERVERS.reset(token)
        if servers is not outer:
            servers.close()


def forked(program: str, end: ChildEnd, environment: Mapping[str, str], output: int) -> "ForkedProcess | None":
    """Return a new process of this context's server for a program; None where it has none.

    end: its end of the channel; output: descriptor of its standard error.
    """
    servers = _SERVERS.get()
    return None if servers is None or not end.is_packet else servers.process(program, end, environment, output)


class ForkServers:
    """The servers of one process, one for each environment, started on first use."""

    def __init__(self) -> None:
        self._owner = os.getpid()
        self._lock = threading.Lock()
        self._servers: dict[str, _ForkServer] = {}

    @property
    def are_ours(self) -> bool:
        """False in a fork of the process that has started them, whose requests would mix with its own."""
        return os.getpid() == self._owner

    def begin(self, environment: Mapping[str, str]) -> None:
        """Begin to start the server of processes with this environment, whatever their mark is."""
        with self._lock, suppress(OSError):
            self._server(environment)

    def process(
        self, program: str, end: ChildEnd, environment: Mapping[str, str], output: int
    ) -> "ForkedProcess | None":
        """Return a new process; None where the server has died or does not answer."""
        if not self.are_ours:
            return None
        with self._lock:
            try:
                return self._server(environment).process(program, end, environment[VARIABLE], output)
            except BaseException as error:  # its answer may still come: whoever asks next would take it for theirs
                if (server := self._servers.pop(_key(environment), None)) is not None:
                    server.close()
                if isinstance(error, OSError | ValueError):
                    return None
                raise

    def _server(self, environment: Mapping[str, str]) -> "_ForkServer":
        """Return the server of processes with this environment. Raises OSError."""
        key = _key(environment)
        if key not in self._servers:
            self._servers[key] = _ForkServer({**environment, VARIABLE: NO_MARK})
        return self._servers[key]

    def close(self) -> None:
        """End the servers; processes that they have made go on."""
        if self.are_ours:
            for server in self._servers.values():
                server.close()
        self._servers.clear()


def _key(environment: Mapping[str, str]) -> str:
    """Return what tells a server from others."""
    return json.dumps([{**environment, VARIABLE: NO_MARK}, sys.path])


class _ForkServer:
    """One server: an interpreter that has imported what serves an FMU, and copies itself."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_START_TIMEOUT_S)
        with theirs, same_addresses():
            self._process = subprocess.Popen[bytes](
                boot_command("cosim.slaves.supervision.fork_server_child", str(theirs.fileno())),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=dict(environment),
                process_group=0,
                pass_fds=(theirs.fileno(),),
            )

    def process(self, program: str, end: ChildEnd, mark: str, output: int) -> "ForkedProcess":
        """Return a copy of the server that serves a program. Raises OSError, ValueError."""
        theirs, ours = os.pipe()
        lifeline = os.fdopen(ours, "wb", buffering=0)
        try:
            order = json.dumps([program, mark, _working_folder()]).encode()
            with _children_adopted():
                socket.send_fds(self._socket, [order], [theirs, end.handle, output])
                pid = int(self._socket.recv(64))
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # raises OSError if it is no child of ours
            process = ForkedProcess(pid, lifeline)
            lifeline.write(GO)
            return process
        except BaseException:
            lifeline.close()  # it ends then, and has not touched the channel
            raise
        finally:
            os.close(theirs)

    def close(self) -> None:
        self._socket.close()
        self._process.kill()
        self._process.wait()


class ForkedProcess:
    """A child process that a server has made, with the part of subprocess.Popen that is needed here."""

    def __init__(self, pid: int, stdin: RawIOBase) -> None:
        """stdin: writing end of its standard input."""
        self.pid = pid
        self.stdin: RawIOBase | None = stdin
        self._code: int | None = None

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code, or less a signal's number. Raises subprocess.TimeoutExpired after timeout [s]."""
        if self._code is None:
            if timeout is not None and not self._ends_within(timeout):
                raise subprocess.TimeoutExpired("an FMU's process", timeout)
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code

    def kill(self) -> None:
        if self._code is None:
            with suppress(ProcessLookupError):
                os.kill(self.pid, 9)

    def _ends_within(self, timeout_s: float) -> bool:
        descriptor = os.pidfd_open(self.pid)
        try:
            poll = select.poll()
            poll.register(descriptor, select.POLLIN)
            return bool(poll.poll(timeout_s * 1000))
        finally:
            os.close(descriptor)


@contextmanager
def _children_adopted() -> Generator[None]:
    """Become the parent of descendants whose parents end in this context."""
    libc: Any = ctypes.CDLL(None)
    before = ctypes.c_int(0)
    with _ADOPTION:
        libc.prctl(_PR_GET_CHILD_SUBREAPER, ctypes.byref(before), 0, 0, 0)
        libc.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        try:
            yield
        finally:
            libc.prctl(_PR_SET_CHILD_SUBREAPER, before.value, 0, 0, 0)


def _working_folder() -> str | None:
    with suppress(OSError):  # it has been removed
        return os.getcwd()
    return None


def _is_possible() -> bool:
    if sys.platform != "linux" or not hasattr(os, "pidfd_open"):
        return False
    try:
        os.close(os.pidfd_open(os.getpid()))
    except OSError:  # a kernel before 5.3, or a container that forbids it
        return False
    return True
