"""`retune estimate --online`."""

import argparse
import sys

from ..files import to_json, write_text
from ..offline.online import run_online
from ..offline.online_report import estimates_ssv, report, summary, write_files
from ..offline.request import Request
from ..runs.record import recording
from ..terminal.exit_codes import DONE, INTERRUPTED, UNFINISHED
from ..terminal.folders import new_folder
from ..terminal.next_step import tell_next
from ..terminal.progress import progress_bar
from ..terminal.streams import answer


def estimate_online(options: argparse.Namespace, request: Request) -> int:
    """Run the command; return the exit code."""
    try:
        with new_folder(f"{request.fmu.stem}-online", options.out) as folder:
            with progress_bar(
                request.fmu.stem, "{n_fmt} of {total_fmt} samples", lambda n, n_all: (n, n_all, "")
            ) as progress:
                found = run_online(request, options.samples or 50, progress, options.per_sample or 1)
            with recording(folder):
                write_files(found, folder)
    except KeyboardInterrupt:
        print("retune: interrupted; nothing is written", file=sys.stderr)
        return INTERRUPTED
    if options.ssv:
        with recording(options.ssv.parent):
            write_text(options.ssv, estimates_ssv(found))
    answer(to_json(summary(found)) if options.json else f"{report(found)}\n\nwritten to {folder}")
    if found.is_judged and not options.json:
        tell_next("run", "SCENARIO", "--start-values", f"plant={folder / 'estimates.ssv'}")
    if found.failure is not None:
        print(f"retune: {found.failure}; what was recorded so far is in {folder}", file=sys.stderr)
        return UNFINISHED
    return DONE
