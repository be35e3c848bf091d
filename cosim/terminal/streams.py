"""Standard output and standard error, which may be closed, full, or of another encoding."""

import io
import os
import sys


def ready_streams() -> None:
    """Make printing safe: escape characters that a stream cannot encode, and replace a closed stream by a null one."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  for good
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def can_print() -> bool:
    """Return whether the printed output can be flushed; if it cannot, it stays buffered for another attempt."""
    try:
        sys.stdout.flush()
    except OSError:
        return False
    return True


def drop_output() -> None:
    """Discard output that cannot be written; otherwise the interpreter tries again at exit, and reports an error."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
