"""What ends a process politely interrupts the command, so that it clears up: also a terminal that is closed."""

import atexit
import signal
import sys
import threading
from math import inf
from time import monotonic
from typing import Any, Final

_POLITE: Final[dict[int, Any]] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: None}
"""Signals that ask for an end, and what their handler must be for us to take its place; None: anything."""
if sys.platform != "win32":
    _POLITE[signal.SIGHUP] = signal.SIG_DFL  # nohup has it ignored
_DEAF_S: Final = 20.0
"""Time after a signal [s] in which others are not heard: more than FMUs take to be closed."""


class SignalHandler:
    """Interrupts once: another signal would cut the clearing up short.

    One that comes much later is heard again, since Python drops an exception where nobody can catch it, in a destructor
    for example.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._last = -inf
        self._handler = self._interrupt  # one object: each look at a method makes another

    def take(self) -> None:
        """Begin; elsewhere than in the main thread, to which alone Python gives signals, nothing is done."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number, usual in _POLITE.items():
            if usual is None or signal.getsignal(number) is usual:
                self._before[number] = signal.signal(number, self._handler)

    def give_back(self) -> None:
        """End: handle signals as before, or where one has come, ignore them as soon as the program ends.

        Python gives up its handlers there, and the system's would end the process.
        """
        if self._last > -inf:
            atexit.register(self._ignore)
            return
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ignore(self) -> None:
        for number in self._before:
            signal.signal(number, signal.SIG_IGN)

    def _interrupt(self, *_: object) -> None:
        if monotonic() - self._last > _DEAF_S:
            self._last = monotonic()
            raise KeyboardInterrupt
