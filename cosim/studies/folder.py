"""The folder of a study: its definition and scenarios, sealed and signed, beside the ledger and what comes out."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Literal, cast

from pydantic import ValidationError

from ..errors import CosimError, FolderError
from ..runs.manifest import read_sealed, write_manifest
from ..scenarios.scenario import Scenario
from ..user_code import CodeOrigin
from .definition import StudyDefinition
from .ledger import LEDGER, Ledger, open_ledger
from .plan import PlannedRun, Study

STUDY: Final = "study.json"
"""File name of a study's definition."""
RUNS: Final = "runs"
"""Folder of the run folders that are kept."""
StudyKind = Literal["study", "compare"]
_FORMAT: Final = 1


def is_study(folder: Path) -> bool:
    """Return whether a folder is that of a study."""
    return (folder / STUDY).is_file()


def run_folder(folder: Path, kind: StudyKind, run: PlannedRun) -> Path:
    """Return the folder of a run that is kept; folder: that of the study."""
    name = f"{run.estimator.replace(':', '.')}-{run.seed}"
    return folder / name if kind == "compare" else folder / RUNS / f"{name}-{run.key[:8]}"


def write_study(folder: Path, study: Study, kind: StudyKind) -> None:
    """Write what a study is, so that it can go on without the files that it was made from but FMUs and modules.

    Raises FolderError.
    """
    scenarios = [
        {
            "folder": str(scenario.folder.resolve()),
            "scenario": scenario.model_dump(mode="json"),
            "stranger": scenario.origin.stranger,
            "own": sorted(scenario.origin.own),
        }
        for scenario in study.sources
    ]
    definition = study.definition.model_dump(mode="json", by_alias=True, exclude_none=True)
    content = {
        "format": _FORMAT,
        "kind": kind,
        "definition": definition,
        "labels": study.labels,
        "scenarios": scenarios,
    }
    write_manifest(folder, content, is_own=True, name=STUDY)


def read_study(folder: Path) -> tuple[Study, StudyKind]:
    """Return the study of a folder, a stranger's unless this user has made it, and its kind. Raises FolderError."""
    if not is_study(folder):
        raise FolderError(f"{folder} is no study's folder: it has no {STUDY}.")
    content, is_own = read_sealed(folder, STUDY)
    try:
        if content["format"] != _FORMAT:
            raise FolderError(f"{folder} is a study of another version: format {content['format']}.")
        definition = StudyDefinition.model_validate(content["definition"])
        sources = tuple(_scenario_of(table, "" if is_own else str(folder)) for table in content["scenarios"])
        kind = "compare" if content["kind"] == "compare" else "study"
        return Study(definition, sources, tuple(map(str, content["labels"]))), kind
    except (ValidationError, KeyError, TypeError) as e:
        raise FolderError(f"{folder} is a study of another version: {STUDY} cannot be read.") from e


@contextmanager
def open_study(folder: Path | None, study: Study, kind: StudyKind) -> Generator[Ledger]:
    """Yield the ledger of a study, in its folder, if it has one, beside its definition; closed at the end.

    Both are removed again where an error comes before a run has ended. Raises FolderError.
    """
    if folder is None:
        with open_ledger(":memory:") as ledger:
            yield ledger
        return
    write_study(folder, study, kind)
    with open_ledger(folder / LEDGER) as ledger:
        try:
            yield ledger
        except BaseException:
            with suppress(CosimError):
                if not ledger.has_results():
                    ledger.close()
                    for name in (STUDY, LEDGER, f"{LEDGER}-wal", f"{LEDGER}-shm"):
                        (folder / name).unlink(missing_ok=True)
            raise


def _scenario_of(table: Any, stranger: str) -> Scenario:
    content = cast(dict[str, Any], table)
    origin = CodeOrigin(stranger or str(content["stranger"]), frozenset() if stranger else frozenset(content["own"]))
    return Scenario.model_validate(content["scenario"] | {"folder": Path(content["folder"]), "origin": origin})
