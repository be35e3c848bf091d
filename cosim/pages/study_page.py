"""A page of a study: its summary, its pictures, and its runs to search and sort, with links to those that are kept."""

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..fmi.folder import PrivateFolder
from ..plots.study import draw_study
from ..studies.folder import RUNS, read_study
from ..studies.ledger import LEDGER, open_ledger
from ..studies.summary import StudySummary, summarised
from ..studies.table import read_results, write_results
from ..studies.texts import to_terminal
from .frame import rendered, rendered_part, script_data
from .list_page import ListedRun, cell_text

MOST_ROWS: Final = 5000
"""Runs in the table of a page: of more, the worst."""
_FIGURES: Final = ("status", "mse", "largest error", "evaluations", "triggers", "writes", "vetoes", "reverts")


def study_html(folder: Path, link: Callable[[Path], str], is_live: bool = False) -> str:
    """Return the page of a study's folder; link: the address of a run's own page. Raises FolderError.

    is_live: of a study that goes on, by its ledger; a page that asks for what is new.
    """
    study, _ = read_study(folder)
    shown = _shown(folder, link, is_live)
    return rendered(
        "study.html.j2", title=f"{study.definition.study.name}: a study", is_live=is_live, has_plots=False,
        data=script_data({"is_live": is_live, "renderers": {}, "ranges": {}, "structure": "", "version": ""}), **shown,
    )  # fmt: skip


def study_news(folder: Path, link: Callable[[Path], str]) -> dict[str, Any]:
    """Return what a page that is open has to change, as JSON values. Raises FolderError."""
    shown = _shown(folder, link, True)
    return {
        "structure": "",
        "columns": {},
        "ranges": {},
        "parts": {"summary": shown["summary"], "rows": shown["table"]},
    }


def _shown(folder: Path, link: Callable[[Path], str], is_live: bool) -> dict[str, Any]:
    study, _ = read_study(folder)
    factors = study.definition.factor_names
    names = ("scenario", *factors, "estimator", "seed", *_FIGURES)
    with PrivateFolder() as private:
        if is_live:
            with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
                write_results(Path(private), ledger)
        table = read_results(Path(private) if is_live else folder)
        summary = summarised(table, (*names, "key", "run"))
        pictures = [_picture(path) for path in draw_study(Path(private), summary, factors)]
    rows = [_listed(folder, summary, names, k) for k in _chosen(summary)]
    return {
        "columns": ("run", *names, "times nominal"), "n": len(rows), "n_all": len(table),
        "summary": rendered_part("summary.html.j2", text=to_terminal(study, summary), pictures=pictures),
        "table": rendered_part("rows.html.j2", rows=rows, link=link, number=cell_text),
    }  # fmt: skip


def _chosen(summary: StudySummary) -> list[int]:
    """Return the numbers of the rows on the page, in the order of the table."""
    n = len(summary.ratio)
    if n <= MOST_ROWS:
        return list(range(n))
    is_ended_early = np.isin(summary.columns["status"], ("diverged", "faulted", "refused", "lost"))
    badness = np.where(is_ended_early, np.inf, np.nan_to_num(summary.ratio, nan=-1.0))
    return sorted(np.argsort(-badness, kind="stable")[:MOST_ROWS].tolist())


def _listed(folder: Path, summary: StudySummary, names: tuple[str, ...], k: int) -> ListedRun:
    run = summary.columns["run"][k]
    is_kept = isinstance(run, str)
    cells = [_cell(summary.columns[name][k]) for name in names]
    place = folder / RUNS / run if is_kept else None
    return ListedRun(place, (run if is_kept else str(summary.columns["key"][k])[:8], *cells, _cell(summary.ratio[k])))


def _cell(value: Any) -> str | float | None:
    plain = value.item() if isinstance(value, np.generic) else value
    return None if plain is None or plain != plain else plain


def _picture(path: Path) -> dict[str, str]:
    return {"name": path.stem, "data": base64.b64encode(path.read_bytes()).decode()}
