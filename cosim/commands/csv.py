"""`retune csv`."""

import argparse
from pathlib import Path
from typing import Any

from ..runs.manifest import check_whole, read_json
from ..runs.record import recording
from ..runs.run_files import CSV, MANIFEST
from ..runs.series import read_series, write_csv
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    out: Path = options.out or options.run / CSV
    series = read_series(options.run)
    check_whole(options.run)
    if options.out is None and out.is_file():
        print(f"{out}  is there already")
        return DONE
    must_be_new(out, "--out")
    with recording(out.parent):
        write_csv(out, series)
    status = read_json(options.run, MANIFEST, dict[str, Any]).get("status")
    unfinished = "" if status in (None, "done") else f"; the run is {status}"
    print(f"{out}  {len(series['time'])} rows of {len(series)} columns{unfinished}")
    return DONE
