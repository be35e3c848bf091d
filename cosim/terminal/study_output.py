"""Functions shared by `study`, `compare` and `resume`: a study that goes on, and what is told at its end."""

import argparse
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ..errors import UnfinishedError
from ..files import to_json, write_text
from ..runs.record import recording
from ..studies.conduct import conduct, enter
from ..studies.folder import StudyKind, is_study
from ..studies.ledger import Ledger
from ..studies.plan import PlannedRun, Study
from ..studies.summary import StudySummary, summarised
from ..studies.table import read_results, write_results
from ..studies.texts import to_markdown, to_terminal
from .exit_codes import DONE, UNFINISHED
from .next_step import line_of
from .progress import bar_of_runs
from .streams import answer


def carry_on(
    study: Study,
    runs: dict[str, PlannedRun],
    ledger: Ledger,
    folder: Path,
    kind: StudyKind,
    options: argparse.Namespace,
    is_resumed: bool = False,
) -> None:
    """Make the runs of a study that are still to be made, with a progress bar. Raises CosimError."""
    enter(study, runs, ledger, is_resumed)
    if is_resumed:
        ledger.retry(at_once=kind == "compare")  # whose tables need every run
    with recording(folder), bar_of_runs(f"{kind} {study.definition.study.name}") as progress:
        conduct(
            study, runs, ledger, folder, kind, options.jobs, options.on, options.plain, progress,
            tell=lambda line: print(line, file=sys.stderr),
        )  # fmt: skip


def tell_study(study: Study, ledger: Ledger, folder: Path, is_json: bool) -> int:
    """Write a study's table, summary and pictures, print the summary; return the exit code. Raises FolderError."""
    with recording(folder):
        write_results(folder, ledger)
        summary = summarised(read_results(folder), study.definition.factor_names)
        write_text(folder / "summary.md", to_markdown(study, summary))  # whatever becomes of the pictures
    counts = ledger.counts()
    answer(to_json(_figures(study, summary, folder) | {"runs": counts}) if is_json else to_terminal(study, summary))
    with recording(folder):
        from ..plots.study import draw_study  # after the runs: what draws takes half a second to load

        pictures = draw_study(folder, summary, study.definition.factor_names)
        write_text(folder / "summary.md", to_markdown(study, summary, [path.name for path in pictures]))
    if not is_json:
        print(f"\nwritten to {folder}")
    return UNFINISHED if counts["refused"] or counts["lost"] else DONE


def _figures(study: Study, summary: StudySummary, folder: Path) -> dict[str, object]:
    """Return a study's figures as JSON values."""
    rows = [
        {
            "scenario": row.scenario, "estimator": row.estimator, "statuses": row.statuses,
            "mse": dict(zip(("median", "p95", "worst"), row.mse, strict=True)), "ratio": row.ratio,
            **{name: {"n": share.n, "of": share.of, "interval": share.interval if share.of else None}
               for name, share in (("better", row.better), ("worse", row.worse))},
        }
        for row in summary.rows()
    ]  # fmt: skip
    return {"study": study.definition.study.name, "folder": str(folder), "estimators": rows}


@contextmanager
def telling_how_to_go_on(folder: Path) -> Generator[None]:
    """Add to an interrupt, or to what ends a study before its time, the command that goes on with it."""
    try:
        yield
    except KeyboardInterrupt as e:
        if not is_study(folder):
            raise
        raise KeyboardInterrupt(f"what is done stays done; {line_of('resume', folder)} goes on") from e
    except UnfinishedError as e:
        if not is_study(folder) or "retune resume" in str(e):
            raise
        raise type(e)(f"{e} {line_of('resume', folder)} goes on.") from e
