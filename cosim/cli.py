"""The command `retune`. Exit codes: 0 done; 1 the run did not finish; 2 the input was refused; 130 interrupted."""

import argparse
import errno
import gc
import logging
import os
import sys
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from typing import Final

from .blas_threads import ONE_THREAD
from .errors import ScenarioError
from .offline.estimate_file import by_key, with_file
from .shadowing import check_packages
from .terminal.completion import VARIABLE, complete
from .terminal.exit_codes import INTERRUPTED, REFUSED, UNFINISHED
from .terminal.options import make_parser
from .terminal.signals import SignalHandler
from .terminal.streams import answers_alone, can_print, drop_output, ready_streams
from .warnings_log import warnings_logged

_NEW_OBJECTS: Final = 10_000
"""Number of new objects after which garbage is looked for, 700 by default: what modules make as they load stays."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code.

    The signal handlers are restored afterwards, unless a signal has interrupted the command: then none may cut the end
    of the program short.
    """
    signals, thresholds = SignalHandler(), gc.get_threshold()
    try:
        signals.take()
        gc.set_threshold(_NEW_OBJECTS, *thresholds[1:])
        return _ended(arguments)
    except KeyboardInterrupt as e:
        print(f"retune: interrupted{'; ' if str(e) else ''}{e}", file=sys.stderr)
        return INTERRUPTED
    finally:
        gc.set_threshold(*thresholds)
        signals.give_back()


def _ended(arguments: Sequence[str] | None) -> int:
    """Run the command to its end; return its exit code."""
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    ready_streams()
    parser = make_parser()
    if VARIABLE in os.environ:
        complete(parser)
    given = sys.argv[1:] if arguments is None else list(arguments)
    try:
        words = with_file(given)
        options = parser.parse_args(words)
    except ScenarioError as e:
        parser.error(str(e).rstrip("."))
    from .errors import CosimError, is_refusal  # here and below: --help must not wait for NumPy and GPy

    try:
        check_packages()
    except ImportError as e:
        return _end(options, str(e), REFUSED)
    try:
        is_json = getattr(options, "json", False)
        logged = _everything_logged() if options.debug else nullcontext()
        with answers_alone() if is_json else nullcontext(), warnings_logged(), logged:
            code = import_module(f".commands.{options.command}", __package__).command(options)
        sys.stdout.flush()
        return code
    except CosimError as e:
        return _end(options, by_key(str(e), given, words), REFUSED if is_refusal(e) else UNFINISHED)
    except KeyboardInterrupt:
        if options.debug:
            traceback.print_exc()
        raise
    except BrokenPipeError:
        drop_output()  # its reader has gone
        return UNFINISHED
    except BaseException as e:  # nothing that we know of; it must not look like success, nor like a refusal
        why = f"{type(e).__name__}: {e}; --debug shows where"
        if isinstance(e, OSError) and e.filename is not None:
            why = f"cannot read or write {e.filename}: {e.strerror or e}; --debug shows where"
        if isinstance(e, OSError) and (not can_print() or (e.errno == errno.ENOSPC and e.filename is None)):
            drop_output()
            why = f"cannot write its output: {e.strerror or e}"
        return _end(options, why, UNFINISHED)


def _end(options: argparse.Namespace, why: str, code: int) -> int:
    """Print in one line why a command ends; return the exit code."""
    from .errors import one_line

    if options.debug:
        traceback.print_exc()
    print(f"retune: {one_line(why, longest=4000)}", file=sys.stderr)
    return code


@contextmanager
def _everything_logged() -> Generator[None]:
    """Show everything that the FMUs log, not only their warnings."""
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
