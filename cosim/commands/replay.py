"""`retune replay`."""

import argparse
from contextlib import nullcontext

from ..campaigns.replay import replay
from ..runs.manifest import read_manifest, scenario_of
from ..scenarios.named import named_scenarios
from ..terminal.consent import is_consented
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder
from ..terminal.next_step import tell_next
from ..terminal.streams import answer


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    recorded = scenario_of(options.run, read_manifest(options.run))
    trust = is_consented(recorded, options.trust)
    with new_folder("replay", options.out) if options.out else nullcontext():
        result = replay(options.run, options.estimator, options.seed, options.out, trust)
    answer(result.to_json() if options.json else result.table())
    if not options.json:
        name = recorded.scenario.name if recorded.scenario.name in named_scenarios() else "SCENARIO"
        tell_next("compare", name, "--estimators", ",".join(result.estimators))
    return DONE
