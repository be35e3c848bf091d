"""`retune figures`."""

import argparse

from ..plots.figures import figures
from ..progress import bar_of_runs
from ..results.record import recording
from .exit_codes import DONE
from .folders import new_folder


def command(options: argparse.Namespace) -> int:
    """Returns the exit code."""
    with new_folder("figures", options.out) as folder, recording(folder), bar_of_runs("figures") as progress:
        paths = figures(folder, options.seed, options.jobs, progress)
    for path in paths:
        print(path)
    return DONE
