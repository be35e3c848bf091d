"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import io
import logging
import os
import signal
import sys
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from typing import NoReturn

from .commands.exit_codes import INTERRUPTED, REFUSED, UNFINISHED
from .commands.options import make_parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before NumPy: a second BLAS thread is slower and changes bits
    _ready_streams()
    options = make_parser().parse_args(arguments)
    _take_signals()
    from .errors import CosimError, is_refusal  # here and below: --help must not wait for NumPy and GPy

    try:
        with _everything_logged() if options.debug else nullcontext():
            code = import_module(f".commands.{options.command}", __package__).command(options)
        sys.stdout.flush()
        return code
    except CosimError as e:
        return _end(options, str(e), REFUSED if is_refusal(e) else UNFINISHED)
    except KeyboardInterrupt:
        return _end(options, "interrupted; what there is so far is in the run folder", INTERRUPTED)
    except BrokenPipeError:
        _drop_output()  # its reader has gone
        return UNFINISHED
    except Exception as e:  # nothing that we know of; it must not look like success, nor like a refusal
        why = f"{type(e).__name__}: {e}; --debug shows where"
        if isinstance(e, OSError) and not _can_print():
            _drop_output()
            why = f"cannot write what it prints: {e.strerror or e}"
        return _end(options, why, UNFINISHED)


def _end(options: argparse.Namespace, why: str, code: int) -> int:
    """Say in one line why a command ends; the exit code."""
    from .errors import one_line

    if options.debug:
        traceback.print_exc()
    print(f"retune: {one_line(why, longest=4000)}", file=sys.stderr)
    return code


def _ready_streams() -> None:
    """Let nothing that is printed end a command: characters that a stream lacks are escaped, a closed one is null."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115  for good
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _can_print() -> bool:
    """Whether what has been printed can be written; where it cannot, it is kept to be tried again."""
    try:
        sys.stdout.flush()
    except OSError:
        return False
    return True


def _drop_output() -> None:
    """Have what cannot be written go nowhere, else the interpreter tries again at its end, and complains."""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, sys.stdout.fileno())
    os.close(null)


def _take_signals() -> None:
    """What ends a process politely interrupts the command, so that it clears up: also a terminal that is closed."""
    signal.signal(signal.SIGTERM, _interrupt)
    if sys.platform != "win32" and signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:  # nohup has it ignored
        signal.signal(signal.SIGHUP, _interrupt)


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


def _interrupt(*_: object) -> NoReturn:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main())
