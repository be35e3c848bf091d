"""Hypotheses that the diagnosis has compared: a picture of how much worse than the best each is, and words for it."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from bokeh.models import Legend, LegendItem, Span

from estimator.hypotheses import MARGIN

from ..plots.palette import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE
from ..runs.recorded_events import RecordedEvent
from ..text_table import counted
from .marks import Sign, thinned
from .sketch import Sketch

HYPOTHESES: Final[Mapping[str, Sign]] = {
    "nothing": Sign("nothing has changed", "circle", GREY),
    "disturbance": Sign("a disturbance acts", "diamond", PURPLE),
    "inputs": Sign("inputs are stuck, or free again", "square_dot", PURPLE),
    "lag": Sign("inputs arrive late, or are limited", "diamond_dot", PURPLE),
    "friction": Sign("friction that the model lacks", "circle_cross", PURPLE),
    "coloured": Sign("noise is correlated from sample to sample", "triangle_dot", ORANGE),
    "both": Sign("both", "square", GREEN),
    "parameters": Sign("parameters have changed", "triangle", BLUE),
}
"""Hypotheses, those of most interest last: they are drawn above the others."""
_ABREAST: Final = 4
"""Number of hypotheses in a line of the legend: more do not fit."""
_LEAST: Final = 1.0
"""Least difference that is drawn: less is nothing."""


def compared(event: RecordedEvent) -> dict[str, float]:
    """Return how much worse than the best each hypothesis of an event is, from the best on; empty for other events."""
    scores = event.get("scores")
    if event.get("kind") != "evidence" or not isinstance(scores, dict):
        return {}
    known = {name: score for name, score in scores.items() if name in HYPOTHESES and score is not None}
    return {name: known[name] - min(known.values()) for name in sorted(known, key=lambda name: known[name])}


def evidence_of(event: RecordedEvent) -> str:
    """Return in words which hypothesis explains the samples best, and how much worse the others do; or nothing."""
    found = compared(event)
    if not found:
        return ""
    best, *others = found
    n = int(event.get("n_samples", 1))
    samples = "sample" if n == 1 else counted(n, "sample")
    how = "explains" if best in event.get("explained", ()) else "is nearest to, but does not explain,"
    worse = ", ".join(f"{HYPOTHESES[name].text} (by {found[name]:.3g})" for name in others)
    return f'"{HYPOTHESES[best].text}" {how} the newest {samples}{f"; worse: {worse}" if worse else ""}'


def draw_hypotheses(sketch: Sketch) -> None:
    """Draw by how much each hypothesis is worse than the best, and what is very strong evidence against one."""
    events = {s.key: thinned([e for e in s.events if e.get("kind") == "evidence"]) for s in sketch.main}
    found = {key: [(e, of) for e in each if (of := compared(e))] for key, each in events.items()}
    differences = [d for of in found.values() for _, each in of for d in each.values()]
    if not differences:
        return
    limits = (_LEAST, max(*differences, 10.0 * MARGIN))
    plot = sketch.add("evidence: worse than\nthe best by", limits, is_log=True, height=225)
    items: list[Any] = []
    for name, sign in HYPOTHESES.items():
        drawn: list[Any] = []
        for s in sketch.main:
            having = [(e, of) for e, of in found[s.key] if name in of]
            if having:
                colour = sign.colour if len(sketch.main) == 1 else s.style.colour
                columns = {
                    "x": np.array([float(e["t"]) for e, _ in having]),
                    "y": np.maximum([of[name] for _, of in having], _LEAST),
                    "text": [_told(name, e, of) for e, of in having],
                }
                style = {"marker": sign.marker, "size": 7, "line_color": colour, "fill_color": colour}
                drawn.append(sketch.points(plot, s, f"evidence {name}", columns, fill_alpha=0.35, **style))
        if drawn:
            items.append(LegendItem(label=sign.text, renderers=drawn))
    plot.add_layout(Span(location=MARGIN, dimension="width", line_dash="dotted", line_color=BLACK))
    legend = Legend(items=items[::-1], orientation="horizontal", ncols=_ABREAST, margin=2, border_line_color=None)
    plot.add_layout(legend, "above")


def _told(name: str, event: RecordedEvent, of: Mapping[str, float]) -> str:
    """Return the words for a hypothesis: how much worse than the best it is, and the whole comparison."""
    how = "the best" if of[name] <= 0.0 else f"worse than the best by {of[name]:.3g}"
    strength = ", very strong evidence against it" if of[name] >= MARGIN else ""
    return f"{HYPOTHESES[name].text}: {how}{strength}. {evidence_of(event)}"
