"""`retune plot`."""

import argparse
from pathlib import Path

from ..errors import FolderError
from ..plots.canvas import save_png, save_svg
from ..plots.overlay import draw_overlay
from ..plots.palette import RUNS
from ..runs.record import recording
from ..runs.result import read_run
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    out: Path = options.out
    save = {".png": save_png, ".svg": save_svg}.get(out.suffix.lower())
    if save is None:
        raise FolderError(f"{out} must end in .png or .svg.")
    must_be_new(out, "--out")
    if len(options.runs) > len(RUNS):
        raise FolderError(f"a picture has room for {len(RUNS)} runs, got {len(options.runs)}; `report` takes more.")
    figure = draw_overlay([read_run(folder) for folder in options.runs])
    with recording(out.parent):
        print(save(figure, out))
    return DONE
