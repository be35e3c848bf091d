"""`retune compare`."""

import argparse

from ..campaigns.compare import compare
from ..runs.record import recording
from ..ssp.load import load_scenario
from ..terminal.consent import consented
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder
from ..terminal.next_step import set_options, tell_next
from ..terminal.progress import bar_of_runs
from ..terminal.run_output import BASELINES


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    scenario = consented(load_scenario(options.scenario, dict(options.overrides)), options.trust)
    name = scenario.scenario.name
    with (
        new_folder(f"{name}-compare", options.out) as folder,
        recording(folder),
        bar_of_runs(f"compare {name}") as progress,
    ):
        result = compare(scenario, options.estimators, options.seeds, options.jobs, folder, options.keep, progress)
    print(result.to_json() if options.json else result.table())
    if not options.json:
        name = next((name for name in result.estimators if name not in BASELINES), "target")
        tell_next("run", options.scenario, "--estimator", name, *set_options(options.overrides))
    return DONE
