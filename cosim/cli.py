"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import atexit
import errno
import logging
import os
import signal
import sys
import threading
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from math import inf
from time import monotonic
from typing import Any, Final

from .commands.exit_codes import INTERRUPTED, REFUSED, UNFINISHED
from .commands.options import make_parser

_NO_ROOM: Final = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_POLITE: Final[dict[int, Any]] = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: None}
"""Signals that ask for an end, and what their handler must be for us to take its place; None: anything."""
if sys.platform != "win32":
    _POLITE[signal.SIGHUP] = signal.SIG_DFL  # nohup has it ignored
_DEAF_S: Final = 20.0
"""Time after a signal [s] in which others are not heard: more than FMUs take to be closed."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code.

    Signals are handled as before afterwards, unless one has interrupted the command: then none may cut the end of the
    program short.
    """
    signals = _Signals()
    try:
        signals.take()
        return _ended(arguments)
    except KeyboardInterrupt:
        print("retune: interrupted; what there is so far is in the run folder", file=sys.stderr)
        return INTERRUPTED
    finally:
        signals.give_back()


def _ended(arguments: Sequence[str] | None) -> int:
    """The exit code of a command that has ended by itself."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before NumPy: a second BLAS thread is slower and changes bits
    options = make_parser().parse_args(arguments)
    from .errors import CosimError  # here and below: --help must not wait for NumPy and GPy

    try:
        with _everything_logged() if options.debug else nullcontext():
            return import_module(f".commands.{options.command}", __package__).command(options)
    except CosimError as e:
        return _end(options, str(e), _code_of(e))
    except KeyboardInterrupt:
        if options.debug:
            traceback.print_exc()
        raise
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone
        return UNFINISHED
    except BaseException as e:  # nothing that we know of; it must not look like success, nor like a refusal
        return _end(options, f"{type(e).__name__}: {e}; --debug shows where", UNFINISHED)


def _code_of(error: Exception) -> int:
    """Whether something was refused, or could not be finished, for want of room on the disk if nothing else."""
    from .errors import UnfinishedError

    cause = error.__cause__
    has_no_room = isinstance(cause, OSError) and cause.errno in _NO_ROOM
    return UNFINISHED if has_no_room or isinstance(error, UnfinishedError) else REFUSED


def _end(options: argparse.Namespace, why: str, code: int) -> int:
    """Say in one line why a command ends; the exit code."""
    from .errors import one_line

    if options.debug:
        traceback.print_exc()
    print(f"retune: {one_line(why, longest=4000)}", file=sys.stderr)
    return code


class _Signals:
    """What ends a process politely interrupts the command, so that it clears up: also a terminal that is closed.

    Once: another signal would cut the clearing up short. One that comes much later is heard again, since Python drops
    an exception where nobody can catch it, in a destructor for example.
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


@contextmanager
def _everything_logged() -> Generator[None]:
    """Show what the FMUs log that is no warning, too."""
    log, handler = logging.getLogger(__package__), logging.StreamHandler()
    level = log.level
    log.setLevel(logging.DEBUG)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


if __name__ == "__main__":
    sys.exit(main())
