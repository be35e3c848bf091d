"""Pictures of runs for a browser, below one another on one axis of time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from bokeh.layouts import gridplot
from bokeh.models import CrosshairTool, FactorRange, HoverTool, PlainText, Range1d, Span
from bokeh.plotting import figure

from ..plots.palette import BLACK, GREY, ORANGE, Dashed
from ..plots.ranges import AxisLimits, error_limits, tame, tracking_limits, value_range
from ..runs.quantities import (
    disturbance_sizes,
    inputs_of,
    norm,
    short_names,
    trigger_threshold,
    uncertainty_band,
    units_of,
)
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from .columns import Columns
from .marks import MOST_MARKS, SIGNS, reason_of

_HEIGHT: Final = 185
"""Height of a picture [pixels]."""


class ShownRun(NamedTuple):
    """A run on a page."""

    key: str
    """Key of the run in the page."""
    text: str
    """Text of the choice."""
    run: Run
    events: Sequence[RecordedEvent]
    style: Dashed
    is_baseline: bool = False
    """True for a run that others are compared with: only its tracking and inputs are shown."""


@dataclass(frozen=True)
class Pictures:
    """The pictures of a page, and what its script changes in them."""

    layout: Any
    """Bokeh's layout."""
    columns: Columns
    """Data of all curves and marks."""
    renderers: dict[str, list[str]]
    """Ids of the renderers of each run, by the run's key."""
    ranges: dict[str, AxisLimits]
    """Limits of each vertical axis, by the name of its range."""
    structure: str
    """Text that changes where the pictures must be made anew, and not only their data."""


def draw_pictures(shown: Sequence[ShownRun]) -> Pictures:
    """Draw events, tracking, inputs, parameters, disturbances, evidence and latencies of the runs."""
    sketch = _Sketch(shown)
    _draw_events(sketch)
    _draw_tracking(sketch)
    _draw_error(sketch)
    _draw_inputs(sketch)
    _draw_parameters(sketch)
    _draw_disturbances(sketch)
    _draw_evidence(sketch)
    _draw_latencies(sketch)
    sketch.figures[-1].xaxis.axis_label = "time [s]"
    layout = gridplot(
        [[f] for f in sketch.figures], sizing_mode="stretch_width", merge_tools=True,
        toolbar_options={"logo": None},
    )  # fmt: skip
    sources = sorted((name, *sorted(map(str, s.data))) for name, s in sketch.columns.sources.items())
    return Pictures(layout, sketch.columns, sketch.renderers, sketch.ranges, repr(sources))


@dataclass
class _Sketch:
    """The pictures while they are drawn."""

    shown: Sequence[ShownRun]
    figures: list[Any] = field(default_factory=list[Any])
    columns: Columns = field(default_factory=Columns)
    renderers: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    ranges: dict[str, AxisLimits] = field(default_factory=dict[str, AxisLimits])
    units: dict[str, str] = field(default_factory=dict[str, str])

    def __post_init__(self) -> None:
        settings = [s.run.scenario.scenario for s in self.shown]
        self.x = Range1d(start=min(s.start_time for s in settings), end=max(s.stop_time for s in settings))
        self.cursor = Span(dimension="height", line_dash="dotted", line_width=1, line_color=GREY)
        for s in self.shown:
            self.units = units_of(s.run) | self.units

    @property
    def main(self) -> list[ShownRun]:
        """The runs that are not only compared with."""
        return [s for s in self.shown if not s.is_baseline]

    def add(self, label: str, limits: AxisLimits, is_log: bool = False, height: int = _HEIGHT) -> Any:
        """Return a new picture below the others."""
        low, high = limits
        margin = 0.06 * ((high - low) or abs(high) or 1.0)
        shown = (low / 1.25, high * 1.25) if is_log else (low - margin, high + margin)
        y = Range1d(start=shown[0], end=shown[1], name=f"y{len(self.figures)}")
        self.ranges[str(y.name)] = shown
        return self._framed(figure(y_range=y, y_axis_type="log" if is_log else "linear", **self._frame(height)), label)

    def add_rows(self, factors: Sequence[str]) -> Any:
        """Return a new picture with a row for each factor."""
        y = FactorRange(factors=[*reversed(factors)])
        return self._framed(figure(y_range=y, **self._frame(45 + 20 * len(factors))), "")

    def _frame(self, height: int) -> dict[str, Any]:
        return {
            "x_range": self.x, "height": height, "min_border_left": 130, "min_border_right": 12,
            "tools": "pan,xwheel_zoom,box_zoom,undo,reset", "active_drag": "box_zoom", "output_backend": "canvas",
        }  # fmt: skip

    def _framed(self, plot: Any, label: str) -> Any:
        plot.name = label or "events"
        plot.yaxis.axis_label = PlainText(text=label)
        plot.axis.axis_label_text_font_style = "normal"
        plot.outline_line_color = None
        plot.add_tools(CrosshairTool(overlay=self.cursor))
        self.figures.append(plot)
        return plot

    def line(self, plot: Any, s: ShownRun, name: str, text: str, t: Series, y: Series, **style: Any) -> None:
        """Draw a curve of a run, whose values show on hover. style: `mode` makes it a step."""
        key = s.key if t is s.run.time else f"{s.key} {name}"
        source, at, (column,) = self.columns.curve(key, name, t, y)
        kind = plot.step if "mode" in style else plot.line
        given = {"line_width": 1.8, "line_color": s.style.colour, "line_dash": _dash(s.style)} | style
        self._hover(
            plot,
            s,
            kind(at, column, source=source, name=text, **given),
            "$name: $snap_y{0.[00000]} at $snap_x{0.[000]} s",
        )

    def points(self, plot: Any, s: ShownRun, name: str, columns: Mapping[str, Any], **style: Any) -> None:
        """Draw points x, y of a run, whose text shows on hover."""
        source = self.columns.table(f"{s.key} {name}", columns)
        self._hover(plot, s, plot.scatter("x", "y", source=source, **style), "@x{0.[000]} s: @text")

    def _hover(self, plot: Any, s: ShownRun, renderer: Any, text: str) -> None:
        self.keep(s, renderer)
        tool = HoverTool(
            renderers=[renderer], tooltips=[(s.text, text)], mode="mouse", visible=False, line_policy="nearest"
        )
        plot.add_tools(tool)

    def keep(self, s: ShownRun, renderer: Any) -> None:
        """Take a renderer for one that is shown and hidden with its run."""
        self.renderers.setdefault(s.key, []).append(renderer.id)


def _dash(style: Dashed) -> Any:
    return list(style.dashes) if style.dashes else "solid"


def _draw_events(sketch: _Sketch) -> None:
    """Draw a mark for every event, a row for each kind."""
    kinds = [k for k in SIGNS if any(e.get("kind") == k for s in sketch.main for e in s.events)]
    if not kinds:
        return
    plot = sketch.add_rows([SIGNS[kind].text for kind in kinds])
    for s in sketch.main:
        for kind in kinds:
            events = [e for e in s.events if e.get("kind") == kind][:MOST_MARKS]
            if events:
                sign = SIGNS[kind]
                colour = sign.colour if len(sketch.main) == 1 else s.style.colour
                columns = {
                    "x": np.array([float(e["t"]) for e in events]), "y": [sign.text] * len(events),
                    "text": [reason_of(e, s.run) or sign.text for e in events],
                }  # fmt: skip
                sketch.points(
                    plot,
                    s,
                    kind,
                    columns,
                    marker=sign.marker,
                    size=9,
                    line_color=colour,
                    fill_color=colour,
                    fill_alpha=0.35,
                )


def _draw_tracking(sketch: _Sketch) -> None:
    """Draw the tracked outputs with their references."""
    first = sketch.main[0]
    tracking = first.run.scenario.tracking
    for (output, reference), name in zip(tracking.items(), short_names(list(tracking)), strict=True):
        having = [s for s in sketch.shown if output in s.run.series]
        limits = tracking_limits(first.run[reference], [s.run[output] for s in having])
        plot = sketch.add(_label(name, sketch.units.get(output)), limits)
        for s in having:
            sketch.line(plot, s, output, name, s.run.time, tame(s.run[output], limits))
        style = {"line_color": BLACK, "line_dash": [4, 3], "line_width": 1.2}
        sketch.line(plot, first, reference, "reference", first.run.time, tame(first.run[reference], limits), **style)


def _draw_error(sketch: _Sketch) -> None:
    """Draw the norm of the tracking error, with the threshold that triggers."""
    with np.errstate(all="ignore"):
        errors = [norm(list(s.run.errors.values())) for s in sketch.shown]
    limits = error_limits(errors, sketch.main[0].run.scenario.limits.divergence)
    plot = sketch.add("tracking error |e|", limits, is_log=True)
    for s, error in zip(sketch.shown, errors, strict=True):
        sketch.line(plot, s, "error", "|e|", s.run.time, tame(error, limits, is_log=True))
    if (threshold := trigger_threshold(sketch.main[0].run)) is not None:
        plot.add_layout(Span(location=threshold, dimension="width", line_dash="dotted", line_color=BLACK))


def _draw_inputs(sketch: _Sketch) -> None:
    """Draw the inputs of the plant: what the controller did."""
    for name, column in inputs_of(sketch.main[0].run).items():
        having = [s for s in sketch.shown if column in s.run.series]
        limits = value_range([s.run[column] for s in having], percentile=0.5) or (0.0, 1.0)
        plot = sketch.add(_label(f"input {name}", sketch.units.get(column)), limits)
        for s in having:
            sketch.line(plot, s, column, name, s.run.time, tame(s.run[column], limits), mode="before", line_width=1.2)


def _draw_parameters(sketch: _Sketch) -> None:
    """Draw each parameter in the controller with its uncertainty, and the truth."""
    first = sketch.main[0]
    for i, p in enumerate(first.run.scenario.estimation.parameters):
        having = [s for s in sketch.main if p.name in s.run.estimates]
        truth = first.run.true_parameters[p.name]
        limits = value_range([truth, *(s.run.estimates[p.name] for s in having)]) or (p.lower, p.upper)
        is_log = p.scale == "log" and limits[0] > 0.0 and limits[1] > 3.0 * limits[0]
        plot = sketch.add(_label(p.name, p.unit), limits, is_log)
        for s in having:
            band = uncertainty_band(s.run, p, s.events, i) if len(s.run.time) else None
            if band is not None:
                source, at, edges = sketch.columns.curve(f"{s.key} band {p.name}", p.name, band.t, band.low, band.high)
                style = {"fill_color": s.style.colour, "fill_alpha": 0.2}
                sketch.keep(s, plot.varea_step(at, *edges, source=source, step_mode="after", **style))
            held = tame(s.run.estimates[p.name], limits, is_log)
            sketch.line(plot, s, p.name, f"{p.name} in the controller", s.run.time, held, mode="after")
        if np.any(np.isfinite(truth)):
            style = {"line_color": BLACK, "line_dash": [4, 3], "line_width": 1.2, "mode": "after"}
            sketch.line(
                plot, first, f"true {p.name}", f"true {p.name}", first.run.time, tame(truth, limits, is_log), **style
            )


def _draw_disturbances(sketch: _Sketch) -> None:
    """Draw the known size of disturbances, as the diagnosis estimates it, a picture for each channel."""
    sizes = {s.key: disturbance_sizes(s.run, s.events) for s in sketch.main}
    for channel in sorted({channel for of in sizes.values() for channel in of}):
        having = [(s, sizes[s.key][channel]) for s in sketch.main if channel in sizes[s.key]]
        limits = value_range([list(of.values()) for _, of in having]) or (0.0, 1.0)
        plot = sketch.add(_label(f"disturbance of {channel}", sketch.units.get(channel)), limits, height=130)
        for s, of in having:
            t, y = np.array([*of]), np.array([*of.values()])
            sketch.line(
                plot,
                s,
                f"disturbance {channel}",
                channel,
                t,
                y,
                mode="after",
                line_color=ORANGE if len(having) == 1 else s.style.colour,
            )


def _draw_evidence(sketch: _Sketch) -> None:
    """Draw how well each candidate explains the samples: the first of a search are the parameters held."""
    found = {
        s.key: [e for e in s.events if e.get("kind") == "candidate" and _is_positive(e.get("cost"))]
        for s in sketch.main
    }
    costs = [float(e["cost"]) for events in found.values() for e in events]
    if not costs:
        return
    limits = error_limits([np.array(costs)], np.inf)
    plot = sketch.add("evidence: sum of squares\nof the candidates", limits, is_log=True)
    for s in sketch.main:
        events = found[s.key][:MOST_MARKS]
        columns = {
            "x": np.array([float(e["t"]) for e in events]),
            "y": np.clip([float(e["cost"]) for e in events], *limits),
            "text": [reason_of(e, s.run) for e in events],
        }
        sketch.points(plot, s, "candidate", columns, size=4, color=s.style.colour, alpha=0.6)


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and 0.0 < value < 1e100


def _draw_latencies(sketch: _Sketch) -> None:
    """Draw the wall time of each macro step's evaluations against the deadline."""
    having = [s for s in sketch.main if s.run.latencies]
    if not having:
        return
    deadline = 1e3 * sketch.main[0].run.scenario.scenario.macro_step
    sums = {s.key: 1e3 * np.array([sum(step) for step in s.run.latencies]) for s in having}
    limits = value_range([*sums.values(), np.array([deadline])]) or (1.0, 10.0)
    plot = sketch.add("latency [ms]", (max(limits[0], 1e-3), limits[1]), is_log=True)
    for s in having:
        times = _evaluation_times(s, len(sums[s.key]))
        if times is None:
            continue
        rows = np.arange(len(times))[:MOST_MARKS]
        texts = [f"{ms:.3g} ms, deadline {deadline:g} ms" for ms in sums[s.key][rows]]
        columns = {"x": times[rows], "y": sums[s.key][rows], "text": texts}
        sketch.points(plot, s, "latency", columns, size=4, color=s.style.colour, alpha=0.6)
    plot.add_layout(Span(location=deadline, dimension="width", line_dash="dashed", line_color=BLACK))


def _evaluation_times(s: ShownRun, n: int) -> Series | None:
    """Return the times [s] of the n macro steps with evaluations; None where the events do not tell them."""
    times = np.unique([float(e["t"]) for e in s.events if e.get("kind") == "candidate"])
    return times if len(times) == n else None


def _label(name: str, unit: str | None) -> str:
    short = name if len(name) <= 28 else f"{name[:14]}…{name[-13:]}"
    return short if unit in (None, "", "1") else f"{short} [{unit}]"
