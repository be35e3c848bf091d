"""`retune doctor`."""

import argparse

from ..authoring.doctor import diagnose
from ..terminal.exit_codes import DONE, UNFINISHED


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    examination = diagnose(options.fmu)
    print(examination)
    return DONE if examination.is_well else UNFINISHED
