"""`retune estimate`."""

import argparse
import sys

from ..files import to_json, write_text
from ..offline.estimate import FailedError, estimate
from ..offline.estimate_options import request_of
from ..offline.fit_plot import draw_fit
from ..offline.fit_report import estimates_ssv, report, summary, write_files
from ..runs.record import recording
from ..terminal.exit_codes import DONE, INTERRUPTED, UNFINISHED
from ..terminal.folders import must_be_new, new_folder
from ..terminal.progress import progress_bar


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    request = request_of(options)
    must_be_new(options.ssv, "--ssv")
    if options.online:
        from .estimate_online import estimate_online

        return estimate_online(options, request)

    def state(n: int, cost: float) -> tuple[int, int, str]:
        return n, max(request.evaluations, n), f"sum of squares {cost:.4g}"

    try:
        with new_folder(f"{request.fmu.stem}-estimate", options.out) as folder:
            with progress_bar(request.fmu.stem, "{n_fmt} of {total_fmt} candidates", state) as progress:
                found = estimate(request, progress)
            with recording(folder):
                write_files(found, folder)
                draw_fit(found, folder / "fit.png")
    except FailedError as e:
        print(f"retune: {e}", file=sys.stderr)
        return UNFINISHED
    except KeyboardInterrupt:
        print("retune: interrupted; there is no estimate yet", file=sys.stderr)
        return INTERRUPTED
    if options.ssv:
        with recording(options.ssv.parent):
            write_text(options.ssv, estimates_ssv(found))
    print(to_json(summary(found)) if options.json else f"{report(found)}\n\nwritten to {folder}")
    return DONE
