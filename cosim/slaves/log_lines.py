"""Lines that an FMU logs, on their way from its process to the program's log."""

import contextlib
from typing import Final

from ..errors import one_line
from ..fmi.fmu_log import log_message
from .channel import LOG, Channel, decode, encode

MOST_LINES: Final = 1000
"""Lines of one FMU's log that are passed on."""
LINES_A_CALL: Final = 100
"""Lines of an FMU's log that are passed on from one call."""


class LogSender:
    """Sender of log lines, each at once, so that none is lost if the FMU's process dies in the same call."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._n_left = LINES_A_CALL

    def call_begins(self) -> None:
        """Count lines from zero again."""
        self._n_left = LINES_A_CALL

    def __call__(self, status: int, text: str) -> None:
        self._n_left -= 1
        if self._n_left < 0:
            return
        with contextlib.suppress(OSError):
            self._channel.send(encode(LOG, [status, text if self._n_left else "(what it logs after this is left out)"]))


class LogReceiver:
    """Receiver that keeps the log lines of a call until it is known whether the call failed, then logs them."""

    def __init__(self, name: str) -> None:
        """name: the instance's."""
        self._name = name
        self._lines: list[tuple[int, str]] = []
        self._n_lines = 0

    def add(self, message: bytes) -> None:
        """Take a line. Raises ValueError for a message of another form."""
        (status, text), _ = decode(message)
        self._lines.append((int(status), one_line(str(text))))

    def report(self, is_fault: bool = False) -> None:
        """Log the lines; as information only where the call failed, since the fault is reported anyway."""
        for status, text in self._lines:
            self._n_lines += 1
            if self._n_lines == MOST_LINES:
                text = "(what it logs from here on is left out)"
            if self._n_lines <= MOST_LINES:
                log_message(self._name, status, text, is_fault)
        self._lines.clear()
