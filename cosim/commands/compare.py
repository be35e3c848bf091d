"""`retune compare`."""

import argparse

from ..progress import bar_of_runs
from ..results.compare import compare
from ..results.record import recording
from ..scenarios.scenario import Scenario
from .exit_codes import DONE
from .folders import new_folder


def command(options: argparse.Namespace) -> int:
    """Returns the exit code."""
    scenario = Scenario.load(options.scenario, dict(options.overrides))
    name = scenario.scenario.name
    with (
        new_folder(f"{name}-compare", options.out) as folder,
        recording(folder),
        bar_of_runs(f"compare {name}") as progress,
    ):
        result = compare(scenario, options.estimators, options.seeds, options.jobs, folder, options.keep, progress)
    print(result.to_json() if options.json else result.table())
    return DONE
