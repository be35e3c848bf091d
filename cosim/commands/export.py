"""`retune export`."""

import argparse

from ..errors import FolderError
from ..files import write_bytes
from ..ssp.load import load_scenario
from ..ssp.start_values import with_start_values
from ..ssp.write import to_ssp
from ..terminal.exit_codes import DONE
from ..terminal.next_step import tell_next


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    content = to_ssp(with_start_values(load_scenario(options.scenario, dict(options.overrides)), options.start_values))
    verb = "written"
    if options.ssp.exists():
        verb = "unchanged" if options.ssp.is_file() and options.ssp.read_bytes() == content else "replaced"
    if verb == "replaced" and not options.force:
        raise FolderError(f"{options.ssp} exists and differs; give --force or another --ssp.")
    if verb != "unchanged":
        write_bytes(options.ssp, content)
    print(f"{options.ssp}  {verb}")
    tell_next("run", options.ssp)
    return DONE
