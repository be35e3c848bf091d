"""A page of many runs: a table to search and sort, a picture of their errors, and links to the runs."""

import os.path
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, HoverTool, PlainText, Range1d
from bokeh.plotting import figure

from ..errors import FolderError
from ..plots.palette import BLUE
from ..runs.manifest import read_json, read_manifest
from ..runs.run_files import MANIFEST, RESULT
from .frame import rendered, rendered_part, script_data

COLUMNS: Final = (
    "run", "scenario", "estimator", "seed", "status", "mean squared error", "largest error", "evaluations", "written",
    "vetoed", "reverted", "disturbances", "wall time [s]",
)  # fmt: skip
"""Columns of the table; `run` has the link."""


@dataclass(frozen=True)
class ListedRun:
    """A row of the table."""

    folder: Path
    """Run folder."""
    cells: tuple[str | float | None, ...]
    """Cells in the order of the columns; None where a figure is missing."""


def run_folders(path: Path) -> list[Path]:
    """Return the run folder, or those in a folder of runs, in the order of their names. Raises FolderError."""
    if (path / MANIFEST).exists():
        return [path]
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
        manifest = read_manifest(folder)
        result: dict[str, Any] = {}
        if manifest.status != "running":
            result = read_json(folder, RESULT, dict[str, Any])
    except FolderError as e:
        return ListedRun(folder, (folder.name, None, None, None, str(e), *[None] * (len(COLUMNS) - 5)))
    guard, diagnosis = result.get("guard") or {}, result.get("diagnosis") or {}
    errors = [e for e in result.get("mse") or [] if isinstance(e, int | float)]
    name = manifest.scenario.get("scenario", {}).get("name")
    figures = (result.get("max_error"), result.get("evaluations"), guard.get("written"), guard.get("vetoed"))
    rest = (guard.get("reverted"), diagnosis.get("disturbance"), result.get("wall_s"))
    about = (folder.name, name, manifest.estimator, manifest.seed, manifest.status)
    return ListedRun(folder, (*about, sum(errors) if errors else None, *figures, *rest))


def list_html(title: str, rows: Sequence[ListedRun], link: Callable[[Path], str], is_live: bool = False) -> str:
    """Return the page of many runs; link: the address of a run's own page."""
    data: dict[str, Any] = {"is_live": False, "renderers": {}, "ranges": {}}
    plot = _errors(rows)
    if plot is not None:
        data["item"] = json_item(plot)
    return rendered(
        "list.html.j2", title=title, columns=COLUMNS, n=len(rows), data=script_data(data), is_live=is_live,
        has_plots=plot is not None, table=rendered_part("rows.html.j2", rows=rows, link=link, number=_number),
    )  # fmt: skip


def link_from(page: Path) -> Callable[[Path], str]:
    """Return the function that gives, from a page's file, the address of a run's report, or else of its folder."""

    def link(folder: Path) -> str:
        report = folder / "report.html"
        target = report if report.is_file() else folder
        return quote(Path(os.path.relpath(target, page.parent)).as_posix())

    return link


def _errors(rows: Sequence[ListedRun]) -> Any:
    """Return the picture of the mean squared errors by estimator; None where there is none above zero."""
    places = [COLUMNS.index(c) for c in ("run", "estimator", "mean squared error")]
    found = [[row.cells[i] for i in places] for row in rows]
    shown = [(str(n), str(e), float(m)) for n, e, m in found if isinstance(m, int | float) and 0.0 < m < 1e100]
    if not shown:
        return None
    names, estimators, errors = (list(column) for column in zip(*shown, strict=True))
    groups = list(dict.fromkeys(estimators))
    most = max(estimators.count(group) for group in groups)
    nth = [estimators[:i].count(e) for i, e in enumerate(estimators)]  # side by side, so that each can be told
    x = [groups.index(e) + 0.5 + 0.6 * ((k + 0.5) / most - 0.5) for e, k in zip(estimators, nth, strict=True)]
    plot = figure(
        height=300, sizing_mode="stretch_width", y_axis_type="log", x_range=Range1d(start=0, end=len(groups)),
        tools="pan,wheel_zoom,box_zoom,reset", min_border_left=90,
    )  # fmt: skip
    plot.toolbar.logo = None
    plot.xaxis.ticker = [k + 0.5 for k in range(len(groups))]
    plot.xaxis.major_label_overrides = {k + 0.5: PlainText(text=name) for k, name in enumerate(groups)}
    plot.yaxis.axis_label = "mean squared tracking error"
    drawn = plot.scatter(
        "x", "y", source=ColumnDataSource({"x": x, "y": errors, "name": names}), size=6, alpha=0.5, color=BLUE
    )
    plot.add_tools(HoverTool(renderers=[drawn], tooltips=[("run", "@name"), ("mean squared error", "@y{0.[0000]e+0}")]))
    return plot


def _number(value: str | float | None) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.4g}"
