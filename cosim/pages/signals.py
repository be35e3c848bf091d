"""Pictures of what plant and controller did: tracking, error, inputs and parameters."""

import numpy as np
from bokeh.models import Span

from ..plots.palette import BLACK
from ..plots.ranges import error_limits, tame, tracking_limits, value_range
from ..runs.quantities import inputs_of, norm, short_names, trigger_threshold, uncertainty_band
from .sketch import Sketch, axis_label


def draw_tracking(sketch: Sketch) -> None:
    """Draw the tracked outputs with their references."""
    first = sketch.main[0]
    tracking = first.run.scenario.tracking
    for (output, reference), name in zip(tracking.items(), short_names(list(tracking)), strict=True):
        having = [s for s in sketch.shown if output in s.run.series]
        limits = tracking_limits(first.run[reference], [s.run[output] for s in having])
        plot = sketch.add(axis_label(name, sketch.units.get(output)), limits)
        for s in having:
            sketch.line(plot, s, output, name, s.run.time, tame(s.run[output], limits))
        style = {"line_color": BLACK, "line_dash": [4, 3], "line_width": 1.2}
        sketch.line(plot, first, reference, "reference", first.run.time, tame(first.run[reference], limits), **style)


def draw_error(sketch: Sketch) -> None:
    """Draw the norm of the tracking error, with the threshold that triggers."""
    with np.errstate(all="ignore"):
        errors = [norm(list(s.run.errors.values())) for s in sketch.shown]
    limits = error_limits(errors, sketch.main[0].run.scenario.limits.divergence)
    plot = sketch.add("tracking error |e|", limits, is_log=True)
    for s, error in zip(sketch.shown, errors, strict=True):
        sketch.line(plot, s, "error", "|e|", s.run.time, tame(error, limits, is_log=True))
    if (threshold := trigger_threshold(sketch.main[0].run)) is not None:
        plot.add_layout(Span(location=threshold, dimension="width", line_dash="dotted", line_color=BLACK))


def draw_inputs(sketch: Sketch) -> None:
    """Draw the inputs of the plant: what the controller did."""
    for name, column in inputs_of(sketch.main[0].run).items():
        having = [s for s in sketch.shown if column in s.run.series]
        limits = value_range([s.run[column] for s in having], percentile=0.5) or (0.0, 1.0)
        plot = sketch.add(axis_label(f"input {name}", sketch.units.get(column)), limits)
        for s in having:
            sketch.line(plot, s, column, name, s.run.time, tame(s.run[column], limits), mode="before", line_width=1.2)


def draw_parameters(sketch: Sketch) -> None:
    """Draw each parameter in the controller with its uncertainty, and the truth."""
    first = sketch.main[0]
    for p in first.run.scenario.estimation.parameters:
        having = [s for s in sketch.main if p.name in s.run.estimates]
        truth = first.run.true_parameters[p.name]
        limits = value_range([truth, *(s.run.estimates[p.name] for s in having)]) or (p.lower, p.upper)
        is_log = p.scale == "log" and limits[0] > 0.0 and limits[1] > 3.0 * limits[0]
        plot = sketch.add(axis_label(p.name, p.unit), limits, is_log)
        for s in having:
            band = uncertainty_band(s.run, p.name, s.events) if len(s.run.time) else None
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
