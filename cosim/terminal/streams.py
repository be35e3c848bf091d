"""Standard output and standard error, which may be closed, full, or of another encoding."""

import io
import os
import sys


def ready_streams() -> None:
    """Let nothing that is printed end a command: characters that a stream lacks are escaped, a closed one is null."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  for good
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def can_print() -> bool:
    """Whether what has been printed can be written; where it cannot, it is kept to be tried again."""
    try:
        sys.stdout.flush()
    except OSError:
        return False
    return True


def drop_output() -> None:
    """Have what cannot be written go nowhere, else the interpreter tries again at its end, and complains."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)
