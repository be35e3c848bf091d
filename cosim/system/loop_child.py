"""The program of the process of a closed loop of shadows: all its FMUs, stepped here; `loop_process` asks for it."""

import logging
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import monotonic
from typing import Any, Final, NoReturn

from ..errors import CosimError, ScenarioError, SlaveError
from ..fmi.table import TableSlave, is_table
from ..slaves.channel import ALIVE, RESULT, Channel, decode, encode
from ..slaves.child import run
from ..slaves.log_lines import LogSender
from ..slaves.slave import Slave, open_slave
from ..slaves.supervision.supervised_child import SupervisedChild
from .loop_plan import LoopPlan, name_and_state, wiring_of
from .shadow_loop import Course, ShadowLoop

_OFTEN: Final = 0.1
"""Share of an FMU's time limit after which it is said again that its calls return."""


def main(channel_argument: str) -> NoReturn:
    """Serve one loop to the process that started this one."""
    run(channel_argument, _serve)


def _serve(channel: Channel, process: SupervisedChild) -> None:
    """Answer requests until the loop is closed: each with [value, None], or [None, what was raised]."""
    plan = LoopPlan(*decode(channel.receive(None))[0])
    process.end_with_parent(plan.folder)
    channel.send(encode(RESULT, None))
    log = _Forwarder(LogSender(channel))
    logging.getLogger("cosim").addHandler(log)
    with ExitStack() as stack:
        served = _Served(plan, _alive(channel, plan.timeout), stack)
        opened = served.answer("open", (), None)  # now, while the other process goes on
        while True:
            (function, arguments), blob = decode(channel.receive(None))
            log.sender.call_begins()
            if function == "close":
                stack.close()
                channel.send(encode(RESULT, [None, None]))
                return
            channel.send(encode(RESULT, opened if function == "open" else served.answer(function, arguments, blob)))


class _Served:
    """The loop of this process, once it is open."""

    def __init__(self, plan: LoopPlan, alive: Callable[[], None], stack: ExitStack) -> None:
        self._plan, self._alive, self._stack = plan, alive, stack
        self._loop: ShadowLoop | None = None
        self._states: dict[str, bytes] = {}

    def answer(self, function: str, arguments: Sequence[Any], blob: bytes | None) -> list[Any]:
        """Return the answer to a request: [value, None] or [None, [...]]."""
        try:
            return [self._do(function, arguments, blob), None]
        except SlaveError as e:
            return [None, [e.instance, e.function, e.time, e.reason, e.form]]
        except CosimError as e:
            return [None, [type(e).__name__, str(e)]]

    def _do(self, function: str, arguments: Sequence[Any], blob: bytes | None) -> float | None:
        if function == "open":
            self._loop = self._opened()
        elif self._loop is None:
            raise ValueError(f"{function} of a loop that is not open")
        elif function == "prove":
            self._loop.prove()
        elif function == "state":
            name, self._states[name] = name_and_state(blob or b"")
        elif function == "restore":
            self._loop.restore(self._states, arguments[0])
        elif function == "peak":
            return self._loop.peak(Course(*arguments))
        else:
            raise ValueError(f"no such call: {function!r}")
        return None

    def _opened(self) -> ShadowLoop:
        plan = self._plan
        sys.dont_write_bytecode = not plan.folders
        tempfile.tempdir = plan.folder  # which the other process removes, whatever becomes of this one
        try:
            shadows = {name: self._shadow(name, Path(path)) for name, path in plan.paths.items()}
        finally:
            tempfile.tempdir = None
        wiring = {name: wiring_of(values) for name, values in plan.wiring.items()}
        return ShadowLoop(shadows, wiring, plan.groups, plan.tracked, (plan.span[0], plan.span[1]))

    def _shadow(self, name: str, path: Path) -> Slave | TableSlave:
        plan, label = self._plan, f"{name} ({self._plan.instance_name})"
        if is_table(path):
            return TableSlave(path, label)
        try:
            slave = open_slave(
                path, label, isolation="none", out_of_range=plan.out_of_range, tolerance=plan.tolerances[name],
                after_call=self._alive, is_checked=True, unpacked_in=plan.folders.get(name),
            )  # fmt: skip
        except SlaveError:
            raise
        except CosimError as e:  # it could be opened before: the disk is full, or the file has gone
            raise ScenarioError(f"the loop cannot be {plan.instance_name}: {e}") from e
        return self._stack.enter_context(slave)


class _Forwarder(logging.Handler):
    """Handler that sends what is logged here, as an FMU's process does."""

    def __init__(self, sender: LogSender) -> None:
        super().__init__(logging.INFO)
        self.sender = sender

    def emit(self, record: logging.LogRecord) -> None:
        self.sender(1 if record.levelno >= logging.WARNING else 0, record.getMessage())


def _alive(channel: Channel, timeout_s: float) -> Callable[[], None]:
    """Return a function, called after each call of an FMU, that says so from time to time: no single one has hung."""
    last = monotonic()

    def said() -> None:
        nonlocal last
        now = monotonic()
        if now - last > _OFTEN * timeout_s:
            last = now
            channel.send(bytes([ALIVE]))

    return said
