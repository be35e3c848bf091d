"""Execution of many runs in processes of their own, several at a time."""

import contextlib
import os
import pickle
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final, NamedTuple, NoReturn

import numpy as np

from .. import former_names
from ..blas_threads import ONE_THREAD
from ..errors import CosimError, UnfinishedError, is_refusal, one_line
from ..fmi.folder import PrivateFolder
from ..runs.result import Run
from ..runs.simulation import run
from ..scenarios.scenario import Scenario
from ..slaves.channel import CALL, FAULT, RESULT, channel_pair, decode, encode, open_channel
from ..warnings_log import warnings_logged

CLOSE_TIMEOUT_S: Final = 10.0
"""Time for an interrupted run to end its FMUs."""

_BOOT: Final = """
import sys
root, channel, temporary, *path = sys.argv[1:]
sys.path += [folder for folder in path if folder not in sys.path]
sys.path.insert(0, root)
from cosim.campaigns.executor import serve
sys.path.remove(root)
serve(channel, temporary)
"""


class ExecutorError(CosimError):
    """Error for one of many runs, which was refused or could not be finished."""


class UnfinishedExecutorError(ExecutorError, UnfinishedError):
    """Error for one of many runs, which could not be finished: its process has died, or the disk is full."""


RunsProgress = Callable[[Mapping[str, Any], int, int], None]
"""Callback after each run: its record, the number of runs that have ended, and the number of all runs."""


class Task(NamedTuple):
    """A run to be made."""

    estimator: str
    """Name of the estimator."""
    seed: int
    """Seed of noise and search."""
    folder: str | None
    """Run folder, which is made for it; None where the run is not kept."""


class Executor:
    """Worker processes for runs, with a thread waiting for each. Leaving the context ends them and their FMUs."""

    def __init__(self, scenario: Scenario, tasks: Sequence[Task], jobs: int) -> None:
        self._tasks: SimpleQueue[Task] = SimpleQueue()
        self._results: SimpleQueue[tuple[Task, dict[str, Any] | ExecutorError]] = SimpleQueue()
        self._members: list[_Worker] = []
        self._threads: list[threading.Thread] = []
        for task in tasks:
            self._tasks.put(task)
        try:
            for _ in range(jobs):
                self._members.append(_Worker(scenario))
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> "Executor":
        self._threads = [threading.Thread(target=self._keep_busy, args=(m,), daemon=True) for m in self._members]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def next(self) -> tuple[Task, dict[str, Any]]:
        """Wait for the next run that ends; return its task and record. Raises ExecutorError."""
        while True:
            with contextlib.suppress(Empty):
                task, result = self._results.get(timeout=0.5)  # Windows looks for Ctrl-C between waits only
                break
        if isinstance(result, ExecutorError):
            raise result
        return task, result

    def _keep_busy(self, member: "_Worker") -> None:
        with contextlib.suppress(Empty):
            while True:
                task = self._tasks.get_nowait()
                try:
                    self._results.put((task, member.run(task)))
                except ExecutorError as e:
                    self._results.put((task, e))
                    return

    def _end(self) -> None:
        with contextlib.suppress(Empty):
            while True:
                self._tasks.get_nowait()
        for member in self._members:
            member.interrupt()
        for member in self._members:
            member.wait()
        for thread in self._threads:
            thread.join()
        for member in self._members:
            member.close()


class _Worker:
    """A process that makes one run after the other. `serve` ends when its standard input is closed."""

    def __init__(self, scenario: Scenario) -> None:
        root = str(Path(__file__).resolve().parents[2])
        self._temporary = PrivateFolder()  # an interrupt may come before FMUs clear up theirs
        temporary = self._temporary.path
        self._channel, theirs = channel_pair()
        group: dict[str, Any] = {} if sys.platform == "win32" else {"process_group": 0}  # Ctrl-C is not for it
        try:
            self._process = subprocess.Popen[bytes](
                [sys.executable, "-P", "-c", _BOOT, root, theirs.argument, temporary, *filter(None, sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                env=os.environ | ONE_THREAD | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), temporary),
                **group,
                **theirs.popen_arguments(),
            )
        except BaseException:
            self.close()
            raise
        finally:
            theirs.close()
        self._name = scenario.scenario.name
        self._scenario: bytes | None = pickle.dumps(scenario)

    def run(self, task: Task) -> dict[str, Any]:
        """Make a run and return its record. Raises ExecutorError, after which the process cannot be used."""
        try:
            self._channel.send(encode(CALL, task, self._scenario))  # the scenario with the first task only
            self._scenario = None
            answer = self._channel.receive(None)
        except (EOFError, OSError) as e:
            code = self._process.wait()
            reason = f"its process has ended with exit code {code}"
            raise UnfinishedExecutorError(f"{self._told(task)}: {reason}.") from e
        value, _ = decode(answer)
        if answer[0] == FAULT:
            why, was_refused = value
            raise (ExecutorError if was_refused else UnfinishedExecutorError)(f"{self._told(task)}: {why}")
        return value

    def _told(self, task: Task) -> str:
        return f"{self._name}, estimator {task.estimator}, seed {task.seed}"

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


def record_of(result: Run) -> dict[str, Any]:
    """Return the run's summary with further figures for a comparison, as JSON values."""
    references = [result.series[b] for b in result.scenario.tracking.values()]
    return {
        **result.summary(),
        "end": float(result.time[-1]) if len(result.time) else None,
        "reference_mean_square": [float(np.mean(r * r)) if len(r) else None for r in references],
        "latencies_ms": [[1e3 * s for s in step] for step in result.latencies],
    }


def serve(channel_argument: str, temporary: str) -> NoReturn:
    """Make the runs that the parent requests, in a worker process, until its standard input ends.

    temporary: the folder made for it and its runs, which it removes at the end: its parent may have ended.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _interrupt)
    channel = open_channel(channel_argument)
    lifeline = os.dup(0)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    scenario: Scenario | None = None
    former_names.LOG.disabled = True  # the parent has logged them
    try:
        threading.Thread(target=_interrupt_at_end_of, args=(lifeline,), daemon=True).start()
        with warnings_logged():
            while True:
                value, blob = decode(channel.receive(None))
                if blob is not None:
                    scenario = pickle.loads(blob)  # of our own parent
                if scenario is None:
                    raise ValueError("the first task must bring the scenario.")
                channel.send(_answer(scenario, Task(*value)))
    except (EOFError, OSError, KeyboardInterrupt):
        shutil.rmtree(temporary, ignore_errors=True)
    os._exit(0)


def _answer(scenario: Scenario, task: Task) -> bytes:
    """Return the encoded record of a run, or the reason why there is none and whether the run was refused."""
    folder = Path(task.folder) if task.folder else None
    try:
        if folder is not None:
            folder.mkdir()
        return encode(RESULT, record_of(run(scenario, task.estimator, task.seed, folder)))
    except Exception as e:
        why = str(e) if isinstance(e, CosimError) else f"{type(e).__name__}: {one_line(str(e))}."
        return encode(FAULT, [why, is_refusal(e)])
    finally:
        if folder is not None:
            with contextlib.suppress(OSError):
                folder.rmdir()  # of a run that was refused or ended before it had begun


def _interrupt_at_end_of(lifeline: int) -> None:
    while os.read(lifeline, 1):
        pass
    if sys.platform == "win32":
        os._exit(130)
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # cuts a wait for an FMU short


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt
