"""`retune study`."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from ..errors import FolderError, ScenarioError
from ..files import to_json
from ..runs.lock import is_locked, locked
from ..scenarios.named import named_scenarios
from ..ssp.load import load_scenario
from ..studies.conduct import planned
from ..studies.definition import StudyDefinition, checked_definition, read_definition
from ..studies.dry_run import dry_run
from ..studies.folder import is_study, open_study, read_study
from ..studies.ledger import LEDGER, open_ledger
from ..studies.plan import Study
from ..terminal.consent import consented
from ..terminal.exit_codes import DONE
from ..terminal.folders import new_folder
from ..terminal.next_step import line_of
from ..terminal.streams import answer
from ..terminal.study_output import carry_on, tell_study, telling_how_to_go_on
from ..text_table import counted


def command(options: argparse.Namespace) -> int:
    """Run the command; return the exit code."""
    first, *others = options.study
    if first == "status" and len(others) == 1:
        return _status(Path(others[0]), options.json)
    path = Path(first)
    if others or (first == "status" and not path.exists()):
        raise ScenarioError(f"give one study, or `status` and one folder; got '{' '.join(options.study)}'.")
    if first in named_scenarios() and not path.exists():
        raise ScenarioError(f"{first} is a scenario; a study's file names it in its `scenarios`: see docs/studies.md.")
    definition = restricted(read_definition(path), options.estimators, options.seeds, first)
    study = loaded(definition, path.parent, options.trust)
    if options.dry_run:
        print(dry_run(study, planned(study), options.jobs))
        return DONE
    return make(study, options)


def restricted(
    definition: StudyDefinition, estimators: Sequence[str] | None, seeds: int | None, label: str
) -> StudyDefinition:
    """Return the part of a study with these of its estimators and its first seeds: the scenarios that have any.

    Raises ScenarioError for an estimator that none has.
    """
    if unknown := [name for name in estimators or () if name not in definition.estimators]:
        raise ScenarioError(f"{label}: its estimators are {', '.join(definition.estimators)}, not {unknown[0]}.")
    tables: Any = definition.model_dump(mode="json", by_alias=True, exclude_none=True)
    for table in (tables["study"], *tables["scenarios"].values()):
        if estimators is not None and "estimators" in table:
            table["estimators"] = [name for name in table["estimators"] if name in estimators]
        if "seeds" in table:
            table["seeds"] = _first(table["seeds"], seeds, estimators)
    if estimators is not None:
        has_any = {
            name: not set(definition.at(name).study.estimators).isdisjoint(estimators)
            for name in definition.study.scenarios
        }
        tables["study"]["scenarios"] = [name for name, its in has_any.items() if its]
        tables["scenarios"] = {name: its for name, its in tables["scenarios"].items() if has_any[name]}
        tables["study"]["estimators"] = tables["study"]["estimators"] or [*estimators]  # each scenario has its own then
        tables["study"]["seeds"] = tables["study"]["seeds"] or 1  # and its own seeds
    return checked_definition(tables, label)


def _first(seeds: Any, n: int | None, estimators: Sequence[str] | None) -> Any:
    """Return the first n seeds, or their numbers by estimator."""
    if isinstance(seeds, dict):
        counts = cast(dict[str, int], seeds).items()
        return {name: min(own, n or own) for name, own in counts if estimators is None or name in estimators}
    return seeds if n is None else min(seeds, n) if isinstance(seeds, int) else seeds[:n]


def loaded(definition: StudyDefinition, folder: Path, trust: bool) -> Study:
    """Return the study of a definition; folder: where paths of scenarios begin. Raises CosimError."""
    names = named_scenarios()
    labels = [name if name in names else str(folder / name) for name in definition.study.scenarios]
    return Study(definition, tuple(consented(load_scenario(label), trust) for label in labels), tuple(labels))


def make(study: Study, options: argparse.Namespace) -> int:
    """Make the runs of a study in a new folder, or what is new in an earlier one; return the exit code."""
    runs, name = planned(study), study.definition.study.name
    out: Path | None = options.out
    if out is not None and is_study(out):
        former, kind = read_study(out)
        if kind != "study" or former.definition.study.name != name:
            raise FolderError(f"{out} holds the {kind} '{former.definition.study.name}', not the study '{name}'.")
        with locked(out), telling_how_to_go_on(out), open_study(out, study, "study") as ledger:
            carry_on(study, runs, ledger, out, "study", options)
            return tell_study(study, ledger, out, options.json)
    with (
        new_folder(f"{name}-study", out) as folder,
        telling_how_to_go_on(folder),
        open_study(folder, study, "study") as ledger,
    ):
        carry_on(study, runs, ledger, folder, "study", options)
        return tell_study(study, ledger, folder, options.json)


def _status(folder: Path, is_json: bool) -> int:
    """Print how far a study is. It only reads."""
    study, _ = read_study(folder)
    with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
        counts, why = ledger.counts(), ledger.reasons()
    is_running = is_locked(folder)
    if is_json:
        answer(to_json({"study": study.definition.study.name, "runs": counts, "is_running": is_running}))
        return DONE
    n = sum(counts.values())
    ended = n - counts["queued"] - counts["leased"]
    state = (
        "is running"
        if is_running
        else "has ended"
        if ended == n
        else f"was stopped: {line_of('resume', folder)} goes on"
    )
    print(f"{study.definition.study.name}: {ended} of {counted(n, 'run')} ended; it {state}")
    print(", ".join(f"{count} {name}" for name, count in counts.items() if count) or "no run is planned yet")
    for text, count in why:
        print(f"{counted(count, 'time')}: {text}")
    return DONE
