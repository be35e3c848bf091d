"""`retune run` of a package from another tool, which does not say what to estimate."""

import argparse
import sys

from ..errors import SspError
from ..files import to_json
from ..ssp.package import SystemStructure
from ..ssp.run import report, simulate
from ..ssp.settings import overridden
from ..terminal.exit_codes import DONE, UNFINISHED
from ..terminal.folders import new_folder
from ..terminal.next_step import tell_next
from ..terminal.streams import answer


def run_package(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    if options.ssv or options.view or options.estimator not in ("target", "none"):
        raise SspError(f"{options.scenario} holds no scenario: nothing is estimated in it; give --scenario FILE.")
    system, settings = overridden(
        SystemStructure.from_ssp(options.scenario), dict(options.overrides), options.start_values
    )
    with new_folder(settings.name, options.out) as folder:
        result = simulate(system, settings, folder)
    answer(to_json(result.summary()) if options.json else report(result))
    if not options.json and not result.error:
        tell_next("run", options.scenario, "--scenario", "FILE.toml")
    if result.error:
        print(f"retune: {result.error}; the rows so far are in {folder}.", file=sys.stderr)
        return UNFINISHED
    return DONE
