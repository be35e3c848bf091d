"""`retune estimate`."""

import argparse
import sys
from pathlib import Path

from ..files import to_json, write_text
from ..offline.estimate import Estimation, FailedError
from ..offline.estimate_options import request_of
from ..offline.fit_folder import estimate_into, profile_into
from ..offline.fit_report import estimates_ssv, report, ssv_files, summary
from ..runs.record import recording
from ..terminal.exit_codes import DONE, INTERRUPTED, UNFINISHED
from ..terminal.folders import must_be_new, new_folder
from ..terminal.next_step import tell_next
from ..terminal.progress import progress_bar
from ..terminal.streams import answer


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    request = request_of(options)
    must_be_new(options.ssv, "--ssv")
    if options.online:
        from .estimate_online import estimate_online

        return estimate_online(options, request)

    def state(n: int, cost: float) -> tuple[int, int, str]:
        return n, max(request.evaluations, n), f"sum of squares {cost:.4g}"

    there = "there is no estimate yet"
    try:
        with new_folder(f"{request.fmu.stem}-estimate", options.out) as folder:
            with progress_bar(request.fmu.stem, "{n_fmt} of {total_fmt} candidates", state) as progress:
                found = estimate_into(folder, request, progress)
            there = f"the estimate, without profiles, is in {folder}"
            if options.profile:
                found = _profiled(folder, found)
    except FailedError as e:
        print(f"retune: {e}", file=sys.stderr)
        return UNFINISHED
    except KeyboardInterrupt:
        print(f"retune: interrupted; {there}", file=sys.stderr)
        return INTERRUPTED
    if options.ssv:
        with recording(options.ssv.parent):
            write_text(options.ssv, estimates_ssv(found))
    answer(to_json(summary(found)) if options.json else f"{report(found)}\n\nwritten to {folder}")
    if not options.json:
        written = next(iter(ssv_files(found)))
        tell_next("run", "SCENARIO", "--start-values", f"plant={folder / written}")
    return DONE


def _profiled(folder: Path, found: Estimation) -> Estimation:
    """Return the estimation with its profiles, showing a progress bar meanwhile."""
    n = len(found.space)
    with progress_bar(found.request.fmu.stem, "{n_fmt} of {total_fmt} profiles", lambda k: (k, n, "")) as progress:
        return profile_into(folder, found, progress)
