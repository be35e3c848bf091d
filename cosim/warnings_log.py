"""Python's warnings in the debug log, such as NumPy's on an overflow: a terminal is for what a user can act on."""

import logging
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

_log = logging.getLogger(__name__)


@contextmanager
def warnings_logged() -> Generator[None]:
    """Write warnings to the debug log, which `--debug` shows, and not to standard error."""
    with warnings.catch_warnings():
        warnings.showwarning = _record
        yield


def _record(message: Warning | str, category: type[Warning], filename: str, lineno: int, *_: Any) -> None:
    _log.debug("%s:%d: %s: %s", filename, lineno, category.__name__, message)
