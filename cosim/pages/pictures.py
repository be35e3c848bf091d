"""Pictures of runs for a browser, below one another on one axis of time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from bokeh.layouts import gridplot

from ..plots.ranges import AxisLimits
from .columns import Columns
from .evidence import draw_disturbances, draw_events, draw_evidence, draw_innovations, draw_latencies
from .signals import draw_error, draw_inputs, draw_parameters, draw_tracking
from .sketch import ShownRun, Sketch
from .weighed import draw_hypotheses


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
    sketch = Sketch(shown)
    draw_events(sketch)
    draw_tracking(sketch)
    draw_error(sketch)
    draw_inputs(sketch)
    draw_parameters(sketch)
    draw_disturbances(sketch)
    draw_innovations(sketch)
    draw_hypotheses(sketch)
    draw_evidence(sketch)
    draw_latencies(sketch)
    sketch.figures[-1].xaxis.axis_label = "time [s]"
    layout = gridplot(
        [[f] for f in sketch.figures], sizing_mode="stretch_width", merge_tools=True,
        toolbar_options={"logo": None},
    )  # fmt: skip
    sources = sorted((name, *sorted(map(str, s.data))) for name, s in sketch.columns.sources.items())
    return Pictures(layout, sketch.columns, sketch.renderers, sketch.ranges, repr(sources))
