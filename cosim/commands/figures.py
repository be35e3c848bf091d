"""`retune figures`."""

import argparse

from ..paper.figures import figures
from ..runs.record import recording
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder
from ..terminal.next_step import tell_next
from ..terminal.progress import bar_of_runs


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    with new_folder("figures", options.out) as folder, recording(folder), bar_of_runs("figures") as progress:
        paths = figures(folder, options.seed, options.jobs, progress)
    for path in paths:
        print(path)
    tell_next("compare", "quadrotor")
    return DONE
