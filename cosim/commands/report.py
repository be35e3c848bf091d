"""`retune report`."""

import argparse
from pathlib import Path

from ..files import write_text
from ..pages.list_page import link_from, list_html, listed, run_folders
from ..pages.runs_page import read_page
from ..pages.study_page import study_html
from ..plots.palette import RUNS
from ..runs.record import recording
from ..studies.table import RESULTS
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    given: list[Path] = options.folders
    out: Path = options.out or (given[0] if len(given) == 1 and given[0].is_dir() else Path()) / "report.html"
    if not options.force:
        must_be_new(out, "--out")
    if len(given) == 1 and (given[0] / RESULTS).is_file():
        return _written(out, study_html(given[0], link_from(out)))
    folders = list(dict.fromkeys(folder for path in given for folder in run_folders(path)))
    if len(folders) > len(RUNS):
        title = ", ".join(path.resolve().name for path in given)
        page = list_html(title, [listed(folder) for folder in folders], link_from(out))
    else:
        page = read_page(folders).html()
    return _written(out, page)


def _written(out: Path, page: str) -> int:
    with recording(out.parent):
        write_text(out, page)
    print(out)
    return DONE
