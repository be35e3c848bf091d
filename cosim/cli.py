"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
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
    options = make_parser().parse_args(arguments)
    _take_signals()
    from .errors import CosimError, is_refusal  # here and below: --help must not wait for NumPy and GPy

    try:
        with _everything_logged() if options.debug else nullcontext():
            return import_module(f".commands.{options.command}", __package__).command(options)
    except CosimError as e:
        return _end(options, str(e), REFUSED if is_refusal(e) else UNFINISHED)
    except KeyboardInterrupt:
        return _end(options, "interrupted; what there is so far is in the run folder", INTERRUPTED)
    except BrokenPipeError:
        sys.stderr.close()  # the reader of our output has gone
        return UNFINISHED
    except Exception as e:  # nothing that we know of; it must not look like success, nor like a refusal
        return _end(options, f"{type(e).__name__}: {e}; --debug shows where", UNFINISHED)


def _end(options: argparse.Namespace, why: str, code: int) -> int:
    """Say in one line why a command ends; the exit code."""
    from .errors import one_line

    if options.debug:
        traceback.print_exc()
    print(f"retune: {one_line(why, longest=4000)}", file=sys.stderr)
    return code


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
