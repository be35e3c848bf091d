"""Passing on what an FMU prints to standard error, line by line under its instance's name.

A pipe of its own, not our standard error itself: a process could put that into another mode, cut or fill it.
"""

import os
import sys
import threading
from contextlib import suppress
from typing import Final

MOST: Final = 1 << 20
"""Bytes that are passed on; what an FMU prints after that is left out."""
_CLOSE_TIMEOUT_S: Final = 1.0  # a child that the FMU has left behind may hold the other end


class OutputRelay:
    """The reading end of what one FMU prints; `descriptor` is the end to write to."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._source, self.descriptor = os.pipe()
        self._n_bytes = 0
        self._thread = threading.Thread(target=self._pass_on, name=f"output of {name}", daemon=True)

    def start(self) -> None:
        """Close our copy of the writing end, which the process has now, and pass on what comes."""
        os.close(self.descriptor)
        self._thread.start()

    def abandon(self) -> None:
        """Close both ends: there is no process."""
        os.close(self.descriptor)
        os.close(self._source)

    def wait(self) -> None:
        """Wait until all is passed on, after the process has ended."""
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _pass_on(self) -> None:
        rest = b""
        while block := os.read(self._source, 1 << 16):
            *lines, rest = (rest + block).split(b"\n")
            for line in lines:
                self._line(line)
            if len(rest) > 1 << 16:
                self._line(rest)
                rest = b""
        if rest:
            self._line(rest)
        os.close(self._source)

    def _line(self, line: bytes) -> None:
        before, self._n_bytes = self._n_bytes, self._n_bytes + len(line) + 1
        if before > MOST:
            return
        text = "(what it prints from here on is left out)" if self._n_bytes > MOST else _shown(line)
        with suppress(OSError, ValueError, AttributeError):  # nobody reads it, or the program is at its end
            sys.stderr.write(f"{self._name}: {text}\n")
            sys.stderr.flush()


def _shown(line: bytes) -> str:
    """Return a line as text that stays in its line: a terminal would obey escape sequences."""
    text = line.decode("utf-8", "replace").rstrip()
    return "".join(c if c.isprintable() or c == "\t" else c.encode("unicode_escape").decode() for c in text)
