"""`retune check`."""

import argparse
from pathlib import Path

from ..authoring.check import check
from ..authoring.check_fmu import check_fmu
from ..errors import ScenarioError
from ..terminal.exit_codes import DONE, REFUSED
from ..terminal.next_step import set_options, tell_next
from ..text_table import counted


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    is_fmu = options.scenario.lower().endswith(".fmu")
    if is_fmu and (options.overrides or options.dry_run):
        raise ScenarioError(f"{'--dry-run' if options.dry_run else '--set'} is for a scenario, not for an FMU.")
    findings = (
        check_fmu(Path(options.scenario))
        if is_fmu
        else check(options.scenario, dict(options.overrides), options.dry_run, options.trust)
    )
    for finding in findings:
        print(f"{options.scenario}: {finding}")
    n_errors = sum(finding.is_error for finding in findings)
    n_warnings = sum(not (finding.is_error or finding.is_note) for finding in findings)
    print(f"{options.scenario}: {counted(n_errors, 'error')}, {counted(n_warnings, 'warning')}")
    if not n_errors:
        tell_next("info" if is_fmu else "run", options.scenario, *set_options(options.overrides))
    return REFUSED if n_errors else DONE
