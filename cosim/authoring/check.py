"""Errors and risks in a scenario, found before any of its components runs.

An error is something that `run` would refuse or that gives meaningless results; a warning may be intended. The only
code that is called is the estimator's model and the functions in `writes`, where they are the user's own: see
`check_model`. A dry run, where it is asked for, runs the FMUs too.
"""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from pydantic import ValidationError

from ..errors import CosimError, ScenarioError
from ..findings import Finding, warning
from ..fmi.archive import FmuFile
from ..fmi.component import Component, read_component
from ..fmi.table import is_table
from ..scenarios.scenario import Scenario
from ..scenarios.trust import distrusted
from ..scenarios.validation import error_texts
from ..ssp.load import load_scenario
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import component_path
from .check_estimation import (
    check_changes,
    check_parameters,
    check_sampling,
    check_tolerance,
    check_tracking,
    check_undeclared,
)
from .check_fill import check_fill
from .check_filter import check_filter
from .check_fmu import check_fmu
from .check_model import check_model, plain, split
from .check_noise import check_noise
from .check_times import check_times
from .check_wiring import check_connections, check_inputs, check_loops, check_roles, check_starts, check_steps
from .dry_run import dry_run

_CHECKS: tuple[Callable[[Scenario, Mapping[str, Component]], Iterator[Finding]], ...] = (
    check_starts, check_roles, check_connections, check_inputs, check_changes, check_tracking, check_tolerance,
    check_sampling, check_filter, check_parameters, check_undeclared, check_loops, check_steps, check_times,
)  # fmt: skip


def check(
    source: str | Path, overrides: Mapping[str, str] | None = None, is_run: bool = False, trust: bool = False
) -> list[Finding]:
    """Return all findings about a scenario, errors and warnings. Raises ScenarioError if the file is not TOML.

    is_run: where there is no error, run the FMUs for some macro steps, see `dry_run`; trust: also those of a package.
    """
    try:
        scenario = load_scenario(source, overrides, trust=trust)
    except ScenarioError as e:
        if not isinstance(e.__cause__, ValidationError):
            raise
        found = [split(text) for text in error_texts(e.__cause__, Scenario)]
        return [f for f in found if not any(other.where.startswith(f"{f.where}.") for other in found)]  # what follows
    components: dict[str, Component] = {}
    findings: list[Finding] = []
    for name, c in scenario.components.items():
        try:
            path = component_path(c, scenario.folder)
            components[name] = read_component(path)
            findings += [] if is_table(path) else _fmu_errors(name, path)
        except CosimError as e:
            findings.append(Finding(f"components.{name}", plain(e)))
    if len(components) == len(scenario.components):
        try:
            files = {name: FmuFile(name, c.description) for name, c in components.items()}
            scenario = as_the_fmus_have_it(scenario, files)
        except CosimError as e:
            return [Finding("connections", plain(e))]
    findings += [finding for one in _CHECKS for finding in one(scenario, components)]
    findings += [warning("scenario", f"it would {what}, which only --trust allows") for what in distrusted(scenario)]
    findings = [*check_fill(findings, scenario, components)]
    if not any(f.is_error for f in findings):
        findings += [*check_model(scenario, components), *check_noise(scenario)]
    if is_run and not any(f.is_error for f in findings):
        findings += dry_run(scenario)
    return findings


def _fmu_errors(name: str, fmu: Path) -> list[Finding]:
    """Return what `run` would refuse of a component's FMU beside its description: contents and library."""
    return [Finding(f"components.{name}", f"{fmu}: {f.where}: {f.what}") for f in check_fmu(fmu) if f.is_error]
