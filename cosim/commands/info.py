"""`retune info`."""

import argparse
from dataclasses import asdict

from ..files import to_json
from ..fmi.lazy_fmpy import load_fmpy_lazily
from ..terminal.exit_codes import DONE
from ..terminal.next_step import tell_next
from ..terminal.streams import answer


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    load_fmpy_lazily()
    from ..authoring.info import info

    found = info(options.fmu)
    answer(to_json(asdict(found)) if options.json else str(found))
    if not options.json:
        print()
        tell_next("new", "--plant", options.fmu, "-o", "my.toml")
    return DONE
