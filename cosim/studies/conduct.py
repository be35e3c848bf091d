"""The conduct of a study: its runs are planned in the ledger, made by an engine, and committed."""

from collections.abc import Callable
from pathlib import Path

from ..errors import FolderError, ScenarioError
from ..system.fmu_cache import fmu_paths
from .engines import engine_for, jobs_here
from .folder import RUNS, StudyKind, run_folder
from .head import Head, StudyProgress, remove_uncommitted
from .ledger import Ledger
from .plan import PlannedRun, Study


def planned(study: Study) -> dict[str, PlannedRun]:
    """Return the runs of a study by key, in the order of the table.

    Raises ScenarioError for one that cannot be run, and for two that are the same.
    """
    runs: dict[str, PlannedRun] = {}
    for run in study.runs():
        if (other := runs.setdefault(run.key, run)) is not run:
            raise ScenarioError(f"{study.told(run)}: the same run as {study.told(other)}; leave one of them out.")
    for scenario in study.sources:
        fmu_paths(scenario)  # built here once, not by several processes at the same time
    return runs


def enter(study: Study, runs: dict[str, PlannedRun], ledger: Ledger, is_resumed: bool = False) -> None:
    """Enter the runs into the ledger. Raises FolderError where a study that is resumed is not what it was."""
    if is_resumed and (n := len(runs.keys() - ledger.keys())):
        raise FolderError(
            f"{n} of {len(runs)} runs are not as they were planned: an FMU, a module of yours or a package has changed "
            "since; retune study FILE.toml --out makes them anew."
        )
    ledger.plan((key, study.point_of(run)) for key, run in runs.items())


def conduct(
    study: Study,
    runs: dict[str, PlannedRun],
    ledger: Ledger,
    folder: Path | None,
    kind: StudyKind = "study",
    jobs: int | None = None,
    on: str | None = None,
    is_plain: bool = False,
    progress: StudyProgress | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Make the runs that the ledger has queued. folder: that of the study, if it has one.

    tell: is given a line about the engine. Raises CosimError where the study cannot go on; what is done stays done.
    """
    is_kept = study.definition.study.keep and folder is not None
    place = None if folder is None else folder if kind == "compare" else folder / RUNS
    if not ledger.counts()["queued"]:
        return
    try:
        if is_kept and place is not None:
            remove_uncommitted(place)
            place.mkdir(exist_ok=True)
        with engine_for(on, jobs_here(jobs, len(runs)), is_plain) as engine:
            if engine.dashboard:
                tell(f"Dask's own page: {engine.dashboard}")
            folder_of = (lambda run: run_folder(folder, kind, run)) if is_kept and folder is not None else None
            Head(study, ledger, engine, folder_of, is_compared=kind == "compare").make(runs, progress)
    finally:
        if is_kept and place is not None:
            remove_uncommitted(place)
