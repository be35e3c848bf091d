"""Messages that an FMU logs, and the one among them that says why a call has failed."""

import logging
import re
from collections.abc import Callable
from ctypes import byref, c_void_p
from itertools import takewhile
from typing import Final

import fmpy
from fmpy import fmi1, fmi2

from ..errors import one_line

LogListener = Callable[[int, str], None]
"""Called with status and text of each message, while the FMU's call goes on."""

_WARNING, _ERROR = 1, 3
_LONGEST = 4000  # characters of a message in the log, where a traceback is whole
_log: Final = logging.getLogger(__name__)
# PythonFMU's words when the model has logged something, an exception's traceback for example, before it raised.
_UNKNOWN: Final = re.compile(rb"Fatal py exception encountered.*\sunknown error\s*", re.DOTALL)
# A frame of a traceback, but for those in the FMUs' own kernel, which refuses values: the mistake is not there.
_FRAME: Final = re.compile(r'  File "(?:.*[/\\])?(?P<file>(?<!\bkernel[/\\])[^"/\\]+)", line (?P<line>\d+)')


def log_message(name: str, status: int, text: str, is_fault: bool = False) -> None:
    """Log a message of the FMU `name` by its status; as information where a fault that is raised says the same."""
    _log.log(logging.WARNING if status >= _WARNING and not is_fault else logging.INFO, "%s: %s", name, text)


class Messages:
    """The FMU's gravest log message, and of equals the newest, since the last clear.

    PythonFMU's "unknown error" is fatal but says nothing: an error logged before it stays.
    """

    def __init__(self, on_log: LogListener | None = None) -> None:
        self.text = ""
        self._status = -1
        self._on_log = on_log

    def add(self, status: int, message: bytes) -> None:
        if self._on_log is not None:
            self._on_log(status, one_line(message.decode("utf-8", "replace"), _LONGEST))
        if status < self._status or (self._status >= _ERROR and _UNKNOWN.fullmatch(message)):
            return
        self.text = message.decode("utf-8", "replace")
        self._status = status

    def clear(self) -> None:
        self.text, self._status = "", -1

    def reason(self) -> str:
        """Return the message in one line, of a traceback the exception and its place, PythonFMU's exception alone."""
        lines = [line for line in self.text.splitlines() if line.strip()]
        if any(line.startswith("Traceback (most recent call last)") for line in lines):
            after_frames = [*takewhile(lambda line: not line[0].isspace(), reversed(lines))]
            places = [match for line in lines if (match := _FRAME.match(line))]
            place = [f"({places[-1]['file']}, line {places[-1]['line']})"] if places else []
            lines = (after_frames[::-1] or lines[-1:]) + place
        elif len(lines) > 1 and lines[0].startswith("Fatal py exception encountered"):
            lines = lines[1:]
        return one_line(" ".join(lines))


class MessageLog(Messages):
    """Messages of an FMI 2.0 FMU.

    Its logger is variadic; FMPy's native proxy formats the message. PythonFMU however passes the model's own text as
    the format and never arguments, so that a "%s" in it would read random memory: its texts are taken as they are.
    """

    _open: "dict[int, MessageLog]" = {}

    def __init__(self, has_plain_text: bool, on_log: LogListener | None = None) -> None:
        super().__init__(on_log)
        self._has_plain_text = has_plain_text
        self._open[id(self)] = self
        self.callbacks = fmi2.fmi2CallbackFunctions()
        self.callbacks.logger = _LOGGER
        self.callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        self.callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmpy.free)
        self.callbacks.componentEnvironment = id(self)
        if not has_plain_text:
            from fmpy.logging import addLoggerProxy

            addLoggerProxy(byref(self.callbacks))

    def add(self, status: int, message: bytes) -> None:
        super().add(status, message.replace(b"%%", b"%") if self._has_plain_text else message)

    def close(self) -> None:
        self._open.pop(id(self), None)


def _receive_message(environment: int | None, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    log = MessageLog._open.get(environment or 0)  # pyright: ignore[reportPrivateUsage]
    if log is not None:
        log.add(status, message or b"")
    else:  # the proxy is one for the whole process: an FMU that somebody else runs through FMPy
        fmi1.printLogMessage(c_void_p(environment), instance, status, category, message)


_LOGGER: Final = fmi2.fmi2CallbackLoggerTYPE(_receive_message)
