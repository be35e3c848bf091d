"""An FMU in its own process, seen from this one: child.py is what runs there.

What the FMU does there (prints, exits, crashes, hangs, corrupts its interpreter) cannot harm this process; what is done
about it is in supervision/.
"""

import struct
from collections.abc import Iterator, Sequence
from contextlib import suppress
from time import monotonic
from typing import Any, Final, Protocol

from ..errors import COLON, IN_THE_CALL, SlaveError
from ..fmi.value_buffers import ScalarVariable
from .channel import ALIVE, CALL, FAULT, KIND, LOG, RESULT, VALUES, StepCodec, channel_pair, decode, encode
from .log_lines import LogReceiver
from .supervision.supervised_process import SupervisedProcess

START_TIMEOUT_S: Final = 60.0
"""Time for Python itself to start and import, however busy the machine; the FMU's own calls have their own limit."""
CLOSE_TIMEOUT_S: Final = 2.0
"""Time for an FMU to terminate politely, and for its process to end."""


class ToLoad(Protocol):
    """Content of the first message to a program: JSON values, such as those of FmuToLoad."""

    @property
    def instance_name(self) -> str: ...
    def __iter__(self) -> Iterator[Any]: ...


class FmuProcess:
    """An FMU, or what else a program loads, that runs in a process of its own.

    1. FmuProcess           starts the process, which loads the FMU; several load at the same time
    2. bind, call           one request and its answer
    3. begin_step, end_step the same for a step, in two halves: several FMUs step at the same time
    4. close

    Every method but close may raise SlaveError; the process has been ended then, and only close may follow.
    """

    def __init__(
        self,
        fmu: "ToLoad",
        timeout_s: float,
        kind: str = KIND,
        memory_limit: float = 0.0,
        environment: Sequence[str] = (),
        program: str = "cosim.slaves.child",
    ) -> None:
        """timeout_s is the time each call may take [s]; kind is that of channel_pair.

        memory_limit: resident memory that the process may have [MB], 0 for half of the machine's (Linux).
        environment: names of variables that it is given beside those which every FMU is given, `*` for any text.
        program: module whose main serves it.
        """
        self._name = fmu.instance_name
        self._timeout_s = timeout_s
        self._codec = StepCodec(0, 0, 0)
        self._log = LogReceiver(self._name)
        self._is_loaded = False
        self._is_answer_due = False
        self._channel, theirs = channel_pair(kind)
        try:
            self._process = SupervisedProcess(
                self._name, program, theirs, memory_limit, self._channel.hang_up, environment
            )
        except BaseException:
            self._channel.close()
            raise
        finally:
            theirs.close()
        self._send("instantiate", None, encode(CALL, list(fmu)))

    def bind(
        self, inputs: Sequence[ScalarVariable], tunables: Sequence[ScalarVariable], outputs: Sequence[ScalarVariable]
    ) -> None:
        """Call the binding's bind, and fit the messages of a step to it."""
        self.call("bind", None, inputs, tunables, outputs)
        self._codec = StepCodec(len(inputs), len(tunables), len(outputs))

    def call(self, function: str, t: float | None, *arguments: object) -> Any:
        """Call the binding's method of that name at the FMU's time t [s]; bytes must be the only argument."""
        self._wait_until_loaded()
        blob = arguments[0] if arguments and isinstance(arguments[0], bytes) else None
        self._send(function, t, encode(CALL, [function, () if blob is not None else arguments], blob))
        answer = self._receive(function, t, RESULT, self._timeout_s)
        try:
            value, blob = decode(answer)
        except ValueError as error:
            raise self._malformed_answer(function, t) from error
        return value if blob is None else blob

    def begin_step(self, t: float, h: float, inputs: Sequence[float], tunables: Sequence[float] | None) -> None:
        """Start the binding's step."""
        self._process.step_begins()
        self._send("do_step", t, self._codec.encode_step(t, h, inputs, tunables))

    def end_step(self, t: float) -> tuple[float, ...]:
        """Wait for the binding's step, and return its result."""
        self._process.step_is_asked_for()
        message = self._receive("do_step", t, VALUES, self._timeout_s)
        self._process.step_has_ended()
        try:
            return self._codec.decode_values(message)
        except struct.error as error:
            raise self._malformed_answer("do_step", t) from error

    def close(self, t: float | None, is_polite: bool) -> None:
        """Terminate and free the FMU if it still answers, then end its process; idempotent.

        Raises SlaveError when terminating fails; the process has ended even so.
        """
        try:
            if is_polite and self._is_loaded and not self._is_answer_due and not self._process.has_ended:
                self._timeout_s = min(self._timeout_s, CLOSE_TIMEOUT_S)
                self.call("close", t)
                self._process.wait(CLOSE_TIMEOUT_S)
        finally:
            self._process.end()
            self._channel.close()

    def _wait_until_loaded(self) -> None:
        if not self._is_loaded:
            self._receive("start", None, RESULT, START_TIMEOUT_S)
            self._receive("instantiate", None, RESULT, self._timeout_s)
            self._is_loaded = True

    def _send(self, function: str, t: float | None, message: bytes) -> None:
        if self._is_answer_due:  # an exception, such as Ctrl-C, has cut the wait for it short
            raise RuntimeError(f"{self._name} must be closed: it has not answered an earlier call.")
        self._is_answer_due = True
        try:
            self._channel.send(message)
        except OSError as error:
            raise self._death(function, t) from error

    def _receive(self, function: str, t: float | None, kind: int, timeout_s: float) -> bytes:
        try:
            message = self._channel.receive(timeout_s)
            if message[0] in (LOG, ALIVE):
                message = self._answer_after(message, timeout_s)
        except TimeoutError as error:
            self._end_after_fault()
            raise SlaveError(self._name, function, t, f"did not return within {timeout_s:g} s") from error
        except (EOFError, OSError) as error:
            raise self._death(function, t) from error
        except ValueError as error:
            raise self._malformed_answer(function, t) from error
        if message[0] != kind:
            raise self._fault(function, t, message)
        self._is_answer_due = False
        self._log.report()
        return message

    def _answer_after(self, message: bytes, timeout_s: float) -> bytes:
        """Return the first message that is no line of a log, nor a sign that one of many calls has ended in time.

        Raises as Channel.receive, and ValueError.
        """
        deadline = monotonic() + timeout_s  # an FMU that logs without end does not put it off
        while message[0] in (LOG, ALIVE):
            if message[0] == ALIVE:
                deadline = monotonic() + timeout_s
            else:
                self._log.add(message)
            message = self._channel.receive(timeout_s)
            if monotonic() > deadline:
                raise TimeoutError(f"no answer within {timeout_s} s")
        return message

    def _fault(self, function: str, t: float | None, message: bytes) -> SlaveError:
        """Return the error that the process has reported, in a message that is not trusted."""
        self._log.report(is_fault=True)
        self._end_after_fault()
        with suppress(ValueError, TypeError, OverflowError):  # of another form, which is told
            (its_function, its_t, reason, form), _ = decode(message)
            if message[0] == FAULT:
                t = t if its_t is None else float(its_t)
                return SlaveError(self._name, str(its_function or function), t, str(reason), form)
        return self._malformed_answer(function, t)

    def _malformed_answer(self, function: str, t: float | None) -> SlaveError:
        self._end_after_fault()
        return SlaveError(self._name, function, t, "the FMU's process gave an answer of the wrong form", COLON)

    def _death(self, function: str, t: float | None) -> SlaveError:
        how = self._process.how_it_ended(CLOSE_TIMEOUT_S)
        self._end_after_fault()
        during = "its start" if function == "bind" else function
        return SlaveError(self._name, during, t, f"the FMU's process {how}", IN_THE_CALL)

    def _end_after_fault(self) -> None:
        """End the process and all that the FMU has started."""
        if not self._process.has_ended:
            self._process.end(with_descendants=True)
            self._channel.close()
            self._log.report()
