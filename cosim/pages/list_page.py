"""A page of many runs: a table to search and sort, a picture of their errors, and links to the runs."""

import os.path
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, HoverTool, PlainText, Range1d
from bokeh.plotting import figure

from ..errors import FolderError
from ..plots.palette import BLUE
from ..runs.manifest import read_json
from ..runs.run_files import MANIFEST, RESULT, SERIES
from ..studies.folder import RUNS, is_study
from .frame import rendered, rendered_part, script_data

COLUMNS: Final = (
    "run", "scenario", "estimator", "seed", "status", "mean squared error", "largest error", "evaluations", "written",
    "vetoed", "reverted", "disturbances", "wall time [s]",
)  # fmt: skip
"""Columns of the table; `run` has the link."""


@dataclass(frozen=True)
class ListedRun:
    """A row of the table."""

    folder: Path | None
    """Run folder; None where none is kept."""
    cells: tuple[str | float | None, ...]
    """Cells in the order of the columns; None where a figure is missing."""


def run_folders(path: Path) -> list[Path]:
    """Return the run folder, or those in a folder of runs or of a study, by name. Raises FolderError."""
    if (path / MANIFEST).exists() or (path / SERIES).exists():  # a run folder without its manifest is no folder of runs
        return [path]
    if is_study(path) and (path / RUNS).is_dir():
        path = path / RUNS
    try:
        found = sorted(folder for folder in path.iterdir() if (folder / MANIFEST).is_file())
    except OSError as e:
        raise FolderError(f"{path} is no run folder, nor a folder of runs: {e.strerror or e}.") from e
    if not found:
        raise FolderError(f"{path} holds no run: neither {MANIFEST} nor folders with one.")
    return found


def listed(folder: Path) -> ListedRun:
    """Return the row of a run folder, without reading its series; one that cannot be read says why."""
    try:
        manifest = read_json(folder, MANIFEST, dict[str, Any])
        result = read_json(folder, RESULT, dict[str, Any]) if (folder / RESULT).exists() else {}
        name = manifest["scenario"]["scenario"]["name"]
        about = (folder.name, name, manifest["estimator"], manifest["seed"], manifest["status"])
    except (FolderError, KeyError, TypeError) as e:
        why = str(e) if isinstance(e, FolderError) else f"{folder} holds no readable run"
        return ListedRun(folder, (folder.name, None, None, None, why, *[None] * (len(COLUMNS) - 5)))
    guard, diagnosis = (found if isinstance(found := result.get(k), dict) else {} for k in ("guard", "diagnosis"))
    mse = result.get("mse")
    errors = [e for e in mse if isinstance(e, int | float)] if isinstance(mse, list) else []
    figures = (result.get("max_error"), result.get("evaluations"), guard.get("written"), guard.get("vetoed"))
    rest = (guard.get("reverted"), diagnosis.get("disturbance"), result.get("wall_s"))
    return ListedRun(folder, (*about, sum(errors) if errors else None, *figures, *rest))


def list_html(title: str, rows: Sequence[ListedRun], link: Callable[[Path], str], is_live: bool = False) -> str:
    """Return the page of many runs; link: the address of a run's own page."""
    points = _points(rows)
    data: dict[str, Any] = {
        "is_live": is_live,
        "renderers": {},
        "ranges": {},
        "structure": _structure(points),
        "version": "",
    }
    if points.name:
        data["item"] = json_item(_errors(points))
    return rendered(
        "list.html.j2", title=title, columns=COLUMNS, n=len(rows), is_live=is_live, has_plots=bool(points.name),
        data=script_data(data), table=_table(rows, link),
    )  # fmt: skip


def list_news(rows: Sequence[ListedRun], link: Callable[[Path], str]) -> dict[str, Any]:
    """Return what a page that is open has to change, as JSON values."""
    points = _points(rows)
    columns = {"errors": {"x": points.x, "y": points.y, "name": points.name}} if points.name else {}
    return {"structure": _structure(points), "columns": columns, "ranges": {}, "parts": {"rows": _table(rows, link)}}


def _table(rows: Sequence[ListedRun], link: Callable[[Path], str]) -> str:
    return rendered_part("rows.html.j2", rows=rows, link=link, number=cell_text)


def link_from(page: Path) -> Callable[[Path], str]:
    """Return the function that gives, from a page's file, the address of a run's report, or else of its folder."""

    def link(folder: Path) -> str:
        report = folder / "report.html"
        target = report if report.is_file() else folder
        return quote(Path(os.path.relpath(target, page.parent)).as_posix())

    return link


class _Points(NamedTuple):
    """Points of the picture of the errors."""

    groups: list[str]
    x: list[float]
    y: list[float]
    name: list[str]


def _points(rows: Sequence[ListedRun]) -> _Points:
    """Return the mean squared errors above zero by estimator, those of one side by side."""
    places = [COLUMNS.index(c) for c in ("run", "estimator", "mean squared error")]
    found = [[row.cells[i] for i in places] for row in rows]
    shown = [(str(n), str(e), float(m)) for n, e, m in found if isinstance(m, int | float) and 0.0 < m < 1e100]
    counts = Counter(estimator for _, estimator, _ in shown)
    groups, seen = list(counts), Counter[str]()
    x: list[float] = []
    for _, estimator, _ in shown:
        x.append(groups.index(estimator) + 0.5 + 0.6 * ((seen[estimator] + 0.5) / max(counts.values()) - 0.5))
        seen[estimator] += 1
    return _Points(groups, x, [m for *_, m in shown], [n for n, *_ in shown])


def _structure(points: _Points) -> str:
    return repr(points.groups)


def _errors(points: _Points) -> Any:
    """Return the picture of the errors."""
    plot = figure(
        height=300, sizing_mode="stretch_width", y_axis_type="log", x_range=Range1d(start=0, end=len(points.groups)),
        tools="pan,wheel_zoom,box_zoom,reset", min_border_left=90,
    )  # fmt: skip
    plot.toolbar.logo = None
    plot.xaxis.ticker = [k + 0.5 for k in range(len(points.groups))]
    plot.xaxis.major_label_overrides = {k + 0.5: PlainText(text=name) for k, name in enumerate(points.groups)}
    plot.yaxis.axis_label = "mean squared tracking error"
    source = ColumnDataSource({"x": points.x, "y": points.y, "name": points.name}, name="errors")
    drawn = plot.scatter("x", "y", source=source, size=6, alpha=0.5, color=BLUE)
    plot.add_tools(HoverTool(renderers=[drawn], tooltips=[("run", "@name"), ("mean squared error", "@y{0.[0000]e+0}")]))
    return plot


def cell_text(value: str | float | None) -> str:
    """Return the text of a cell."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
