"""Figures of a finished run, as PNG files in its folder."""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from .canvas import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    VERMILION,
    Limits,
    Series,
    label,
    new_figure,
    save_png,
    set_linear,
    set_log,
    tame,
    tidy,
    value_range,
    with_unit,
)
from .errors import CosimError
from .library import find_fmu
from .record import EVENTS
from .response import draw_response
from .result import Run
from .schema import EstimatedParameter, Tracking
from .slave import read_description

Event = Mapping[str, Any]

_BASELINES: Final = {"none": ("nominal", VERMILION), "true": ("true parameters", GREEN)}
_SHADE: Final = "0.93"


class Curve(NamedTuple):
    """One run's part in a figure."""

    run: Run
    text: str
    """For the legend."""
    colour: str
    width: float
    """Of the line [pt]."""


def draw_run(run: Run, baselines: Mapping[str, Run]) -> list[Path]:
    """Draw what applies of tracking, error, parameters and response into the run's folder; the files written.

    baselines: finished runs of the same scenario by estimator; `none` and `true` are compared with. A run that stopped
    early is drawn as far as it came, one without a row not at all.
    Raises ValueError for a run without a folder, FolderError where a file cannot be written.
    """
    if run.folder is None:
        raise ValueError("draw_run needs a run that was recorded, got one without a folder; run it with `out`.")
    if not len(run.time):
        return []
    events = _read_events(run.folder)
    curves = _curves(run, baselines)
    figures = {
        "tracking.png": _draw_tracking(run, curves, events),
        "error.png": _draw_error(run, curves, events),
        "parameters.png": _draw_parameters(run, events),
        "response.png": draw_response(run, events),
    }
    return [save_png(figure, run.folder / name) for name, figure in figures.items() if figure is not None]


def _read_events(folder: Path) -> list[Event]:
    """The events of a run folder, as far as they can be read; none where there is no file."""
    events: list[Event] = []
    with suppress(OSError), open(folder / EVENTS, encoding="utf-8", errors="replace") as file:
        for line in file:
            with suppress(json.JSONDecodeError):  # the last line of a run that was killed
                events.append(json.loads(line))
    return [e for e in events if isinstance(e.get("t"), int | float)]


def _curves(run: Run, baselines: Mapping[str, Run]) -> list[Curve]:
    """The run last, so that it lies on top."""
    compared = {name: other for name, other in baselines.items() if name in _BASELINES and len(other.time)}
    curves = [Curve(compared[name], *_BASELINES[name], 1.1) for name in _BASELINES if name in compared]
    text, colour = _BASELINES.get(run.estimator, (f"re-tuned ({run.estimator})", BLUE))
    return [c for c in curves if c.text != text] + [Curve(run, text, colour, 1.5)]


def _draw_tracking(run: Run, curves: Sequence[Curve], events: Sequence[Event]) -> Figure:
    """Tracked outputs and their references over time."""
    figure, panels = _panels(run, events, len(run.scenario.tracking))
    units = _units(run)
    names = _short_names(list(run.scenario.tracking))
    shown = [c for c in curves if c.run.estimator != "true"] or curves
    for axes, (output, reference), name in zip(panels, run.scenario.tracking.items(), names, strict=True):
        limits = set_linear(axes, _tracking_limits(run[reference], [c.run[output] for c in shown]))
        for curve in shown:
            _line(axes, curve, tame(curve.run[output], limits))
        axes.plot(run.time, tame(run[reference], limits), "--", color=BLACK, linewidth=1.1, label="reference")
        axes.set_ylabel(label(name, units.get(output)))
    return _finish(figure, panels)


def _tracking_limits(reference: Series, outputs: Sequence[Series]) -> Limits:
    """Of all curves but for excursions more than twice as far from the reference as it is wide itself."""
    wanted = value_range([reference, *outputs], percentile=0.2) or (0.0, 1.0)
    low, high = value_range([reference]) or wanted
    width = high - low
    if width <= 1e-9 * max(abs(low), abs(high)):
        return min(low, wanted[0]), max(high, wanted[1])
    return min(low, max(wanted[0], low - 2.0 * width)), max(high, min(wanted[1], high + 2.0 * width))


def _draw_error(run: Run, curves: Sequence[Curve], events: Sequence[Event]) -> Figure:
    """Absolute tracking errors over time; with several tracked outputs, their norm, which triggers, above them."""
    outputs, units = list(run.scenario.tracking), _units(run)
    rows: list[tuple[str | None, str | None, list[str]]] = [
        (name, units.get(o), [o]) for name, o in zip(_short_names(outputs), outputs, strict=True)
    ]
    if len(outputs) > 1:
        own = {units.get(o) for o in outputs}
        rows.insert(0, (None, own.pop() if len(own) == 1 else None, outputs))
    figure, panels = _panels(run, events, len(rows))
    for axes, (name, unit, members) in zip(panels, rows, strict=True):
        errors = [_norm([c.run.errors[o] for o in members]) for c in curves]
        limits = set_log(axes, "y", _error_limits(errors, run.scenario.limits.divergence))
        for curve, error in zip(curves, errors, strict=True):
            is_zero = not np.any(error > 0.0)
            _line(axes, curve._replace(text=curve.text + ": zero") if is_zero else curve, tame(error, limits, True))
        threshold = _threshold(run)
        if threshold is not None and len(members) == len(outputs):
            axes.axhline(threshold, color=BLACK, linewidth=0.9, linestyle=":", label="trigger threshold")
        text = r"$\Vert e \Vert$" if name is None else f"$|e|$ in {label(name)}"
        axes.set_ylabel(with_unit(text, unit))
    return _finish(figure, panels)


def _error_limits(errors: Sequence[Series], divergence: float) -> Limits:
    """At most six decades, of which the least percent of values may fall below."""
    positive = [e[np.isfinite(e) & (e > 0.0)] for e in errors]
    low, _ = value_range(positive, percentile=1.0) or (1e-3, 1.0)
    _, high = value_range(positive) or (1e-3, 1.0)
    high = min(high, 2.0 * divergence)
    return min(max(low, 1e-6 * high), 0.5 * high), high


def _draw_parameters(run: Run, events: Sequence[Event]) -> Figure:
    """Estimated parameters over time: truth, what the controller held and how surely, what was tried."""
    parameters = run.scenario.estimation.parameters
    figure, panels = _panels(run, events, len(parameters))
    truth, held = run.true_parameters, run.estimates
    tried = [e for e in events if e.get("kind") == "candidate"]
    writes = [e for e in events if e.get("kind") == "write"]
    for i, (axes, p) in enumerate(zip(panels, parameters, strict=True)):
        limits = _parameter_axis(axes, p, [truth[p.name], held[p.name]])
        is_log = p.scale == "log"
        _draw_band(axes, run, p, writes, i)
        axes.plot(
            [e["t"] for e in tried], tame(_column(tried, "theta", i), limits, is_log), ".", color=ORANGE, markersize=3,
            alpha=0.5, markeredgewidth=0, label="candidates",
        )  # fmt: skip
        axes.step(
            run.time, tame(held[p.name], limits, is_log), where="post", color=BLUE, label="controller", **_mark(run)
        )
        if np.any(np.isfinite(truth[p.name])):
            axes.step(
                run.time,
                tame(truth[p.name], limits, is_log),
                "--",
                where="post",
                color=BLACK,
                linewidth=1.1,
                label="truth",
            )
        axes.set_ylabel(label(p.name, p.unit))
    return _finish(figure, panels)


def _parameter_axis(axes: Axes, p: EstimatedParameter, curves: Sequence[ArrayLike]) -> Limits:
    """As far as truth and controller go, with room to see candidates; on the scale of the search."""
    low, high = value_range(curves) or (p.lower, p.upper)
    if p.scale == "log" and low > 0.0:
        return set_log(axes, "y", (low, high) if high > 1.2 * low else (low / 1.1, high * 1.1), margin=0.15)
    return set_linear(axes, (low, high), margin=0.15)


def _draw_band(axes: Axes, run: Run, p: EstimatedParameter, writes: Sequence[Event], i: int) -> None:
    """Two standard deviations round each value written, until the next; on a log scale a factor either way."""
    theta, std = _column(writes, "theta", i), _column(writes, "std", i)
    if not np.any(np.isfinite(theta + std)):
        return
    if p.scale == "log":
        factor = np.exp(np.minimum(2.0 * std / np.maximum(theta, p.lower), 50.0))
        low, high = theta / factor, theta * factor
    else:
        low, high = theta - 2.0 * std, theta + 2.0 * std
    times = np.array([*(e["t"] for e in writes), float(run.time[-1])])
    band = (np.clip(np.append(edge, edge[-1]), p.lower, p.upper) for edge in (low, high))
    axes.fill_between(times, *band, step="post", color=BLUE, alpha=0.18, linewidth=0, label="± 2 standard deviations")


def _column(events: Sequence[Event], key: str, i: int) -> Series:
    """Entry i of a list that events carry (n,), NaN where it is absent or null."""
    lists: list[list[float | None]] = [e.get(key) or [] for e in events]
    entries = (values[i] if i < len(values) else None for values in lists)
    return np.array([np.nan if v is None else v for v in entries], dtype=float)


def _panels(run: Run, events: Sequence[Event], n: int) -> tuple[Figure, list[Axes]]:
    """n axes over the scenario's time, in two columns where there are many; episodes shaded."""
    n_columns = 1 if n <= 5 else 2
    n_rows = -(-n // n_columns)
    figure = new_figure(7.2 * (1.0 if n_columns == 1 else 1.5), 1.3 + (2.6 if n_rows == 1 else 1.7 * n_rows))
    grid: Any = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    for spare in grid.flat[n:]:
        spare.set_visible(False)
    panels: list[Axes] = list(grid.flat[:n])
    settings = run.scenario.scenario
    for axes in panels:
        tidy(axes)
        axes.set_xlim(settings.start_time, settings.stop_time)
        for i, (begin, end) in enumerate(_episodes(run, events)):
            axes.axvspan(begin, end, color=_SHADE, linewidth=0, zorder=-1, label="estimating" if i == 0 else None)
        if run.status != "done":
            axes.axvline(float(run.time[-1]), color=GREY, linewidth=1.0, label=f"{run.status}")
    for axes in panels[-n_columns:]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    return figure, panels


def _episodes(run: Run, events: Sequence[Event]) -> Iterator[Limits]:
    """Begin and end [s] of each stretch of episodes; those that follow one another within two macro steps are one."""
    gap = 2.0 * run.scenario.scenario.macro_step
    begin = end = None
    for event in events:
        if event.get("kind") not in ("trigger", "candidate", "end"):
            continue
        t = float(event["t"])
        if begin is None or end is None:
            begin = t
        elif t > end + gap:
            yield begin, end
            begin = t
        end = t
    if begin is not None and end is not None:
        yield begin, end


def _line(axes: Axes, curve: Curve, values: Series) -> None:
    axes.plot(curve.run.time, values, color=curve.colour, linewidth=curve.width, label=curve.text, **_mark(curve.run))


def _mark(run: Run) -> dict[str, Any]:
    """A line through one point is invisible."""
    return {"marker": "o"} if len(run.time) == 1 else {}


def _finish(figure: Figure, panels: Sequence[Axes]) -> Figure:
    """Legend of everything that any panel shows, above them all."""
    handles = {text: h for axes in panels for h, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    figure.align_ylabels(list(panels))
    return figure


def _threshold(run: Run) -> float | None:
    """Tracking error [unit of the tracked outputs] that begins an episode of this run, where it is that which does."""
    estimation = run.scenario.estimation
    trigger = estimation.trigger if run.estimator in _BASELINES else estimation.loop(run.estimator).trigger
    return trigger.threshold if isinstance(trigger, Tracking) else None


def _norm(errors: Sequence[Series]) -> Series:
    """Euclidean norm (n,) over the tracked outputs; scaled first, so that huge values do not overflow."""
    table = np.abs(np.array(errors))
    largest = np.max(table, axis=0)
    scale = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return scale * np.sqrt(np.sum((table / scale) ** 2, axis=0))


def _short_names(references: Sequence[str]) -> list[str]:
    """Variables without their component, where that leaves them different."""
    short = [r.partition(".")[2] for r in references]
    return short if len(set(short)) == len(short) else list(references)


def _units(run: Run) -> dict[str, str]:
    """Units of the tracked outputs by reference, as their FMUs declare them; none for an FMU that is gone."""
    units: dict[str, str] = {}
    for reference in run.scenario.tracking:
        component, _, variable = reference.partition(".")
        with suppress(CosimError):
            description = read_description(find_fmu(run.scenario.components[component].fmu, run.scenario.folder))
            found = {v.name: v.unit or getattr(v.declaredType, "unit", None) for v in description.modelVariables}
            if found.get(variable):
                units[reference] = str(found[variable])
    return units
