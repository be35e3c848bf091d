"""`retune resume`."""

import argparse
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..campaigns.compare import compared
from ..errors import FolderError
from ..runs.lock import locked
from ..runs.manifest import read_manifest, scenario_of
from ..runs.record import recording
from ..runs.result import Run, read_run, remove_half_written
from ..runs.resumable import has_begun, has_ended
from ..runs.simulation import resume, run
from ..scenarios.trust import trusted
from ..studies.conduct import planned
from ..studies.engines import jobs_here
from ..studies.folder import is_study, read_study
from ..studies.ledger import LEDGER, open_ledger
from ..terminal.consent import consented, is_consented
from ..terminal.exit_codes import DONE
from ..terminal.run_output import BASELINES, simulated, tell, telling_how_to_resume
from ..terminal.streams import answer
from ..terminal.study_output import carry_on, tell_study, telling_how_to_go_on


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    folder: Path = options.run
    if is_study(folder):
        return _resume_study(folder, options)
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


def _resume_study(folder: Path, options: argparse.Namespace) -> int:
    """Go on with a study or a comparison; return the exit code."""
    study, kind = read_study(folder)
    study = replace(study, sources=tuple(consented(scenario, options.trust) for scenario in study.sources))
    with locked(folder), telling_how_to_go_on(folder), open_ledger(folder / LEDGER) as ledger:
        runs = planned(study)
        carry_on(study, runs, ledger, folder, kind, options, is_resumed=True)
        if kind == "study":
            return tell_study(study, ledger, folder, options.json)
        with recording(folder):
            comparison = compared(study, ledger, jobs_here(options.jobs, len(runs)), folder)
    answer(comparison.to_json() if options.json else comparison.table())
    return DONE


def _is_trusted(folder: Path, trust: bool) -> bool:
    """Return whether the user trusts what a run folder names. Raises FolderError, ScenarioError."""
    manifest = read_manifest(folder)
    return is_consented(scenario_of(folder, manifest), trust, manifest.estimator)
