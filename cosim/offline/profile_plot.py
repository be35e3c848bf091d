"""Figure of an estimation's profile likelihoods."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from estimator.offline.profile_likelihood import LIMIT

from ..plots.canvas import label, new_figure, save_png, set_linear, tidy, top_legend
from ..plots.palette import BLACK, BLUE, VERMILION
from .estimate import Estimation

_COLUMNS: Final = 3
"""Number of axes side by side."""


def draw_profiles(found: Estimation, path: Path) -> Path:
    """Write a PNG with axes for each parameter: the rise of the sum of squares by its value. Raises FolderError."""
    n_columns = min(_COLUMNS, len(found.profiles))
    n_rows = -(-len(found.profiles) // n_columns)
    figure = new_figure(1.0 + 2.6 * n_columns, 0.8 + 2.2 * n_rows)
    grid: Any = figure.subplots(n_rows, n_columns, squeeze=False)
    for spare in grid.flat[len(found.profiles) :]:
        spare.set_visible(False)
    handles: dict[str, Any] = {}
    for axes, p, one, value in zip(grid.flat, found.space, found.profiles, found.fit.theta, strict=False):
        tidy(axes)
        set_linear(axes, (0.0, 2.0 * LIMIT))
        axes.plot(one.values, np.minimum(one.rise, 1e6), ".-", color=BLUE, linewidth=1.5, label="profile")
        axes.axhline(LIMIT, color=VERMILION, linewidth=1.0, label="95 %")
        axes.axvline(value, color=BLACK, linewidth=0.8, linestyle=":", label="estimate")
        axes.set_xlabel(label(p.name, p.unit))
        axes.locator_params(axis="x", nbins=3)
        axes.ticklabel_format(axis="x", style="plain", useOffset=False)
        handles |= {text: handle for handle, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    grid[0, 0].set_ylabel("rise of the sum of squares")
    top_legend(figure, handles, 3)
    return save_png(figure, path)
