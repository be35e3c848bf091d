"""Handling of termination signals, a closed terminal's included: they interrupt the command, so that it cleans up."""

import atexit
import signal
import sys
import threading
from math import inf
from time import monotonic
from typing import Any, Final

_POLITE: Final[dict[int, Any]] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: None}
"""Signals that request termination, and the handler that ours may replace; None: any."""
if sys.platform != "win32":
    _POLITE[signal.SIGHUP] = signal.SIG_DFL  # nohup has it ignored
_DEAF_S: Final = 20.0
"""Time after a signal [s] in which further ones are ignored: longer than FMUs take to close."""


class SignalHandler:
    """Signal handler that interrupts once: another signal would cut the cleaning up short.

    One that comes much later interrupts again, since Python drops an exception raised where it cannot be caught, such
    as in a destructor.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._last = -inf
        self._handler = self._interrupt  # one object: each look at a method makes another

    def take(self) -> None:
        """Install the handlers; do nothing outside the main thread, the only one in which Python handles signals."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number, usual in _POLITE.items():
            if usual is None or signal.getsignal(number) is usual:
                self._before[number] = signal.signal(number, self._handler)

    def give_back(self) -> None:
        """Restore the previous handlers, or, if a signal has come, have signals ignored once the program exits.

        Python drops its handlers at exit, and the system's defaults would end the process.
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
