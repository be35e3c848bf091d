"""Pictures of a study: tracking errors by estimator, what re-tuning made better or worse, and planes of two factors."""

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm

from ..studies.summary import StudyRow, StudySummary
from .canvas import new_figure, save_png, tidy
from .palette import BASELINES, BLUE, GREEN, GREY, VERMILION

_MOST_POINTS: Final = 1000
"""Points of one estimator that are drawn beside its quartiles."""
_CELLS: Final = 10
"""Cells along a factor of more values than that."""
_MOST_FACTORS: Final = 4
_LARGEST_RATIO: Final = 10.0
"""Ratio at which the colours of a plane end."""


def draw_study(folder: Path, summary: StudySummary, factors: Sequence[str]) -> list[Path]:
    """Draw the pictures of a study into its folder; return the files. Raises FolderError."""
    rows = summary.rows()
    scenarios = list(dict.fromkeys(row.scenario for row in rows))
    pictures = [_draw_errors(folder, summary, rows, scenarios)]
    compared = [row for row in rows if row.better.of]
    if compared:
        pictures.append(_draw_shares(folder, compared, scenarios))
    numeric = [name for name in factors if np.issubdtype(summary.columns[name].dtype, np.number)][:_MOST_FACTORS]
    for estimator in dict.fromkeys(row.estimator for row in compared if row.estimator not in BASELINES):
        if planes := _planes(summary, scenarios, estimator, numeric):
            pictures.append(_draw_planes(folder, summary, estimator, planes))
    return pictures


def _draw_errors(folder: Path, summary: StudySummary, rows: Sequence[StudyRow], scenarios: Sequence[str]) -> Path:
    """Draw the mean squared errors of each estimator, with quartiles."""
    figure = new_figure(2.0 + 1.1 * len(rows), 4.0)
    all_axes: Any = figure.subplots(1, len(scenarios), squeeze=False)[0]
    for axes, scenario in zip(all_axes, scenarios, strict=True):
        mine = [row.estimator for row in rows if row.scenario == scenario]
        for k, estimator in enumerate(mine):
            chosen = (summary.columns["scenario"] == scenario) & (summary.columns["estimator"] == estimator)
            mse = summary.columns["mse"][chosen]
            mse = mse[np.isfinite(mse) & (mse > 0.0)]
            if len(mse):
                shown = mse[:: -(-len(mse) // _MOST_POINTS)]
                x = k + 0.5 * (np.arange(len(shown)) * 0.618034 % 1.0 - 0.5)  # evenly, and the same each time
                colour = BASELINES[estimator][1].colour if estimator in BASELINES else BLUE
                axes.plot(x, shown, ".", color=colour, alpha=0.4, markersize=4)
                low, middle, high = np.quantile(mse, [0.25, 0.5, 0.75])
                axes.plot([k - 0.3, k + 0.3], [middle, middle], color="black", linewidth=1.5)
                axes.plot([k, k], [low, high], color="black", linewidth=1.5)
        axes.set_yscale("log")
        axes.set_xticks(range(len(mine)), mine, rotation=20)
        axes.set_title(f"{scenario}: a point a run; median and quartiles", fontsize=9)
        axes.set_ylabel("mean squared tracking error")
        tidy(axes)
    return save_png(figure, folder / "errors.png")


def _draw_shares(folder: Path, rows: Sequence[StudyRow], scenarios: Sequence[str]) -> Path:
    """Draw the shares of runs that re-tuning made better or worse, with their intervals."""
    figure = new_figure(7.0, 1.6 + 0.45 * len(rows))
    axes: Axes = figure.subplots()
    names = [row.estimator if len(scenarios) == 1 else f"{row.scenario}, {row.estimator}" for row in rows]
    for k, row in enumerate(rows):
        for share, offset, colour in ((row.better, 0.15, GREEN), (row.worse, -0.15, VERMILION)):
            value = 100.0 * share.n / share.of
            low, high = (100.0 * limit for limit in share.interval)
            axes.barh(k + offset, value, 0.28, color=colour, alpha=0.7)
            axes.plot([low, high], [k + offset, k + offset], color="black", linewidth=1.2, marker="|")
    axes.set_yticks(range(len(rows)), names)
    axes.set_xlim(0.0, 100.0)
    axes.set_xlabel("runs that re-tuning made better (upper bar) or worse (lower bar) [%], with 95 % intervals")
    tidy(axes)
    return save_png(figure, folder / "shares.png")


_Planes = dict[tuple[str, tuple[str, str]], Any]
"""Runs of each plane, by scenario and its two factors: True for each row of the table that is one of them (n,)."""


def _planes(summary: StudySummary, scenarios: Sequence[str], estimator: str, factors: Sequence[str]) -> _Planes:
    """Return the planes of two factors in which an estimator has runs with a ratio: not all scenarios have both."""
    columns, planes = summary.columns, _Planes()
    has_ratio = (columns["estimator"] == estimator) & np.isfinite(summary.ratio) & (summary.ratio > 0.0)
    for scenario, (a, b) in product(scenarios, combinations(factors, 2)):
        chosen = has_ratio & (columns["scenario"] == scenario) & np.isfinite(columns[a]) & np.isfinite(columns[b])
        if chosen.any():
            planes[scenario, (a, b)] = chosen
    return planes


def _draw_planes(folder: Path, summary: StudySummary, estimator: str, planes: _Planes) -> Path:
    """Draw the median ratio to the nominal controller's error over each two factors, a row a scenario."""
    scenarios, pairs = (list(dict.fromkeys(part)) for part in zip(*planes, strict=True))
    figure = new_figure(0.8 + 3.6 * len(pairs), 0.4 + 3.2 * len(scenarios))
    all_axes: Any = figure.subplots(len(scenarios), len(pairs), squeeze=False)
    norm = TwoSlopeNorm(0.0, -np.log10(_LARGEST_RATIO), np.log10(_LARGEST_RATIO))
    image: Any = None
    for axes, (scenario, pair) in zip(all_axes.flat, product(scenarios, pairs), strict=True):
        chosen = planes.get((scenario, pair))
        if chosen is None:
            axes.set_axis_off()
            continue
        columns = {name: summary.columns[name][chosen] for name in pair}
        edges, cells = _cells(columns, np.log10(summary.ratio[chosen]))
        axes.set_facecolor(GREY)  # where there is no run
        image = axes.pcolormesh(*edges, cells.T, norm=norm, cmap="PuOr_r")
        axes.set_xlabel(pair[0])
        axes.set_ylabel(pair[1])
        axes.set_title(f"{scenario}, {estimator}", fontsize=9)
    ticks = np.log10([0.1, 0.3, 1.0, 3.0, 10.0])
    bar = figure.colorbar(image, ax=all_axes, ticks=ticks, label="mse, times nominal")
    bar.ax.set_yticklabels(["≤ 0.1", "0.3", "1", "3", "≥ 10"])
    name = "".join(c if c.isalnum() or c in "-_." else "." for c in estimator)
    return save_png(figure, folder / f"planes-{name}.png")


def _cells(columns: Mapping[str, Any], outcome: Any) -> tuple[list[Any], Any]:
    """Return the edges of the cells along both factors, and the median outcome in each (n, m), or NaN."""
    edges, places = [], []
    for values in columns.values():
        found = np.unique(values.astype(float))
        if len(found) > _CELLS:
            edge = np.linspace(found[0], found[-1], _CELLS + 1)
        else:
            middles = (found[1:] + found[:-1]) / 2
            first = found[0] - (middles[0] - found[0] if len(middles) else 0.5)
            last = found[-1] + (found[-1] - middles[-1] if len(middles) else 0.5)
            edge = np.array([first, *middles, last])
        edges.append(edge)
        places.append(np.clip(np.searchsorted(edge, values.astype(float), side="right") - 1, 0, len(edge) - 2))
    shape = tuple(len(edge) - 1 for edge in edges)
    flat = np.asarray(np.ravel_multi_index(places, shape))
    order = np.argsort(flat, kind="stable")
    cells = np.full(int(np.prod(shape)), np.nan)
    for part in np.split(order, np.flatnonzero(np.diff(flat[order])) + 1):
        cells[flat[part[0]]] = np.median(outcome[part])
    return edges, cells.reshape(shape)
