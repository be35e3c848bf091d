"""`retune illustrate`."""

import argparse

from ..paper.illustration import illustrate
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    must_be_new(options.out, "--out")
    print(illustrate(options.out, seed=options.seed))
    tell_next("run", "pendulum", "--estimator", "paper")
    return DONE
