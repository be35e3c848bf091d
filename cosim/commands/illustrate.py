"""`retune illustrate`."""

import argparse

from ..plots.illustrate import illustrate
from .exit_codes import DONE
from .folders import must_be_new


def command(options: argparse.Namespace) -> int:
    """Returns the exit code."""
    must_be_new(options.out, "--out")
    print(illustrate(options.out, seed=options.seed))
    return DONE
