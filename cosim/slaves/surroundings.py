"""What an FMU in this process may change under our feet: looked at before each call, put back after it, and told.

Steps are looked after for the floating-point state only, which changes every number from there on; the rest costs as
much as a step. Linux; elsewhere only the working directory and Python's view of the environment are put back.
"""

import ctypes
import locale
import logging
import os
import signal
import struct
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import Any, Final

_log = logging.getLogger(__name__)
_libc: Any = ctypes.CDLL(None) if sys.platform == "linux" else None
_libm: Any = ctypes.CDLL("libm.so.6") if sys.platform == "linux" else None
_SIGNALS: Final = () if sys.platform == "win32" else (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGPIPE, signal.SIGCHLD, signal.SIGALRM, signal.SIGFPE,
    signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGILL, signal.SIGUSR1, signal.SIGUSR2,
)  # fmt: skip
_SIGACTION: Final = ((0, 16, 136), (136, 140, 256))  # handler and mask, flags in glibc's struct; the rest is chance
_STICKY: Final = 0x3F  # of MXCSR: which exceptions there were; every inexact result sets one


class FloatingPoint:
    """The floating-point state: rounding, denormals, masked exceptions (fenv.h)."""

    def __init__(self) -> None:
        self._state, self._now = (ctypes.create_string_buffer(64) for _ in range(2))
        self._get: Any = None if _libm is None else _libm.fegetenv
        self._set: Any = None if _libm is None else _libm.fesetenv

    def save(self) -> None:
        """Remember it."""
        if self._get is not None:
            self._get(self._state)

    def restore(self) -> bool:
        """Put it back; whether it had changed, where that can be seen."""
        if self._get is None:
            return False
        self._get(self._now)
        self._set(self._state)
        return _control(self._now) != _control(self._state)


def _control(state: Any) -> tuple[int, int]:
    """Control words of x87 and SSE, in glibc's layout of fenv_t for x86."""
    if os.uname().machine != "x86_64":
        return (0, 0)
    (mxcsr,) = struct.unpack_from("<I", state, 28)
    return struct.unpack_from("<H", state)[0], mxcsr & ~_STICKY


@contextmanager
def kept(name: str) -> Generator[None]:
    """Put back what is in here changed by the FMU `name`, and log a warning that says what it was."""
    floating_point = FloatingPoint()
    floating_point.save()
    before = {what: look() for what, (look, _) in _SURROUNDINGS.items()}
    try:
        yield
    finally:
        changed = ["the floating-point state"] if floating_point.restore() else []
        for what, (look, put_back) in _SURROUNDINGS.items():
            if look() != before[what]:
                with suppress(OSError, locale.Error):
                    put_back(before[what])
                changed.append(what)
        if changed:
            tell_changes(name, changed)


def tell_changes(name: str, changed: list[str]) -> None:
    """Log that an FMU has changed these, and that they are as before again."""
    _log.warning("%s: has changed %s of this process; put back.", name, " and ".join(changed))


def _directory() -> str:
    try:
        return os.getcwd()
    except OSError:
        return ""


def _signal_actions() -> list[tuple[bytes, Any]]:
    """Of each signal what the C structure says, and Python's handler."""
    if _libc is None:
        return []
    actions: list[tuple[bytes, Any]] = []
    for number in _SIGNALS:
        action = ctypes.create_string_buffer(256)
        _libc.sigaction(int(number), None, action)
        meant = b"".join(action.raw[a:b].ljust(c - a, b"\0") for a, b, c in _SIGACTION)
        actions.append((meant, signal.getsignal(number)))
    return actions


def _set_signal_actions(actions: list[tuple[bytes, Any]]) -> None:
    for number, (action, handler) in zip(_SIGNALS, actions, strict=True):
        if handler is not None and signal.getsignal(number) is not handler:
            with suppress(ValueError):  # not in the main thread, where no handler can have been changed either
                signal.signal(number, handler)
        _libc.sigaction(int(number), ctypes.create_string_buffer(action, len(action)), None)


def _environment() -> dict[bytes, bytes]:
    """As C code sees it, which need not be what os.environ holds."""
    if _libc is None:
        return {k.encode(): v.encode() for k, v in os.environ.items()}
    entries = ctypes.POINTER(ctypes.c_char_p).in_dll(_libc, "environ")
    found: dict[bytes, bytes] = {}
    i = 0
    while entries and (entry := entries[i]) is not None:
        key, _, value = entry.partition(b"=")
        found[key] = value
        i += 1
    return found


def _set_environment(wanted: dict[bytes, bytes]) -> None:
    now = _environment()
    for key in now.keys() - wanted.keys():
        os.unsetenv(key)
        os.environ.pop(os.fsdecode(key), None)
    for key, value in wanted.items():
        if now.get(key) != value:
            os.environ[os.fsdecode(key)] = os.fsdecode(value)


_SURROUNDINGS: Final[dict[str, tuple[Callable[[], Any], Callable[[Any], Any]]]] = {
    "the working directory": (_directory, os.chdir),
    "the environment": (_environment, _set_environment),
    "the locale": (lambda: locale.setlocale(locale.LC_ALL), lambda old: locale.setlocale(locale.LC_ALL, old)),
    "the handling of signals": (_signal_actions, _set_signal_actions),
}
