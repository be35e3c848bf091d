"""Figures of a finished run, as PNG files in its folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..runs.quantities import inputs_of, norm, short_names, trigger_threshold, units_of
from ..runs.recorded_events import RecordedEvent, read_events
from ..runs.result import Run
from .canvas import label, save_png, set_linear, set_log, with_unit
from .palette import BASELINES, BLACK, BLUE, Dashed
from .panels import Curve, finish, line, panels, title_of
from .parameters import draw_parameters
from .ranges import error_limits, tame, tracking_limits, value_range
from .response import draw_response


def draw_run(run: Run, baselines: Mapping[str, Run]) -> list[Path]:
    """Draw tracking, error, parameters and response, as they apply, into the run's folder; return the files written.

    baselines: finished runs of the same scenario by estimator; `none` and `true` are drawn for comparison. A run that
    stopped early is drawn as far as it went, one without rows not at all.
    Raises ValueError for a run without a folder, FolderError where a file cannot be written.
    """
    if run.folder is None:
        raise ValueError("draw_run needs a run that was recorded, got one without a folder; run it with `out`.")
    if not len(run.time):
        return []
    events = read_events(run.folder)
    curves = _curves(run, baselines)
    figures = {
        "tracking.png": draw_tracking(run, curves, events),
        "error.png": _draw_error(run, curves, events),
        "parameters.png": draw_parameters(run, events),
        "response.png": draw_response(run, events),
    }
    return [save_png(figure, run.folder / name) for name, figure in figures.items() if figure is not None]


def _curves(run: Run, baselines: Mapping[str, Run]) -> list[Curve]:
    """Return the curves of the baselines and, last so that it is drawn on top, of the run."""
    compared = {name: other for name, other in baselines.items() if name in BASELINES and len(other.time)}
    curves = [Curve(compared[name], *BASELINES[name], 1.1) for name in BASELINES if name in compared]
    text, style = BASELINES.get(run.estimator, (f"re-tuned ({run.estimator})", Dashed(BLUE)))
    return [c for c in curves if c.text != text] + [Curve(run, text, style, 2.0)]


def draw_tracking(run: Run, curves: Sequence[Curve], events: Sequence[RecordedEvent]) -> Figure:
    """Draw tracked outputs and their references over time, and below them the plant's inputs u."""
    inputs = inputs_of(run)
    figure, rows = panels(run, events, len(run.scenario.tracking) + len(inputs))
    units = units_of(run)
    names = short_names(list(run.scenario.tracking))
    shown = [c for c in curves if c.run.estimator != "true"] or curves
    for axes, (output, reference), name in zip(rows, run.scenario.tracking.items(), names, strict=False):
        limits = set_linear(axes, tracking_limits(run[reference], [c.run[output] for c in shown]))
        for curve in shown:
            line(axes, curve, tame(curve.run[output], limits))
        axes.plot(run.time, tame(run[reference], limits), "--", color=BLACK, linewidth=1.0, label="reference")
        axes.set_ylabel(label(name, units.get(output)))
    for axes, (name, column) in zip(rows[len(names) :], inputs.items(), strict=True):
        series = [c.run[column] for c in shown]
        limits = set_linear(axes, value_range(series, percentile=0.5) or (0.0, 1.0), margin=0.1)
        for curve, u in zip(shown, series, strict=True):
            line(axes, curve._replace(width=0.6 * curve.width), tame(u, limits), "steps-pre")
        axes.set_ylabel(label(name, units.get(column)))
    return finish(figure, rows, title_of(run))


def _draw_error(run: Run, curves: Sequence[Curve], events: Sequence[RecordedEvent]) -> Figure:
    """Draw absolute tracking errors over time; with several tracked outputs, also their norm, which triggers."""
    outputs: list[str] = list(run.scenario.tracking)
    units = units_of(run)
    contents: list[tuple[str | None, str | None, list[str]]] = [
        (name, units.get(o), [o]) for name, o in zip(short_names(outputs), outputs, strict=True)
    ]
    if len(outputs) > 1:
        own = {units.get(o) for o in outputs}
        contents.insert(0, (None, own.pop() if len(own) == 1 else None, outputs))
    figure, rows = panels(run, events, len(contents))
    for axes, (name, unit, members) in zip(rows, contents, strict=True):
        with np.errstate(all="ignore"):  # infinite minus infinite
            errors = [norm([c.run.errors[o] for o in members]) for c in curves]
        limits = set_log(axes, "y", error_limits(errors, run.scenario.limits.divergence))
        for curve, error in zip(curves, errors, strict=True):
            is_zero = not np.any(error > 0.0)
            line(axes, curve._replace(text=curve.text + ": zero") if is_zero else curve, tame(error, limits, True))
        threshold = trigger_threshold(run)
        if threshold is not None and len(members) == len(outputs):
            axes.axhline(threshold, color=BLACK, linewidth=0.9, linestyle=":", label="trigger threshold")
        text = r"$\Vert e \Vert$" if name is None else f"$|e|$ in {label(name)}"
        axes.set_ylabel(with_unit(text, unit))
    return finish(figure, rows, title_of(run))
