"""Figure of the estimated parameters over time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from ..errors import CosimError
from ..runs.quantities import event_column, uncertainty_band
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run, Series
from ..scenarios.schema.estimation import EstimatedParameter
from ..system.tuning import tuning_rule
from ..variable_name import VariableName
from .canvas import label, set_linear, set_log
from .palette import BLACK, BLUE, ORANGE
from .panels import finish, mark, panels, title_of
from .ranges import AxisLimits, tame, value_range


def draw_parameters(run: Run, events: Sequence[RecordedEvent]) -> Figure:
    """Draw the parameters over time: true values, the controller's with their uncertainty, and candidates.

    Below them are the parameters of the controller that formulas give.
    """
    parameters, gains = run.scenario.estimation.parameters, run.gains
    figure, rows = panels(run, events, len(parameters) + len(gains))
    truth, held = run.true_parameters, run.estimates
    tried = [e for e in events if e.get("kind") == "candidate"]
    for i, (axes, p) in enumerate(zip(rows, parameters, strict=False)):
        limits, is_log = parameter_axis(axes, p, [truth[p.name], held[p.name]])
        draw_band(axes, run, p.name, events, BLUE)
        places = tame(event_column(tried, "theta", i), limits, is_log)
        dots: dict[str, Any] = {"markersize": 5, "alpha": 0.55, "markeredgewidth": 0}
        if tried:
            axes.plot([e["t"] for e in tried], places, ".", color=ORANGE, label="candidates", **dots)
        styles: list[tuple[Series, str, dict[str, Any]]] = [
            (held[p.name], "controller", {"color": BLUE, "linewidth": _width(held[p.name])} | mark(run)),
            (truth[p.name], "truth", {"color": BLACK, "linewidth": 1.0, "linestyle": "--"}),
        ]
        for values, text, style in styles:
            if np.any(np.isfinite(values)):
                axes.step(run.time, tame(values, limits, is_log), where="post", label=text, **style)
        axes.set_ylabel(label(p.name, p.unit))
    for axes, (name, values) in zip(rows[len(parameters) :], gains.items(), strict=True):
        _draw_gain(axes, run, name, values)
    return finish(figure, rows, title_of(run))


def _draw_gain(axes: Axes, run: Run, name: str, values: Series) -> None:
    """Draw a parameter of the controller that a formula gives, and what it gives for the true parameters."""
    truth = _true_gain(run, name)
    limits = set_linear(axes, value_range([values, truth]) or (0.0, 1.0), margin=0.1)
    style: dict[str, Any] = {"color": BLUE, "linewidth": _width(values)} | mark(run)
    axes.step(run.time, tame(values, limits, False), where="post", label="controller", **style)
    if np.any(np.isfinite(truth)):
        dashed: dict[str, Any] = {"color": BLACK, "linewidth": 1.0, "linestyle": "--"}
        axes.step(run.time, tame(truth, limits, False), where="post", label="truth", **dashed)
    axes.set_ylabel(VariableName(name).variable)


def _true_gain(run: Run, name: str) -> Series:
    """Return what the tuning rule gives for the true parameters (n,); NaN where that is not known."""
    found = np.full(len(run.time), np.nan)
    try:
        rule = tuning_rule(run.scenario)
    except CosimError:  # a function of somebody else's, or one that has gone
        return found
    place = rule.names.index(VariableName(name))
    truth = np.array(list(run.true_parameters.values())).T
    changed = [k for k in range(len(truth)) if k == 0 or np.any(truth[k] != truth[k - 1])]
    for k in changed:
        try:
            found[k:] = rule(truth[k])[place]
        except ValueError:
            found[k:] = np.nan
    return found


def parameter_axis(axes: Axes, p: EstimatedParameter, curves: Sequence[ArrayLike]) -> tuple[AxisLimits, bool]:
    """Set the axis over true and held values, with room for candidates, on the scale of the search.

    Returns its limits, and whether it is logarithmic.
    """
    low, high = value_range(curves) or (p.lower, p.upper)
    if p.scale == "log" and low > 0.0:
        low, high = max(low, 0.1 * p.lower), min(max(high, p.lower), 10.0 * p.upper)
        return set_log(axes, "y", (min(low, high / 1.1), max(high, low * 1.1)), margin=0.1), True
    return set_linear(axes, (low, high), margin=0.1), False


def _width(values: Series) -> float:
    """Return the line width [pt]: thin for values that jump so often that the line would fill the axes."""
    low, high = value_range([values]) or (0.0, 0.0)
    with np.errstate(all="ignore"):
        n_jumps = np.count_nonzero(np.abs(np.diff(values)) > 0.1 * (high - low))
    return 0.5 if n_jumps > 150 else 1.8


def draw_band(axes: Axes, run: Run, name: str, events: Sequence[RecordedEvent], colour: str) -> None:
    """Draw a band of two standard deviations about each value written, until the next; on a log scale a factor."""
    band = uncertainty_band(run, name, events)
    if band is not None:
        axes.fill_between(
            band.t, band.low, band.high, step="post", color=colour, alpha=0.2, linewidth=0, label="± 2 std"
        )
