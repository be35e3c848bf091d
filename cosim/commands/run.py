"""`retune run`."""

import argparse
from functools import partial
from pathlib import Path

from ..errors import SspError, told_at
from ..files import write_bytes
from ..retuning.estimators import check_estimator
from ..runs.record import recording
from ..runs.run_files import ESTIMATES
from ..runs.simulation import run
from ..scenarios.trust import with_own
from ..ssp.load import load_scenario
from ..ssp.start_values import with_start_values
from ..terminal.consent import consented
from ..terminal.folders import must_be_new, new_folder
from ..terminal.run_output import BASELINES, simulated, tell, telling_how_to_resume
from ..terminal.viewer import show_in_browser


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    is_package = options.scenario.lower().endswith(".ssp") and Path(options.scenario).is_file()
    if is_package and not options.tables and _has_no_scenario(Path(options.scenario)):
        from .run_package import run_package

        return run_package(options)
    if options.tables and not is_package:
        raise SspError(f"--scenario goes with an SSP package, got '{options.scenario}'.")
    source, system = (options.tables, options.scenario) if options.tables else (options.scenario, None)
    scenario = load_scenario(source, dict(options.overrides), system)
    scenario = with_own(consented(scenario, options.trust), options.estimator)
    scenario = with_start_values(scenario, options.start_values)
    check_estimator(options.estimator, scenario)
    must_be_new(options.ssv, "--ssv")
    is_alone = options.only or options.estimator in BASELINES
    with new_folder(scenario.scenario.name, options.out) as folder, telling_how_to_resume(folder), told_at(source):
        estimators = {folder: options.estimator} | ({} if is_alone else {folder / name: name for name in BASELINES})
        for path in estimators:
            path.mkdir(exist_ok=True)  # empty: a run that is still to be made, also by `resume`
        if options.view:
            show_in_browser(folder)
        runs = {
            path: simulated(scenario, name, partial(run, scenario, name, options.seed, path))
            for path, name in estimators.items()
        }
        if options.ssv and len(runs[folder].time):
            with recording(options.ssv.parent):
                write_bytes(options.ssv, (folder / ESTIMATES).read_bytes())
        return tell(folder, runs, options.json, not options.only)


def _has_no_scenario(package: Path) -> bool:
    from ..ssp.scenario import scenario_in  # what few runs need is loaded when they need it

    return scenario_in(package) is None
