"""Pictures of why re-tuning did what it did: events, evidence, disturbances and latencies."""

from typing import Any, Final

import numpy as np
from bokeh.models import Span

from ..plots.palette import BLACK, ORANGE
from ..plots.ranges import tame, value_range
from ..runs.innovations import innovation_limit, innovations
from ..runs.quantities import disturbance_sizes
from ..runs.result import Series
from ..variable_name import VariableName
from .marks import MOST_MARKS, SIGNS, reason_of, thinned
from .sketch import ShownRun, Sketch, axis_label
from .thinning import kept_rows

_RANGE: Final = 1e-12
"""Ratio of the smallest misfit that is drawn to the largest."""


def draw_events(sketch: Sketch) -> None:
    """Draw a mark for every event, a row for each kind."""
    kinds = [k for k in SIGNS if any(e.get("kind") == k for s in sketch.main for e in s.events)]
    if not kinds:
        return
    plot = sketch.add_rows([SIGNS[kind].text for kind in kinds])
    for s in sketch.main:
        for kind in kinds:
            events = thinned([e for e in s.events if e.get("kind") == kind])
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


def draw_disturbances(sketch: Sketch) -> None:
    """Draw the known size of disturbances, as the diagnosis estimates it, a picture for each channel."""
    sizes = {s.key: disturbance_sizes(s.run, s.events) for s in sketch.main}
    for channel in sorted({channel for of in sizes.values() for channel in of}):
        having = [(s, sizes[s.key][channel]) for s in sketch.main if channel in sizes[s.key]]
        limits = value_range([list(of.values()) for _, of in having]) or (0.0, 1.0)
        name = VariableName(channel).variable if "." in channel else channel
        label = axis_label(name, sketch.units.get(channel)).replace(" [", "\n[")
        plot = sketch.add(f"disturbance of\n{label}", limits, height=130)
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


def draw_innovations(sketch: Sketch) -> None:
    """Draw how much each sample contradicts the parameters held, and the limit for noise alone."""
    found = [(s, values) for s in sketch.main if (values := innovations(s.run)) is not None]
    limit = innovation_limit(sketch.main[0].run)
    top = value_range([values for _, values in found])
    if top is None:
        return
    limits = (0.02 * limit, max(top[1], 2.0 * limit))
    plot = sketch.add("evidence against\nwhat is held", limits, is_log=True)
    for s, values in found:
        sketch.line(plot, s, "innovation", "innovation squared", s.run.time, tame(values, limits, True), line_width=1.0)
    plot.add_layout(Span(location=limit, dimension="width", line_dash="dotted", line_color=BLACK))


def draw_evidence(sketch: Sketch) -> None:
    """Draw how well each candidate explains the samples: the first of a search are the parameters held."""
    found = {
        s.key: [e for e in s.events if e.get("kind") == "candidate" and _is_positive(e.get("cost"))]
        for s in sketch.main
    }
    costs = [float(e["cost"]) for events in found.values() for e in events]
    if not costs:
        return
    low, high = min(costs), max(costs)
    limits = (max(low, _RANGE * high), high)
    plot = sketch.add("evidence: misfit\nof the candidates", limits, is_log=True)
    for s in sketch.main:
        events = found[s.key]
        events = [events[k] for k in kept_rows(np.array([float(e["cost"]) for e in events]), n=MOST_MARKS)]
        columns = {
            "x": np.array([float(e["t"]) for e in events]),
            "y": np.clip([float(e["cost"]) for e in events], *limits),
            "text": [reason_of(e, s.run) for e in events],
        }
        sketch.points(plot, s, "candidate", columns, size=4, color=s.style.colour, alpha=0.6)


def _is_positive(value: Any) -> bool:
    return isinstance(value, int | float) and 0.0 < value < 1e100


def draw_latencies(sketch: Sketch) -> None:
    """Draw the wall time of each macro step's evaluations against the deadline."""
    times_of = {s.key: times for s in sketch.main if (times := _evaluation_times(s)) is not None}
    having = [s for s in sketch.main if s.key in times_of]
    if not having:
        return
    deadline = 1e3 * sketch.main[0].run.scenario.scenario.macro_step
    sums = {s.key: 1e3 * np.array([sum(step) for step in s.run.latencies]) for s in having}
    limits = value_range([*sums.values(), np.array([deadline])]) or (1.0, 10.0)
    plot = sketch.add("latency [ms]", (max(limits[0], 1e-3), limits[1]), is_log=True)
    for s in having:
        times = times_of[s.key]
        rows = kept_rows(sums[s.key], n=MOST_MARKS)
        texts = [f"{ms:.3g} ms, deadline {deadline:g} ms" for ms in sums[s.key][rows]]
        columns = {"x": times[rows], "y": sums[s.key][rows], "text": texts}
        sketch.points(plot, s, "latency", columns, size=4, color=s.style.colour, alpha=0.6)
    plot.add_layout(Span(location=deadline, dimension="width", line_dash="dashed", line_color=BLACK))


def _evaluation_times(s: ShownRun) -> Series | None:
    """Return the times [s] of the macro steps with evaluations; None where there are none, or they are not known."""
    times = s.run.latency_times
    if times is None:  # a record of an earlier version
        times = np.unique([float(e["t"]) for e in s.events if e.get("kind") == "candidate"])
    return times if len(times) == len(s.run.latencies) > 0 else None
