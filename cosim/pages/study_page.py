"""A page of a study: its summary, its pictures, and its runs to search and sort, with links to those that are kept."""

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np

from ..fmi.folder import PrivateFolder
from ..plots.study import draw_study
from ..studies.folder import RUNS, read_study
from ..studies.summary import StudySummary, summarised
from ..studies.table import read_results
from ..studies.texts import to_terminal
from .frame import rendered, rendered_part, script_data
from .list_page import ListedRun, cell_text

MOST_ROWS: Final = 5000
"""Runs in the table of a page: of more, the worst."""
_FIGURES: Final = ("status", "mse", "largest error", "evaluations", "triggers", "writes", "vetoes", "reverts")


def study_html(folder: Path, link: Callable[[Path], str]) -> str:
    """Return the page of a study's folder; link: the address of a run's own page. Raises FolderError."""
    study, _ = read_study(folder)
    factors = tuple(study.definition.factors)
    table = read_results(folder)
    names = ("scenario", *factors, "estimator", "seed", *_FIGURES)
    summary = summarised(table, (*names, "key", "run"))
    with PrivateFolder() as private:
        pictures = [_picture(path) for path in draw_study(Path(private), summary, factors)]
    chosen = _chosen(summary)
    rows = [_listed(folder, summary, names, k) for k in chosen]
    columns = ("run", *names, "times nominal")
    return rendered(
        "study.html.j2", title=f"{study.definition.study.name}: a study", text=to_terminal(study, summary),
        pictures=pictures, columns=columns, n=len(rows), n_all=len(table), is_live=False, has_plots=False,
        data=script_data({"is_live": False, "renderers": {}, "ranges": {}, "structure": "", "version": ""}),
        table=rendered_part("rows.html.j2", rows=rows, link=link, number=cell_text),
    )  # fmt: skip


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
