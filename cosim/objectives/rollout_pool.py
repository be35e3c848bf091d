"""Processes of one FMU that simulate in parallel. One whose FMU fails is ended, and another takes its place."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import SimpleQueue
from threading import Event
from time import perf_counter
from typing import Final, Generic, NamedTuple, Self, TypeVar

from ..errors import SlaveError
from ..slaves.slave import Slave

_TOGETHER_S: Final = 0.1
"""Time [s] that a batch of steps may take, so that the timeout of a call is hardly more than that of a step.
The results do not depend on it."""

Result = TypeVar("Result")
Outputs = list[tuple[float, ...]]


class Outcome(NamedTuple, Generic[Result]):
    """The result of a task, or the reason why its FMU failed."""

    result: Result | None
    reason: str | None = None


class Pool:
    """Pool of processes of one FMU. A context: leaving it ends them."""

    def __init__(self, opened: Callable[[], Slave], jobs: int, is_restartable: bool) -> None:
        """opened: makes a slave with its variables bound; is_restartable: it may be instantiated anew in its process.

        Nothing is started before it is needed.
        """
        self._opened, self._is_restartable = opened, is_restartable
        self._executor = ThreadPoolExecutor(jobs)
        self._is_over = Event()
        self._idle: SimpleQueue[Slave | None] = SimpleQueue()
        for _ in range(jobs):
            self._idle.put(None)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._executor.shutdown(cancel_futures=True)
        while not self._idle.empty():
            if (slave := self._idle.get()) is not None:
                slave.close()

    def map(self, tasks: Sequence[Callable[[Slave, bool], Result]], is_renewed: bool = True) -> list[Outcome[Result]]:
        """Return the outcome of each task, called with a slave and whether it is new; several run at a time.

        is_renewed: each task gets a slave that was never initialised.
        """
        futures = [self._executor.submit(self._one, task, is_renewed) for task in tasks]
        return [future.result() for future in futures]

    def through(
        self,
        slave: Slave,
        times: Sequence[float],
        inputs: Sequence[Sequence[float]],
        tunables: Sequence[float] | None = None,
    ) -> Outputs:
        """Step a slave through, in batches of Slave.many_steps that take a moment each. Raises SlaveError."""
        outputs: Outputs = []
        taken, room = 0, 1
        while taken < len(inputs) and not self._is_over.is_set():
            last, began = min(taken + room, len(inputs)), perf_counter()
            outputs += slave.many_steps(times[taken : last + 1], inputs[taken:last], tunables)
            taken, tunables = last, None
            if perf_counter() - began < _TOGETHER_S:
                room *= 2
        return outputs

    def _one(self, task: Callable[[Slave, bool], Result], is_renewed: bool) -> Outcome[Result]:
        slave = self._idle.get()
        if is_renewed:
            slave = self._renewed(slave)
        is_new = is_renewed or slave is None
        try:
            if slave is None:
                slave = self._opened()
            return Outcome(task(slave, is_new))
        except SlaveError as e:
            if slave is not None:
                slave.close()
                slave = None
            return Outcome(None, str(e))
        finally:
            self._idle.put(slave)

    def _renewed(self, slave: Slave | None) -> Slave | None:
        """Return a used slave as new, or None where it cannot be restarted."""
        if slave is None:
            return None
        if self._is_restartable:
            try:
                slave.restart()
                return slave
            except SlaveError:
                pass  # if a new process fails too, the next roll-out reports it
        slave.close()
        return None
