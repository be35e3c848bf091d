"""Figures over time: axes below one another, episodes shaded, a curve for each run, one legend."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..runs.result import Run
from .canvas import GREY, ORANGE, AxisLimits, Series, new_figure, tidy, top_legend

RecordedEvent = Mapping[str, Any]
"""One line of the record: `t` [s], `kind`, and what belongs to that kind."""

_SHADE: Final = "0.93"


class Curve(NamedTuple):
    """Curve of one run in a figure."""

    run: Run
    text: str
    """Text in the legend."""
    colour: str
    width: float
    """Line width [pt]."""


def panels(run: Run, events: Sequence[RecordedEvent], n: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with n axes over the scenario's time, in two columns if there are many, and episodes shaded."""
    n_columns = 1 if n <= 5 else 2
    n_rows = -(-n // n_columns)
    figure = new_figure(7.2 * (1.0 if n_columns == 1 else 1.5), 1.3 + (2.6 if n_rows == 1 else 1.7 * n_rows))
    grid: Any = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    for spare in grid.flat[n:]:
        spare.set_visible(False)
    shown: list[Axes] = list(grid.flat[:n])
    settings = run.scenario.scenario
    for axes in shown:
        tidy(axes)
        axes.set_xlim(settings.start_time, settings.stop_time)
        for i, (begin, end) in enumerate(_episodes(run, events)):
            axes.axvspan(begin, end, color=_SHADE, linewidth=0, zorder=-1, label="estimating" if i == 0 else None)
        for i, (begin, end) in enumerate(_disturbances(run, events)):
            axes.axvspan(begin, end, ymax=0.03, color=ORANGE, linewidth=0, label="disturbance" if i == 0 else None)
        if run.status != "done":
            axes.axvline(float(run.time[-1]), color=GREY, linewidth=1.0, label=run.status)
    for axes in shown[-n_columns:]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    return figure, shown


def line(axes: Axes, curve: Curve, values: Series) -> None:
    """Draw values (n,) in the style of the curve."""
    axes.plot(curve.run.time, values, color=curve.colour, linewidth=curve.width, label=curve.text, **mark(curve.run))


def mark(run: Run) -> dict[str, Any]:
    """Return a marker if there is one point only, where a line is invisible."""
    return {"marker": "o"} if len(run.time) == 1 else {}


def finish(figure: Figure, shown: Sequence[Axes], n_columns: int | None = None) -> Figure:
    """Draw one legend for all panels above them, in that many columns or as many as fit; return the figure."""
    handles = {text: h for axes in shown for h, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    top_legend(figure, handles, n_columns=n_columns or (6 if figure.get_figwidth() > 8 else 5))
    figure.align_ylabels(list(shown))
    return figure


def _disturbances(run: Run, events: Sequence[RecordedEvent]) -> Iterator[AxisLimits]:
    """Yield begin and end [s] of each stretch in which a disturbance is known: from its event to that of its end."""
    begin: float | None = None
    for event in events:
        if event.get("kind") != "disturbance":
            continue
        t = float(event["t"])
        if begin is None and event.get("size"):
            begin = t
        elif begin is not None and not event.get("size"):
            yield begin, t
            begin = None
    if begin is not None:
        yield begin, float(run.time[-1])


def _episodes(run: Run, events: Sequence[RecordedEvent]) -> Iterator[AxisLimits]:
    """Yield begin and end [s] of each stretch of episodes; those at most two macro steps apart are merged."""
    gap = 2.0 * run.scenario.scenario.macro_step
    begin = end = None
    for event in events:
        if event.get("kind") not in ("trigger", "candidate", "end"):
            continue
        t = float(event["t"])
        if begin is None or end is None:
            begin = t
        elif t > end + gap:
            yield begin, end
            begin = t
        end = t
    if begin is not None and end is not None:
        yield begin, end
