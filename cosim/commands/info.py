"""`retune info`."""

import argparse
from dataclasses import asdict

from ..authoring.info import info
from ..files import to_json
from ..terminal.exit_codes import DONE


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    found = info(options.fmu)
    print(to_json(asdict(found)) if options.json else found)
    return DONE
