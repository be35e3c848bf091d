"""An FMU in its own process, seen from this one: child.py is what runs there.

What the FMU does there (prints, exits, crashes, hangs, corrupts its interpreter) cannot harm this process.
"""

import contextlib
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Sequence
from math import inf
from pathlib import Path
from time import monotonic, perf_counter
from typing import Any, Final

from ..blas_threads import ONE_THREAD
from ..errors import COLON, IN_THE_CALL, SlaveError, one_line
from ..fmi.fmi2_co_simulation import Identity
from ..fmi.fmu_log import pass_on
from ..fmi.value_buffers import Variable
from .channel import CALL, FAULT, KIND, LOG, RESULT, VALUES, StepCodec, channel_pair, decode, encode
from .supervision.descendants import VARIABLE, end_marked, new_mark
from .supervision.memory_watchdog import Watch, half_of_memory
from .supervision.output import Output
from .supervision.placement import REVIEW, Placement, same_addresses

START_TIMEOUT_S: Final = 60.0
"""For Python itself to start and import, however busy the machine; the FMU's own calls have their own limit."""
MOST_LINES: Final = 1000
"""Lines of one FMU's log that are passed on."""
CLOSE_TIMEOUT_S: Final = 2.0
"""For an FMU to terminate politely, and for its process to end."""

# cosim may be importable only because of this process's sys.path; -P keeps the working directory out of it.
_BOOT: Final = """
import sys
root, channel, *path = sys.argv[1:]
sys.path += [folder for folder in path if folder not in sys.path]
sys.path.insert(0, root)
from cosim.slaves.child import main
sys.path.remove(root)
main(channel)
"""


class Worker:
    """The handle of an FMU's process.

    Loading starts with the constructor and is waited for in the first call, so several FMUs load at the same time.
    Every method but close may raise SlaveError; the process has been killed then, and only close may follow.
    """

    def __init__(self, identity: Identity, timeout_s: float, kind: str = KIND, memory_limit: float = 0.0) -> None:
        """timeout_s is the time each call may take [s]; kind is that of channel_pair.

        memory_limit: resident memory that the process may have [MB], 0 for half of the machine's (Linux).
        """
        self._name = identity.instance_name
        self._timeout_s = timeout_s
        self._codec = StepCodec(0, 0, 0)
        self._is_loaded = False
        self._is_answer_due = False
        self._is_ended = False
        self._lines: list[tuple[int, str]] = []
        self._n_lines = 0
        self._mark = new_mark()
        self._output = Output(self._name)
        self._channel, theirs = channel_pair(kind)
        try:
            self._process = _start(theirs.argument, self._mark, self._output.descriptor, theirs.popen_arguments())
        except BaseException:
            self._channel.close()
            self._output.abandon()
            raise
        finally:
            theirs.close()
        self._output.start()
        self._watch = Watch(self._process.pid, self._channel, memory_limit or half_of_memory())
        self._placement = Placement(self._process.pid)
        self._n_steps, self._begun, self._shortest_s = 0, 0.0, 0.0
        self._send("instantiate", None, encode(CALL, list(identity)))

    def bind(self, inputs: Sequence[Variable], tunables: Sequence[Variable], outputs: Sequence[Variable]) -> None:
        """Instance.bind."""
        self.call("bind", None, inputs, tunables, outputs)
        self._codec = StepCodec(len(inputs), len(tunables), len(outputs))

    def call(self, function: str, t: float | None, *arguments: object) -> Any:
        """The method of Instance of that name, t [s] being where the FMU stands; bytes must be the only argument."""
        self._wait_until_loaded()
        blob = arguments[0] if arguments and isinstance(arguments[0], bytes) else None
        self._send(function, t, encode(CALL, [function, () if blob is not None else arguments], blob))
        answer = self._receive(function, t, RESULT, self._timeout_s)
        try:
            value, blob = decode(answer)
        except ValueError as error:
            raise self._nonsense(function, t) from error
        return value if blob is None else blob

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        """Start Instance.step."""
        if self._n_steps % REVIEW == 0:
            self._placement.review(self._shortest_s)
            self._shortest_s = inf
        self._n_steps += 1
        self._placement.follow()
        self._begun = perf_counter()
        self._send("do_step", t, self._codec.encode_step(t, h, inputs, tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        """Wait for what Instance.step returns."""
        self._placement.let_run()
        message = self._receive("do_step", t, VALUES, self._timeout_s)
        self._shortest_s = min(self._shortest_s, perf_counter() - self._begun)
        try:
            return self._codec.decode_values(message)
        except struct.error as error:
            raise self._nonsense("do_step", t) from error

    def close(self, t: float | None, is_polite: bool) -> None:
        """Terminate and free the FMU if that can still be asked for, then end its process; idempotent.

        Raises SlaveError when terminating fails; the process has ended even so.
        """
        try:
            if is_polite and self._is_loaded and not self._is_answer_due and not self._is_ended:
                self._timeout_s = min(self._timeout_s, CLOSE_TIMEOUT_S)
                self.call("close", t)
                self._watch.end()
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(CLOSE_TIMEOUT_S)
        finally:
            self._kill()

    def _wait_until_loaded(self) -> None:
        if not self._is_loaded:
            self._receive("start", None, RESULT, START_TIMEOUT_S)
            self._receive("instantiate", None, RESULT, self._timeout_s)
            self._is_loaded = True

    def _send(self, function: str, t: float | None, message: bytes) -> None:
        if self._is_answer_due:  # an exception, such as Ctrl-C, has cut the wait for it short
            raise RuntimeError(f"{self._name} must be closed: it has not answered to an earlier call.")
        self._is_answer_due = True
        try:
            self._channel.send(message)
        except OSError as error:
            raise self._death(function, t) from error

    def _receive(self, function: str, t: float | None, kind: int, timeout_s: float) -> bytes:
        try:
            message = self._channel.receive(timeout_s)
            if message[0] == LOG:
                message = self._after_lines(message, timeout_s)
        except TimeoutError as error:
            self._end_by_force()
            raise SlaveError(self._name, function, t, f"did not return within {timeout_s:g} s") from error
        except (EOFError, OSError) as error:
            raise self._death(function, t) from error
        except ValueError as error:
            raise self._nonsense(function, t) from error
        if message[0] != kind:
            raise self._fault(function, t, message)
        self._is_answer_due = False
        if self._lines:
            self._pass_on_lines()
        return message

    def _after_lines(self, message: bytes, timeout_s: float) -> bytes:
        """The first message that is no line of the FMU's log. Raises as Channel.receive, ValueError for nonsense."""
        deadline = monotonic() + timeout_s  # an FMU that logs without end does not put it off
        while message[0] == LOG:
            (status, text), _ = decode(message)
            self._lines.append((int(status), one_line(str(text))))
            message = self._channel.receive(timeout_s)
            if monotonic() > deadline:
                raise TimeoutError(f"no answer within {timeout_s} s")
        return message

    def _pass_on_lines(self, is_told: bool = False) -> None:
        """Log what the FMU has logged; is_told: the fault that it has caused says what matters."""
        for status, text in self._lines:
            self._n_lines += 1
            if self._n_lines == MOST_LINES:
                text = "(what it logs from here on is left out)"
            if self._n_lines <= MOST_LINES:
                pass_on(self._name, status, text, is_told)
        self._lines.clear()

    def _fault(self, function: str, t: float | None, message: bytes) -> SlaveError:
        """The error that the process has reported, in a message that is not to be trusted."""
        self._pass_on_lines(is_told=True)
        self._end_by_force()
        try:
            (its_function, its_t, reason, form), _ = decode(message)
            if message[0] == FAULT:
                t = t if its_t is None else float(its_t)
                return SlaveError(self._name, str(its_function or function), t, str(reason), form)
        except (ValueError, TypeError, OverflowError):
            pass
        return self._nonsense(function, t)

    def _nonsense(self, function: str, t: float | None) -> SlaveError:
        self._end_by_force()
        return SlaveError(self._name, function, t, "the FMU's process gave an answer of the wrong form", COLON)

    def _death(self, function: str, t: float | None) -> SlaveError:
        self._watch.end()
        try:
            how = _ending(self._process.wait(CLOSE_TIMEOUT_S))
        except subprocess.TimeoutExpired:
            how = "closed its channel"
        how = self._watch.reason or how
        self._end_by_force()
        return SlaveError(self._name, function, t, f"the FMU's process {how}", IN_THE_CALL)

    def _end_by_force(self) -> None:
        """After a fault: end the process and all that the FMU has started in its turn."""
        if not self._is_ended:
            self._kill()
            end_marked(self._mark)
            self._pass_on_lines()

    def _kill(self) -> None:
        """End the process and its group."""
        if self._is_ended:
            return
        self._is_ended = True
        self._watch.end()
        if sys.platform == "win32":
            self._process.kill()
        else:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._channel.close()
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._output.wait()


def _start(channel: str, mark: str, output: int, handles: dict[str, Any]) -> "subprocess.Popen[bytes]":
    """A fresh interpreter, not a fork: this process has threads. Its own process group: Ctrl-C is not for it."""
    root = str(Path(__file__).resolve().parents[2])
    group: dict[str, Any] = {} if sys.platform == "win32" else {"process_group": 0}
    with same_addresses():
        return subprocess.Popen[bytes](
            [sys.executable, "-u", "-P", "-c", _BOOT, root, channel, *filter(None, sys.path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=output,
            env=os.environ | ONE_THREAD | {VARIABLE: mark},
            **group,
            **handles,
        )


def _ending(code: int) -> str:
    """What an exit code of subprocess says, in words."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"was ended by signal {-code}"
