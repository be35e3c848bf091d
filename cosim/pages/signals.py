"""Pictures of what plant and controller did: tracking, error, inputs and parameters."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import Span

from ..plots.own_series import is_own
from ..plots.palette import BLACK
from ..plots.ranges import error_limits, tame, tracking_limits, value_range
from ..runs.quantities import inputs_of, norm, short_names, trigger_threshold, uncertainty_band
from ..runs.result import Series
from .sketch import ShownRun, Sketch, axis_label


def draw_tracking(sketch: Sketch) -> None:
    """Draw the tracked outputs with their references."""
    tracking = sketch.main[0].run.scenario.tracking
    for (output, reference), name in zip(tracking.items(), short_names(list(tracking)), strict=True):
        having = [s for s in sketch.shown if output in s.run.series]
        tracked = [(s, s.run.scenario.tracking[output]) for s in sketch.main if output in s.run.scenario.tracking]
        references = [(s, s.run[column]) for s, column in tracked]
        limits = tracking_limits(np.concatenate([r for _, r in references]), [s.run[output] for s in having])
        plot = sketch.add(axis_label(name, sketch.units.get(output)), limits)
        for s in having:
            sketch.line(plot, s, output, name, s.run.time, tame(s.run[output], limits))
        _draw_dashed(sketch, plot, (reference, "reference"), [(s, tame(r, limits)) for s, r in references])


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
    for p in sketch.main[0].run.scenario.estimation.parameters:
        having = [s for s in sketch.main if p.name in s.run.estimates]
        truths = [(s, s.run.true_parameters[p.name]) for s in having]
        values = [*(truth for _, truth in truths), *(s.run.estimates[p.name] for s in having)]
        limits = value_range(values) or (p.lower, p.upper)
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
        known = [(s, tame(truth, limits, is_log)) for s, truth in truths if np.any(np.isfinite(truth))]
        _draw_dashed(sketch, plot, (f"true {p.name}", f"true {p.name}"), known, mode="after")


def _draw_dashed(
    sketch: Sketch, plot: Any, name: tuple[str, str], series: Sequence[tuple[ShownRun, Series]], **style: Any
) -> None:
    """Draw references or true values (n,): the first run's in black, below it others that differ, in colour.

    name: of the column, and on hover.
    """
    style |= {"line_dash": [4, 3], "line_width": 1.2}
    for k, (s, values) in reversed([*enumerate(series)]):
        first, of_first = series[0]
        if k == 0 or is_own(s.run, values, first.run, of_first):
            sketch.line(plot, s, *name, s.run.time, values, line_color=s.style.colour if k else BLACK, **style)
