"""The paper's figures from runs: tracking of the pendulum; errors of the quadrotor by estimator."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter

from ..plots.canvas import label, new_figure, set_linear, set_log, tidy, top_legend
from ..plots.palette import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, Dashed
from ..plots.panels import Curve, finish, line, panels
from ..plots.ranges import tame, tracking_limits, value_range
from ..runs.quantities import short_names
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run


class Shown(NamedTuple):
    """Style in which an estimator's run is drawn."""

    name: str
    """Name of the estimator."""
    text: str
    """Text in the legend."""
    colour: str
    hatch: str
    """Hatching of its bars, to distinguish them without colours."""
    dashes: Literal["-", "-.", ":"]
    """Style of its line."""


SHOWN: Final = (
    Shown("none", "nominal", VERMILION, "", "-."),
    Shown("paper", "BO (the paper's)", ORANGE, "///", "-"),
    Shown("ipm", "IPM (Ipopt)", SKY, "...", "-"),
    Shown("ipm-scipy", "IPM (SciPy's trust-constr, without Ipopt)", SKY, "...", "-"),
    Shown("sqp", "SQP (SciPy's SLSQP)", GREY, "xxx", "-"),
    Shown("target", "ours", BLUE, "", "-"),
    Shown("true", "true parameters (floor)", BLACK, "", ":"),
)
"""Estimators from left to right; one without a run is left out."""
LABELS: Final = {shown.name: shown.text for shown in SHOWN}

_LINEAR: Final = 0.02
"""Altitude error [m] below which its axis is linear."""


def ending_text(run: Run) -> str | None:
    """Return how and when a run that did not finish ended; None if it finished."""
    if run.status == "done":
        return None
    return f"{run.status} at {run.time[-1]:.3g} s" if len(run.time) else f"{run.status} at the start"


def draw_pendulum(runs: Mapping[str, Run], events: Sequence[RecordedEvent]) -> Figure | None:
    """Draw position with its reference, and force, by estimator; return None without a run of `target`.

    runs: those of the pendulum by estimator; events: the record of `target`, whose episodes are shaded.
    """
    run = runs.get("target")
    if run is None or not len(run.time):
        return None
    output, reference = next(iter(run.scenario.tracking.items()))
    figure, (above, below) = panels(run, events, 2)
    curves = [
        Curve(runs[s.name], s.text, Dashed(s.colour), 2.0 if s.name == "target" else 1.2)
        for s in SHOWN
        if s.name in runs and s.name != "true" and len(runs[s.name].time)
    ]
    limits = set_linear(above, tracking_limits(run[reference], [c.run[output] for c in curves]))
    forces = [c.run["controller.u"] for c in curves]
    of_forces = set_linear(below, value_range(forces, percentile=0.5) or (0.0, 1.0), margin=0.15)
    for curve, force in zip(curves, forces, strict=True):
        line(above, curve, tame(curve.run[output], limits))
        line(below, curve._replace(width=0.7) if curve.run.estimator == "paper" else curve, tame(force, of_forces))
        for axes in (above, below):
            axes.lines[-1].set_linestyle(next(s.dashes for s in SHOWN if s.name == curve.run.estimator))
    above.plot(run.time, tame(run[reference], limits), "--", color=BLACK, linewidth=1.0, label="reference")
    for axes in (above, below):
        for t in _changes(run):
            axes.axvline(t, color=GREEN, linewidth=1.2, linestyle=":", label="parameters change")
    above.set_ylabel(label("phi", "rad"))
    below.set_ylabel(label("u", "N"))
    return finish(figure, [above, below], n_columns=3)


def _changes(run: Run) -> list[float]:
    """Return the times [s] at which a true parameter jumps."""
    table = np.array(list(run.true_parameters.values()))
    return run.time[1:][np.any(np.diff(table, axis=1) != 0.0, axis=0)][:5].tolist()


def draw_mse(runs: Mapping[str, Run]) -> Figure:
    """Draw mean squared tracking errors by output and estimator on a logarithmic axis; true parameters as lines.

    For a run that did not finish the error is that of its rows, and the figure says so.
    """
    shown = [s for s in SHOWN if s.name in runs]
    bars = [s for s in shown if s.name != "true"]
    outputs = list(next(iter(runs.values())).scenario.tracking)
    figure = new_figure(8.6, 4.8)
    axes = figure.subplots()
    tidy(axes)
    axes.grid(visible=False, axis="x")
    width = 0.82 / max(len(bars), 1)
    room = 0.85 if any(ending_text(runs[s.name]) for s in bars) else 0.25
    top = _mse_axis(axes, [runs[s.name].mse for s in shown], room)
    for k, s in enumerate(bars):
        places = np.arange(len(outputs)) + (k - 0.5 * (len(bars) - 1)) * width
        _draw_bars(axes, runs[s.name], s, places.tolist(), 0.9 * width, top)
    if "true" in runs:
        floor = np.array(runs["true"].mse)
        places = np.arange(len(outputs))
        axes.hlines(floor, places - 0.45, places + 0.45, color=BLACK, linewidth=1.6, label=LABELS["true"], zorder=3)
    axes.set_xticks(range(len(outputs)), [label(name) for name in short_names(outputs)], fontsize=11)
    axes.set_ylabel("mean squared tracking error [m²]")
    handles, texts = axes.get_legend_handles_labels()
    by_text = dict(zip(texts, handles, strict=True))
    top_legend(figure, {s.text: by_text[s.text] for s in shown}, n_columns=3)
    return figure


def _mse_axis(axes: Axes, values: Sequence[Sequence[float]], room: float) -> float:
    """Set a logarithmic axis with room for bars and for texts above them; return the bars' upper limit.

    room: that of the texts, as a share of the bars' decades.
    """
    flat = np.array([v for numbers in values for v in numbers if 0.0 < v < 1e100])  # NaN is not
    low, high = (float(flat.min()), float(flat.max())) if len(flat) else (1e-3, 1.0)
    high = min(high, 1e12 * low)
    decades = max(np.log10(high / low), 1.0)
    set_log(axes, "y", (low / 10.0 ** (0.1 * decades), high * 10.0 ** (room * decades)), margin=0.0)
    axes.yaxis.set_major_locator(FixedLocator([t for t in axes.get_yticks() if t <= 10.0 * high]))
    return high


def _draw_bars(axes: Axes, run: Run, shown: Shown, places: Sequence[float], width: float, top: float) -> None:
    """Draw a bar for each tracked output with its value and the run's ending, written upwards."""
    heights = np.array(run.mse)
    finite = np.where(np.isfinite(heights), heights, 0.0)
    low = axes.get_ylim()[0]
    axes.bar(
        places, finite, width, color=shown.colour, edgecolor=BLACK, linewidth=0.6, hatch=shown.hatch, label=shown.text
    )
    for x, height in zip(places, heights, strict=True):
        why = ending_text(run)
        value = f"{height:.2g}" if np.isfinite(height) else "no value"
        axes.annotate(
            f"{value}, {why}" if why else value, (x, max(min(np.nan_to_num(height), top), low)), (0, 3),
            textcoords="offset points", rotation=90, ha="center", va="bottom", fontsize=8, zorder=4,
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.8},
        )  # fmt: skip


def draw_altitude(runs: Mapping[str, Run], output: str = "plant.r_z") -> Figure:
    """Draw the error of one tracked output over time by estimator, on an axis linear near zero, logarithmic beyond.

    Each estimator has its own panel, with the others in grey; a cross marks the end of a run that did not finish.
    """
    shown = [s for s in SHOWN if s.name in runs and len(runs[s.name].time)]
    figure = new_figure(9.0, 0.9 + 1.9 * -(-len(shown) // 2))
    grid: Any = figure.subplots(-(-len(shown) // 2), 2, sharex=True, sharey=True, squeeze=False)
    errors = {s.name: runs[s.name].errors[output] for s in shown}
    extent = _extent(list(errors.values()), next(iter(runs.values())).scenario.limits.divergence)
    for spare in grid.flat[len(shown) :]:
        spare.set_visible(False)
    for axes, s in zip(grid.flat, shown, strict=False):
        tidy(axes)
        _symmetric_axis(axes, extent)
        run = runs[s.name]
        for other in shown:
            axes.plot(runs[other.name].time, tame(errors[other.name], (-extent, extent)), color="0.85", linewidth=0.8)
        values = tame(errors[s.name], (-extent, extent))
        axes.plot(run.time, values, color=s.colour, linewidth=1.5, label=s.text)
        if why := ending_text(run):
            axes.plot(run.time[-1], np.clip(values[-1], -extent, extent), "X", color=BLACK, markersize=9, clip_on=False)
        axes.set_title(f"{s.text}: {why}" if why else s.text, fontsize=9)
        axes.set_xlim(run.scenario.scenario.start_time, run.scenario.scenario.stop_time)
    for axes in grid.flat[max(len(shown) - 2, 0) : len(shown)]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    for axes in grid[:, 0]:
        axes.set_ylabel("altitude error [m]", fontsize=9)
    return figure


def _extent(errors: Sequence[Any], divergence: float) -> float:
    """Return the largest error to show [m], at most the one at which a run counts as diverged."""
    low, high = value_range(errors) or (-1.0, 1.0)
    return min(max(-low, high, 10.0 * _LINEAR), divergence)


def _symmetric_axis(axes: Axes, extent: float) -> None:
    axes.set_yscale("symlog", linthresh=_LINEAR, linscale=0.8)
    axes.set_ylim(-1.3 * extent, 1.3 * extent)
    decades = [10.0**k for k in range(-1, 7) if 10.0**k <= 1.3 * extent]
    axes.yaxis.set_major_locator(FixedLocator([*(-d for d in decades), -_LINEAR, 0.0, _LINEAR, *decades]))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
