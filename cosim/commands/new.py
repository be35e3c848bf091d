"""`retune new`."""

import argparse

from ..authoring.draft import draft
from ..files import write_text
from ..terminal.exit_codes import DONE
from ..terminal.folders import must_be_new
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    must_be_new(options.out, "-o")
    given = {"plant": options.plant, "controller": options.controller, "reference": options.reference}
    written = draft({name: path for name, path in given.items() if path}, options.out.parent, options.model)
    write_text(options.out, written.text)
    print(f"{options.out}  written")
    for mark, what in (("FILL", "to fill in"), ("GUESS", "to look at")):
        for number, line in written.lines(mark):
            print(f"{options.out}:{number}: {what}: {' '.join(line.split())}")
    tell_next("check", options.out)
    return DONE
