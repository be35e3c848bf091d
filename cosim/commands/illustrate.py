"""`retune illustrate`."""

import argparse

from ..paper.illustration import illustrate
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    must_be_new(options.out, "--out")
    print(illustrate(options.out, seed=options.seed))
    return DONE
