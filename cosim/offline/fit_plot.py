"""Figure of an estimation from logs: outputs as measured, and as simulated before and after."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from ..plots.canvas import label, new_figure, save_png, set_linear, tidy, top_legend
from ..plots.palette import BLACK, BLUE, VERMILION
from ..plots.ranges import tame, value_range
from .estimate import Estimation

_MOST: Final = 8
"""Largest number of axes: more windows are not drawn."""


def draw_fit(found: Estimation, path: Path) -> Path:
    """Write a PNG with axes for each output in each window, the first few where there are many. Raises FolderError."""
    outputs = list(found.request.measured)
    places = [(w, i) for w in range(len(found.windows)) for i in range(len(outputs))][:_MOST]
    n_columns = 1 if len(places) <= 4 else 2
    n_rows = -(-len(places) // n_columns)
    figure = new_figure(7.2 * (1.0 if n_columns == 1 else 1.5), 1.0 + 2.3 * n_rows)
    grid: Any = figure.subplots(n_rows, n_columns, squeeze=False)
    for spare in grid.flat[len(places) :]:
        spare.set_visible(False)
    handles: dict[str, Any] = {}
    for axes, (w, i) in zip(grid.flat, places, strict=False):
        _draw(axes, found, w, i)
        unit = found.component.unit(outputs[i])
        axes.set_ylabel(label(outputs[i], unit.name if unit else None))
        axes.set_xlabel("time [s]")
        if len(found.windows) > 1:
            axes.set_title(found.windows[w].name, fontsize=9, loc="left")
        handles |= {text: handle for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    top_legend(figure, handles, 4)
    return save_png(figure, path)


def _draw(axes: Axes, found: Estimation, w: int, i: int) -> None:
    window, before, after = found.windows[w], found.before[w], found.after[w]
    tidy(axes)
    curves = [y[:, i] for y in (before, after) if y is not None]
    limits = value_range([window.measured[:, i]]) or value_range(curves) or (0.0, 1.0)
    widest = value_range([window.measured[:, i], *curves]) or limits
    width = limits[1] - limits[0] or 1.0
    limits = (max(widest[0], limits[0] - width), min(widest[1], limits[1] + width))  # a diverged curve hides nothing
    set_linear(axes, limits)
    if window.n_fit < len(window.time):
        held_out = float(window.time[max(window.n_fit - 1, 0)])
        axes.axvspan(held_out, float(window.time[-1]), color="0.93", linewidth=0, zorder=-1, label="held out")
    dots: dict[str, Any] = {"markersize": 5, "alpha": 0.5, "markeredgewidth": 0, "zorder": 3}
    thin = max(1, len(window.time) // 200)  # more would be a line
    axes.plot(window.time[::thin], window.measured[::thin, i], ".", color=BLACK, label="measured", **dots)
    for y, colour, text, width in ((before, VERMILION, "before", 1.0), (after, BLUE, "estimated", 1.5)):
        if y is not None:
            axes.plot(window.time, tame(np.asarray(y[:, i]), limits), color=colour, linewidth=width, label=text)
    axes.set_xlim(float(window.time[0]), float(window.time[-1]))
