"""An FMU's process under supervision, seen from the one that starts it: its output, memory, cores, children and end."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from io import RawIOBase
from math import inf
from time import perf_counter
from typing import IO, Any, Protocol

from ..boot import boot_command
from ..channel import ChildEnd
from .descendants import end_marked, new_mark
from .environment import variables
from .fork_server import forked
from .memory_watchdog import MemoryWatchdog, half_of_memory
from .output import OutputRelay
from .placement import REVIEW, Placement, same_addresses


class SupervisedProcess:
    """A process that runs an FMU.

    1. SupervisedProcess      starts it; what it prints is passed on, and the memory that it holds is watched
    2. step_begins, step_is_asked_for, step_has_ended      for every step: where the process runs
    3. how_it_ended           once it no longer answers
    4. wait, end              the process, its group and, after a fault, all that it has started
    """

    def __init__(
        self,
        name: str,
        program: str,
        end: ChildEnd,
        memory_limit: float,
        on_death: Callable[[], None],
        environment: Sequence[str],
    ) -> None:
        """program: module whose main is called with the end of a channel; end: that end.

        memory_limit: resident memory that it may have [MB], 0 for half of the machine's (Linux).
        on_death: called, in another thread, when the process has ended by itself.
        environment: names of variables that it is given beside those which every FMU is given.
        """
        self.has_ended = False
        self._mark = new_mark()
        self._output = OutputRelay(name)
        try:
            self._process = _start(program, end, variables(environment, self._mark), self._output.descriptor)
        except BaseException:
            self._output.abandon()
            raise
        self._output.start()
        self._watchdog = MemoryWatchdog(self._process.pid, on_death, memory_limit or half_of_memory())
        self._placement = Placement(self._process.pid)
        self._n_steps, self._begun, self._shortest_s = 0, 0.0, 0.0

    def step_begins(self) -> None:
        """Choose where the process runs, before a step is asked for."""
        if self._n_steps % REVIEW == 0:
            self._placement.review(self._shortest_s)
            self._shortest_s = inf
        self._n_steps += 1
        self._placement.follow()
        self._begun = perf_counter()

    def step_is_asked_for(self) -> None:
        """Let the process run, before its answer is waited for."""
        self._placement.let_run()

    def step_has_ended(self) -> None:
        """Record the time that the step has taken."""
        self._shortest_s = min(self._shortest_s, perf_counter() - self._begun)

    def how_it_ended(self, timeout_s: float) -> str:
        """Return how the process ended, in words that follow "the FMU's process"."""
        self._watchdog.end()
        try:
            ending = _ending(self._process.wait(timeout_s))
        except subprocess.TimeoutExpired:
            ending = "closed its channel"
        return self._watchdog.reason or ending

    def wait(self, timeout_s: float) -> None:
        """Wait until the process ends by itself, but no longer than timeout_s [s]."""
        self._watchdog.end()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def end(self, with_descendants: bool = False) -> None:
        """End the process and its group by force; idempotent.

        with_descendants: also what it has started in sessions of their own.
        """
        if self.has_ended:
            return
        self.has_ended = True
        self._watchdog.end()
        if sys.platform == "win32":
            self._process.kill()
        else:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._output.wait()
        if with_descendants:
            end_marked(self._mark)


class _Process(Protocol):
    """The part of subprocess.Popen that is needed here."""

    pid: int

    @property
    def stdin(self) -> IO[bytes] | RawIOBase | None: ...

    def wait(self, timeout: float | None = None) -> int: ...
    def kill(self) -> None: ...


def _start(program: str, end: ChildEnd, environment: Mapping[str, str], output: int) -> _Process:
    """Start the process in a group of its own, so that Ctrl-C does not reach it."""
    if (process := forked(program, end, environment, output)) is not None:
        return process
    group: dict[str, Any] = {} if sys.platform == "win32" else {"process_group": 0}
    with same_addresses():
        return subprocess.Popen[bytes](
            boot_command(program, end.argument),  # not a fork of this process, which has threads
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=output,
            env=environment,
            **group,
            **end.popen_arguments(),
        )


def _ending(code: int) -> str:
    """Return the meaning of an exit code of subprocess, in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
