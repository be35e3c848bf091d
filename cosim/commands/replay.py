"""`retune replay`."""

import argparse
from contextlib import nullcontext

from ..campaigns.replay import replay
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    with new_folder("replay", options.out) if options.out else nullcontext():
        result = replay(options.run, options.estimator, options.seed, options.out)
    print(result.to_json() if options.json else result.table())
    return DONE
