"""`retune completion`."""

import argparse

from ..terminal.completion import script
from ..terminal.exit_codes import DONE


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    print(script(options.shell))
    return DONE
