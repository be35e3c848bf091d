"""Processes of one FMU that simulate in parallel. One whose FMU fails is ended, and another takes its place."""

from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from queue import SimpleQueue
from threading import Event
from time import perf_counter
from typing import Any, Final, Generic, NamedTuple, Protocol, Self, TypeVar

from ..errors import SlaveError
from ..fmi.trial_batch import BatchTrial, TrialBatch, TrialLeg, TrialOutputs
from ..slaves.killed import unless_killed
from ..slaves.slave import Slave

_TOGETHER_S: Final = 0.1
"""Time [s] that a batch of steps may take, so that the timeout of a call is hardly more than that of a step.
The results do not depend on it."""
_MOST_LOST: Final = 3
"""Messages without an answer after which roll-outs that renew an instance are sent one by one: its reset may crash."""

Result = TypeVar("Result")
Outputs = list[tuple[float, ...]]


class Outcome(NamedTuple, Generic[Result]):
    """The result of a task, or the reason why its FMU failed."""

    result: Result | None
    reason: str | None = None


class Rollable(Protocol):
    """A roll-out that can be sent with others."""

    @property
    def start(self) -> Mapping[str, Any]: ...
    @property
    def start_time(self) -> float: ...
    @property
    def stop_time(self) -> float: ...
    @property
    def state(self) -> bytes | None: ...
    @property
    def legs(self) -> Sequence[tuple[TrialLeg, Sequence[float] | None]]: ...
    @property
    def n_steps(self) -> int: ...
    def run(self, pool: "Pool", slave: Slave, is_new: bool) -> Outputs: ...


class Pool:
    """Pool of processes of one FMU. A context: leaving it ends them."""

    def __init__(self, opened: Callable[[], Slave], jobs: int, is_restartable: bool) -> None:
        """opened: makes a slave with its variables bound; is_restartable: it may be instantiated anew in its process.

        Nothing is started before it is needed.
        """
        self._opened, self._is_restartable = opened, is_restartable
        self._jobs, self._executor = jobs, ThreadPoolExecutor(jobs)
        self._room = 1  # steps that one message may have
        self._n_lost = 0  # messages that renew an instance, and have ended their process
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

    def simulate(self, rollouts: Sequence[Rollable]) -> list[Outcome[Outputs]]:
        """Return the outcome of each roll-out, several at a time.

        They begin in one state, or each in its own start values, and have the same legs but for the tunables. A
        process gets as many in a message as take a moment.
        """
        share = -(-len(rollouts) // self._jobs)
        parts = [rollouts[i : i + share] for i in range(0, len(rollouts), share)]
        futures = [self._executor.submit(self._simulated, part) for part in parts]
        return [outcome for future in futures for outcome in future.result()]

    def through(
        self,
        slave: Slave,
        times: Sequence[float],
        inputs: Sequence[Sequence[float]],
        tunables: Sequence[float] | None = None,
    ) -> Outputs:
        """Step a slave through, in batches of Slave.many_steps that take a moment each. Raises SlaveError."""
        outputs: Outputs = []
        taken = 0
        while taken < len(inputs) and not self._is_over.is_set():
            last = min(taken + self._room, len(inputs))
            with self._fitted(last - taken):
                outputs += slave.many_steps(times[taken : last + 1], inputs[taken:last], tunables)
            taken, tunables = last, None
        return outputs

    @contextmanager
    def _fitted(self, n_steps: int) -> Generator[None]:
        """Time a message of n steps; let the next have as many as take a moment."""
        began = perf_counter()
        yield
        took = perf_counter() - began
        if took < _TOGETHER_S and n_steps > self._room // 2:
            self._room *= 2
        elif took > 2.0 * _TOGETHER_S:
            self._room = max(1, self._room // 2)

    def _simulated(self, rollouts: Sequence[Rollable]) -> list[Outcome[Outputs]]:
        """Return the outcome of each roll-out of one process; one that fails has the message for itself."""
        outcomes: list[Outcome[Outputs]] = []
        alone = 0  # roll-outs that are sent one by one, since one of them ends the process
        while len(outcomes) < len(rollouts) and not self._is_over.is_set():
            rest = rollouts[len(outcomes) :]
            may_share = rest[0].state or (self._is_restartable and self._n_lost < _MOST_LOST)
            n = min(self._room // max(rest[0].n_steps, 1), len(rest)) if may_share else 0
            if n == 0 or alone:
                outcomes.append(self._one(partial(rest[0].run, self), is_renewed=rest[0].state is None))
                alone = max(alone - 1, 0)
                continue
            found = self._one(partial(self._sent, rest[:n]), is_renewed=False)  # which is done there
            if found.result is None:
                alone = n
                self._n_lost += rest[0].state is None
                continue
            rows, fault = found.result
            outcomes += [Outcome(row) for row in rows]
            if fault is not None and fault.function == "instantiate" and self._is_restartable:
                self._is_restartable = False  # whatever it declares, a process can have it once only
            elif fault is not None:
                outcomes.append(Outcome(None, str(fault)))
        return outcomes

    def _sent(self, rollouts: Sequence[Rollable], slave: Slave, is_new: bool) -> TrialOutputs:
        """Simulate them in one message; end the process of one that has failed."""
        first = rollouts[0]
        batch = TrialBatch(
            first.start_time, first.stop_time, first.state, is_new, [leg for leg, _ in first.legs],
            [BatchTrial((), [(i, tunables) for i, (_, tunables) in enumerate(r.legs)]) for r in rollouts],
        )  # fmt: skip
        with self._fitted(sum(r.n_steps for r in rollouts)):
            found = slave.trials(batch, [r.start for r in rollouts])
        if found.fault is not None:
            slave.close()
        return found

    def _one(self, task: Callable[[Slave, bool], Result], is_renewed: bool) -> Outcome[Result]:
        slave = self._idle.get()
        if is_renewed:
            slave = self._renewed(slave)
        is_new = is_renewed or slave is None

        def forget() -> None:
            nonlocal slave, is_new
            if slave is not None:
                slave.close()
            slave, is_new = None, True

        def done() -> Result:
            nonlocal slave
            slave = slave or self._opened()
            return task(slave, is_new)

        try:
            return Outcome(unless_killed(done, forget))
        except SlaveError as e:
            forget()
            return Outcome(None, str(e))
        finally:
            self._idle.put(None if slave is None or slave.is_closed else slave)

    def _renewed(self, slave: Slave | None) -> Slave | None:
        """Return a used slave as new, or None where it cannot be restarted."""
        if slave is None:
            return None
        if self._is_restartable:
            with suppress(SlaveError):  # if a new process fails too, the next roll-out reports it
                slave.restart()
                return slave
        slave.close()
        return None
