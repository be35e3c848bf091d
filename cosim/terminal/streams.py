"""Standard output and standard error, which may be closed, full, or of another encoding."""

import io
import os
import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any, TextIO


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


class _Aside:
    """Standard error in the place of standard output, which is kept for answers."""

    def __init__(self, answers: TextIO) -> None:
        self.answers = answers

    def __getattr__(self, name: str) -> Any:
        return getattr(sys.stderr, name)


@contextmanager
def answers_alone() -> Generator[None]:
    """Keep standard output for `answer`: what else is printed, as by a user's model, goes to standard error."""
    stdout = sys.stdout
    stdout.flush()
    kept = os.dup(1) if _is_standard_output(stdout) else None
    try:
        if kept is None:
            sys.stdout = _Aside(stdout)  # another program's stream in place of a file
            yield
            return
        os.dup2(2, 1)
        with open(kept, "w", closefd=False, encoding=stdout.encoding, errors=stdout.errors) as answers:
            sys.stdout = _Aside(answers)
            yield
    finally:
        sys.stdout = stdout
        if kept is not None:
            os.dup2(kept, 1)
            os.close(kept)


def answer(text: str) -> None:
    """Print a command's answer to standard output."""
    print(text, file=getattr(sys.stdout, "answers", sys.stdout))


def _is_standard_output(stdout: TextIO) -> bool:
    """Return whether a stream is the process' standard output, and there is a standard error beside it."""
    try:
        os.fstat(2)
        return stdout.fileno() == 1
    except (OSError, AttributeError):
        return False
