"""Figures of a finished run, as PNG files in its folder."""

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from ..errors import CosimError
from ..files import readable
from ..fmi.component import read_component
from ..runs.result import Run
from ..runs.run_files import EVENTS
from ..system.fmu_cache import component_path
from ..variable_name import VariableName
from .canvas import (
    BLACK,
    BLUE,
    GREEN,
    VERMILION,
    AxisLimits,
    Series,
    label,
    save_png,
    set_linear,
    set_log,
    tame,
    value_range,
    with_unit,
)
from .panels import Curve, RecordedEvent, finish, line, panels
from .parameters import draw_parameters
from .response import draw_response

_BASELINES: Final = {"none": ("nominal", VERMILION), "true": ("true parameters", GREEN)}


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
        "tracking.png": _draw_tracking(run, curves, events),
        "error.png": _draw_error(run, curves, events),
        "parameters.png": draw_parameters(run, events),
        "response.png": draw_response(run, events),
    }
    return [save_png(figure, run.folder / name) for name, figure in figures.items() if figure is not None]


def read_events(folder: Path) -> list[RecordedEvent]:
    """Return the events of a run folder, as far as they can be read; none if there is no file."""
    events: list[Any] = []
    with suppress(OSError), open(readable(folder / EVENTS), encoding="utf-8", errors="replace") as file:
        for text in file:
            with suppress(json.JSONDecodeError):  # the last line of a run that was killed
                events.append(json.loads(text))
    return [e for e in events if isinstance(e, dict) and isinstance(e.get("t"), int | float)]


def _curves(run: Run, baselines: Mapping[str, Run]) -> list[Curve]:
    """Return the curves of the baselines and, last so that it is drawn on top, of the run."""
    compared = {name: other for name, other in baselines.items() if name in _BASELINES and len(other.time)}
    curves = [Curve(compared[name], *_BASELINES[name], 1.1) for name in _BASELINES if name in compared]
    text, colour = _BASELINES.get(run.estimator, (f"re-tuned ({run.estimator})", BLUE))
    return [c for c in curves if c.text != text] + [Curve(run, text, colour, 2.0)]


def _draw_tracking(run: Run, curves: Sequence[Curve], events: Sequence[RecordedEvent]) -> Figure:
    """Draw tracked outputs and their references over time."""
    figure, rows = panels(run, events, len(run.scenario.tracking))
    units = _units(run)
    names = short_names(list(run.scenario.tracking))
    shown = [c for c in curves if c.run.estimator != "true"] or curves
    for axes, (output, reference), name in zip(rows, run.scenario.tracking.items(), names, strict=True):
        limits = set_linear(axes, tracking_limits(run[reference], [c.run[output] for c in shown]))
        for curve in shown:
            line(axes, curve, tame(curve.run[output], limits))
        axes.plot(run.time, tame(run[reference], limits), "--", color=BLACK, linewidth=1.0, label="reference")
        axes.set_ylabel(label(name, units.get(output)))
    return finish(figure, rows)


def tracking_limits(reference: Series, outputs: Sequence[Series]) -> AxisLimits:
    """Return limits for all curves, without excursions of more than twice the reference's range from it."""
    wanted = value_range([reference, *outputs], percentile=0.2) or (0.0, 1.0)
    low, high = value_range([reference]) or wanted
    width = high - low
    if width <= 1e-9 * max(abs(low), abs(high)):
        return min(low, wanted[0]), max(high, wanted[1])
    return min(low, max(wanted[0], low - 2.0 * width)), max(high, min(wanted[1], high + 2.0 * width))


def _draw_error(run: Run, curves: Sequence[Curve], events: Sequence[RecordedEvent]) -> Figure:
    """Draw absolute tracking errors over time; with several tracked outputs, also their norm, which triggers."""
    outputs: list[str] = list(run.scenario.tracking)
    units = _units(run)
    contents: list[tuple[str | None, str | None, list[str]]] = [
        (name, units.get(o), [o]) for name, o in zip(short_names(outputs), outputs, strict=True)
    ]
    if len(outputs) > 1:
        own = {units.get(o) for o in outputs}
        contents.insert(0, (None, own.pop() if len(own) == 1 else None, outputs))
    figure, rows = panels(run, events, len(contents))
    for axes, (name, unit, members) in zip(rows, contents, strict=True):
        with np.errstate(all="ignore"):  # infinite minus infinite
            errors = [_norm([c.run.errors[o] for o in members]) for c in curves]
        limits = set_log(axes, "y", _error_limits(errors, run.scenario.limits.divergence))
        for curve, error in zip(curves, errors, strict=True):
            is_zero = not np.any(error > 0.0)
            line(axes, curve._replace(text=curve.text + ": zero") if is_zero else curve, tame(error, limits, True))
        threshold = _threshold(run)
        if threshold is not None and len(members) == len(outputs):
            axes.axhline(threshold, color=BLACK, linewidth=0.9, linestyle=":", label="trigger threshold")
        text = r"$\Vert e \Vert$" if name is None else f"$|e|$ in {label(name)}"
        axes.set_ylabel(with_unit(text, unit))
    return finish(figure, rows)


def _error_limits(errors: Sequence[Series], divergence: float) -> AxisLimits:
    """Return limits over at most six decades; the smallest percent of the values may lie below them."""
    positive = [e[np.isfinite(e) & (e > 0.0)] for e in errors]
    low, _ = value_range(positive, percentile=1.0) or (1e-3, 1.0)
    _, high = value_range(positive) or (1e-3, 1.0)
    high = min(max(high, 1e-30), 2.0 * divergence)
    return min(max(low, 1e-6 * high), 0.5 * high), high


def _threshold(run: Run) -> float | None:
    """Return the tracking error [unit of the tracked outputs] that triggers an episode in this run, or None."""
    estimation = run.scenario.estimation
    loop = estimation if run.estimator in _BASELINES else estimation.loop(run.estimator)
    return loop.trigger.tracking_error


def _norm(errors: Sequence[Series]) -> Series:
    """Return the Euclidean norm (n,) over the tracked outputs; scaled first, so that huge values do not overflow."""
    table = np.abs(np.array(errors))
    largest = np.max(table, axis=0)
    scale = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return scale * np.sqrt(np.sum((table / scale) ** 2, axis=0))


def short_names(references: Sequence[str]) -> list[str]:
    """Return variable names without their component, unless two of them would be the same."""
    short = [VariableName(r).variable for r in references]
    return short if len(set(short)) == len(short) else list(references)


def _units(run: Run) -> dict[str, str]:
    """Return the units of the tracked outputs as their FMUs declare them; none for a missing FMU."""
    units: dict[str, str] = {}
    for reference in run.scenario.tracking:
        component, variable = reference.parts
        with suppress(CosimError):
            found = read_component(component_path(run.scenario.components[component], run.scenario.folder))
            if variable in found.variables and (unit := found.unit(variable)):
                units[reference] = unit.name
    return units
