"""Figures over time: axes below one another, episodes shaded, a curve for each run, one legend."""

from collections.abc import Iterator, Sequence
from typing import Any, Final, Literal, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from .canvas import new_figure, tidy, top_legend
from .palette import BLACK, GREY, ORANGE, VERMILION, Dashed
from .ranges import AxisLimits

DrawStyle = Literal["default", "steps-pre", "steps-post"]
"""Style of a line between two points; an input was held until its row, a parameter is held from its row on."""

_SHADE: Final = "0.93"
_MARKS: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    "veto": ("refused by the guard", {"marker": "x", "color": VERMILION}),
    "revert": ("reverted", {"marker": "v", "color": BLACK}),
}
for _, _style in _MARKS.values():
    _style |= {"linestyle": "", "markersize": 6, "clip_on": False, "zorder": 5}


class Curve(NamedTuple):
    """Curve of one run in a figure."""

    run: Run
    text: str
    """Text in the legend."""
    style: Dashed
    """Colour and dashes."""
    width: float
    """Line width [pt]."""


def panels(run: Run, events: Sequence[RecordedEvent], n: int) -> tuple[Figure, list[Axes]]:
    """Return a figure with n axes over the scenario's time, in two columns if there are many, and episodes shaded."""
    n_columns = 1 if n <= 5 else 2
    n_rows = -(-n // n_columns)
    figure = new_figure(7.2 * (1.0 if n_columns == 1 else 1.5), 1.5 + (2.6 if n_rows == 1 else 1.7 * n_rows))
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
        for kind, (text, style) in _MARKS.items():
            times = [e["t"] for e in events if e.get("kind") == kind]
            if times:
                axes.plot(times, [0.97] * len(times), transform=axes.get_xaxis_transform(), label=text, **style)
        if run.status != "done":
            axes.axvline(float(run.time[-1]), color=GREY, linewidth=1.0, label=run.status)
    for axes in shown[-n_columns:]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    return figure, shown


def title_of(run: Run) -> str:
    """Return the title of a picture: scenario, estimator and seed."""
    return f"{run.scenario.scenario.name}, {run.estimator}, seed {run.seed}".replace("$", r"\$")


def line(axes: Axes, curve: Curve, values: Series, drawstyle: DrawStyle = "default") -> None:
    """Draw values (n,) in the style of the curve."""
    dashes: Any = (0, curve.style.dashes) if curve.style.dashes else "-"
    axes.plot(
        curve.run.time, values, color=curve.style.colour, linestyle=dashes, linewidth=curve.width, label=curve.text,
        drawstyle=drawstyle, **mark(curve.run),
    )  # fmt: skip


def mark(run: Run) -> dict[str, Any]:
    """Return a marker if there is one point only, where a line is invisible."""
    return {"marker": "o"} if len(run.time) == 1 else {}


def finish(figure: Figure, shown: Sequence[Axes], title: str | None = None, n_columns: int | None = None) -> Figure:
    """Draw title and one legend for all panels above them, in that many columns or as many as fit.

    Returns the figure.
    """
    handles = {text: h for axes in shown for h, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    top_legend(figure, handles, n_columns or (6 if figure.get_figwidth() > 8 else 5), title)
    figure.align_ylabels(list(shown))
    return figure


def _disturbances(run: Run, events: Sequence[RecordedEvent]) -> Iterator[AxisLimits]:
    """Yield begin and end [s] of each stretch in which a disturbance is known: from its event to that of its end."""
    begin: float | None = None
    for event in events:
        if event.get("kind") != "disturbance" or not event.get("is_known", True):
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
