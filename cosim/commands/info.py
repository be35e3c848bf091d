"""`retune info`."""

import argparse
from dataclasses import asdict

from ..authoring.info import info
from ..files import to_json
from ..terminal.exit_codes import DONE
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    found = info(options.fmu)
    print(to_json(asdict(found)) if options.json else found)
    if not options.json:
        print()
        tell_next("new", "--plant", options.fmu, "-o", "my.toml")
    return DONE
