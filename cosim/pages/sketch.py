"""The pictures of a page while they are drawn: one below the other, on one axis of time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from bokeh.models import CrosshairTool, FactorRange, HoverTool, PlainText, Range1d, Span
from bokeh.plotting import figure

from ..plots.palette import GREY, Dashed
from ..plots.ranges import AxisLimits
from ..runs.quantities import units_of
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from .columns import Columns

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


@dataclass
class Sketch:
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
        plot = self._framed(figure(y_range=y, y_axis_type="log" if is_log else "linear", **self._frame(height)), label)
        if is_log:  # there are too many of them where the range is short
            plot.yaxis.minor_tick_line_color = None
        return plot

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

    def points(self, plot: Any, s: ShownRun, name: str, columns: Mapping[str, Any], **style: Any) -> Any:
        """Draw points x, y of a run, whose text shows on hover; return their renderer."""
        source = self.columns.table(f"{s.key} {name}", columns)
        renderer = plot.scatter("x", "y", source=source, **style)
        self._hover(plot, s, renderer, "@x{0.[000]} s: @text")
        return renderer

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


def axis_label(name: str, unit: str | None) -> str:
    short = name if len(name) <= 28 else f"{name[:14]}…{name[-13:]}"
    return short if unit in (None, "", "1") else f"{short} [{unit}]"
