"""`retune doctor`."""

import argparse

from ..authoring.doctor import diagnose
from ..terminal.exit_codes import DONE, UNFINISHED


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    diagnosis = diagnose(options.fmu)
    print(diagnosis)
    return DONE if diagnosis.is_well else UNFINISHED
