"""`retune csv`."""

import argparse
from pathlib import Path

from ..runs.manifest import check_whole
from ..runs.record import recording
from ..runs.run_files import CSV
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
    print(f"{out}  {len(series['time'])} rows of {len(series)} columns")
    return DONE
