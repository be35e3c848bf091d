"""`retune info`."""

import argparse
from dataclasses import asdict

from ..files import to_json
from ..fmi.lazy_fmpy import load_fmpy_lazily
from ..terminal.exit_codes import DONE
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    load_fmpy_lazily()
    from ..authoring.info import info

    found = info(options.fmu)
    print(to_json(asdict(found)) if options.json else found)
    if not options.json:
        print()
        tell_next("new", "--plant", options.fmu, "-o", "my.toml")
    return DONE
