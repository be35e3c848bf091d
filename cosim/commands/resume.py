"""`retune resume`."""

import argparse
from functools import partial
from pathlib import Path

from ..errors import FolderError
from ..runs.lock import locked
from ..runs.manifest import read_manifest, scenario_of
from ..runs.result import Run, read_run, remove_half_written
from ..runs.resumable import has_begun, has_ended
from ..runs.simulation import resume, run
from ..scenarios.trust import trusted
from ..terminal.consent import is_consented
from ..terminal.run_output import BASELINES, simulated, tell, telling_how_to_resume


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    folder: Path = options.run
    begun = read_manifest(folder)
    scenario = scenario_of(folder, begun)
    scenario = trusted(scenario) if is_consented(scenario, options.trust, begun.estimator) else scenario
    estimators = {folder: begun.estimator} | {folder / n: n for n in BASELINES if (folder / n).is_dir()}
    if all(map(has_ended, estimators)):
        raise FolderError(f"{folder} cannot be resumed: it is {begun.status}.")
    runs: dict[Path, Run] = {}
    with locked(folder), telling_how_to_resume(folder):
        for path, name in estimators.items():
            if has_ended(path):
                runs[path] = read_run(path)
                continue
            if has_begun(path):
                go_on = partial(resume, path, trust=_is_trusted(path, options.trust))
            else:
                remove_half_written(path)
                go_on = partial(run, scenario, name, begun.seed, path)
            runs[path] = simulated(scenario, name, go_on)
        return tell(folder, runs, options.json, len(runs) > 1 or begun.estimator in BASELINES)


def _is_trusted(folder: Path, trust: bool) -> bool:
    """Return whether the user trusts what a run folder names. Raises FolderError, ScenarioError."""
    manifest = read_manifest(folder)
    return is_consented(scenario_of(folder, manifest), trust, manifest.estimator)
