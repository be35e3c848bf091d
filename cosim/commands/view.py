"""`retune view`."""

import argparse
import os
import sys
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import sleep

from ..errors import FolderError
from ..fmi.folder import PrivateFolder
from ..pages.list_page import run_folders
from ..pages.runs_page import read_page
from ..pages.server import PageServer
from ..pages.watched import GrowingPage, WatchedList, WatchedRuns, WatchedStudy
from ..plots.palette import RUNS
from ..runs.lock import is_locked
from ..runs.run_files import MANIFEST
from ..studies.folder import RUNS as RUNS_KEPT
from ..studies.folder import is_study
from ..terminal.exit_codes import DONE

_PATIENCE = 30.0
"""Time [s] for which the viewer of `retune run --view` waits for a page, once the run has ended."""


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    if options.until_end:
        _wait_for_rows(options.folders)
    if len(options.folders) == 1 and is_study(options.folders[0]):
        study = options.folders[0]
        folders = sorted(path.parent for of in ("*", f"{RUNS_KEPT}/*") for path in study.glob(f"{of}/{MANIFEST}"))
        pages = {"": WatchedStudy(study, folders)} | _own(folders)
    else:
        folders = list(dict.fromkeys(folder for path in options.folders for folder in run_folders(path)))
        pages = _pages(options.folders, folders)
    pages[""].html()  # a folder that cannot be read is refused here, and not in the browser
    try:
        server = PageServer(pages)
    except OSError as e:
        raise FolderError(f"no port is free on this machine: {e.strerror or e}.") from e
    with suppress(KeyboardInterrupt), PrivateFolder() as private:
        print(
            server.address if options.until_end else f"{server.address}  (Ctrl-C ends it)", file=sys.stderr, flush=True
        )
        if not options.no_browser:
            _open(server.address, Path(private))
        if options.until_end:
            with suppress(AttributeError, OSError):
                os.nice(5)  # the run is to have the processor
            server.serve_until_end(lambda: not any(map(is_locked, folders)), _PATIENCE)
        else:
            server.serve()
    return DONE


def _wait_for_rows(folders: Sequence[Path]) -> None:
    """Wait until runs that begin can be read, or nobody is at work on them any more."""
    while any(map(is_locked, folders)):
        with suppress(FolderError):
            read_page(folders)
            return
        sleep(0.1)


def _pages(given: Sequence[Path], folders: Sequence[Path]) -> dict[str, GrowingPage]:
    """Return the pages by path: the runs laid over one another, or of many a list and a page for each."""
    if len(folders) <= len(RUNS):
        return {"": WatchedRuns(folders)}
    return {"": WatchedList(", ".join(path.resolve().name for path in given), folders)} | _own(folders)


def _own(folders: Sequence[Path]) -> dict[str, GrowingPage]:
    """Return a page for each run, by its path."""
    return {f"run/{k}": WatchedRuns([folder]) for k, folder in enumerate(folders)}


def _open(address: str, private: Path) -> None:
    """Open the address in the user's browser, by a file: other users can read the arguments of a process."""
    page = private / "open.html"
    page.write_text(f'<!DOCTYPE html><meta http-equiv="refresh" content="0; url={address}">', encoding="utf-8")
    webbrowser.open(page.as_uri())
