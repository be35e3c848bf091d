"""An FMU in this process that calls exit() does not end it as if all were well."""

import atexit
import ctypes
import os
from contextlib import suppress
from typing import Any, Final

from ..errors import SlaveError

_CODE: Final = 1  # of a run that has not finished
_Handler: Final = ctypes.CFUNCTYPE(None, ctypes.c_void_p)


class ExitGuard:
    """Until it is closed, an exit() from inside a call of the FMU's gives one line and exit code 1.

    It is one of the C library's exit handlers, where that is GNU's. Nothing hears _exit(), which this does not help
    against.
    """

    def __init__(self, name: str) -> None:
        """name: of the instance."""
        self.inside: tuple[str, float | None] | None = None
        """Function that has been called, at t [s], and has not returned."""
        self._name = name
        self._key = ctypes.create_string_buffer(1)  # its address stands for this guard in the C library
        self._handler = _Handler(self._ended)
        self._forget: Any = None
        with suppress(OSError, AttributeError, TypeError):
            libc = ctypes.CDLL(None)
            forget = libc["__cxa_finalize"]
            libc["__cxa_atexit"](self._handler, None, self._key)
            self._forget = forget
            atexit.register(self.close)  # before Python, and the handler with it, has gone

    def close(self) -> None:
        """No more calls."""
        self.inside = None
        if self._forget is not None:
            atexit.unregister(self.close)
            self._forget(self._key)
            self._forget = None

    def _ended(self, _: object) -> None:
        if self.inside is not None:
            fault = SlaveError(self._name, *self.inside, "ended this process, which it was part of")
            os.write(2, f"retune: {fault}\n".encode())
            os._exit(_CODE)
