"""Pictures of chosen columns of runs, laid over one another: `retune plot` and `Run.plot`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..errors import FolderError
from ..names import did_you_mean
from ..runs.quantities import inputs_of, units_of
from ..runs.recorded_events import RecordedEvent, read_events
from ..runs.result import Run, Series
from ..scenarios.schema.estimation import EstimatedParameter
from ..variable_name import VariableName
from .canvas import label, new_figure, set_linear, tidy, top_legend
from .overlay_texts import shared_by, texts_of
from .own_series import is_own
from .palette import BLACK, RUNS
from .panels import Curve, DrawStyle, line, title_of
from .parameters import draw_band, parameter_axis
from .ranges import AxisLimits, tame, tracking_limits, value_range


def draw_overlay(runs: Sequence[Run]) -> Figure:
    """Draw tracked outputs, inputs u and parameters of several runs over one another.

    runs: at most as many as the palette has styles. Raises FolderError for runs without rows, or without a column that
    all of them have.
    """
    empty = next((run for run in runs if not len(run.time)), None)
    if empty is not None:
        raise FolderError(f"{empty.folder} has no rows to draw.")
    columns = [c for c in columns_of(runs[0]) if all(c in columns_of(run) for run in runs)]
    if not columns:
        raise FolderError("these runs have no output, input or parameter in common.")
    n_columns = 1 if len(columns) <= 5 else 2
    n_rows = -(-len(columns) // n_columns)
    figure = new_figure(7.2 * (1.0 if n_columns == 1 else 1.5), 1.5 + 1.7 * n_rows)
    grid: Any = figure.subplots(n_rows, n_columns, sharex=True, squeeze=False)
    for spare in grid.flat[len(columns) :]:
        spare.set_visible(False)
    curves = [Curve(run, text, RUNS[k], 1.5) for k, (run, text) in enumerate(zip(runs, texts_of(runs), strict=True))]
    events = [read_events(run.folder) if run.folder else [] for run in runs]
    for axes, column in zip(grid.flat, columns, strict=False):
        draw_column(axes, column, curves, events)
    for axes in grid.flat[len(columns) - n_columns : len(columns)]:
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    handles = {text: h for axes in grid.flat for h, text in zip(*axes.get_legend_handles_labels(), strict=True)}
    top_legend(figure, handles, 3, shared_by(runs))
    return figure


def plot_run(run: Run, names: Sequence[str], axes: Any = None) -> Any:
    """Draw columns of a run, a pair of axes each; return the axes, in the form in which they were given.

    names: columns, by default tracked outputs, inputs and parameters; axes: Matplotlib axes or several, by default
    those of a new figure. Raises KeyError for a column that the run does not have, ValueError for too few axes.
    """
    columns = list(names) or columns_of(run)
    if unknown := next((name for name in columns if name not in run.series), None):
        raise KeyError(f"no column '{unknown}'{did_you_mean(unknown, list(run.series)) or '.'}")
    if axes is None:
        from matplotlib import pyplot  # only here: it chooses a backend for the whole process

        _, axes = pyplot.subplots(
            len(columns), sharex=True, squeeze=False, figsize=(7.2, 1.0 + 1.7 * len(columns)), layout="constrained"
        )
        axes = axes[:, 0] if len(columns) > 1 else axes[0, 0]
    places: list[Axes] = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(places) < len(columns):
        raise ValueError(f"{len(columns)} columns need as many axes, got {len(places)}.")
    events = read_events(run.folder) if run.folder else []
    for place, column in zip(places, columns, strict=False):
        draw_column(place, column, [Curve(run, run.estimator, RUNS[0], 1.5)], [events])
    places[0].set_title(title_of(run), fontsize=10)
    places[len(columns) - 1].set_xlabel("time [s]")
    return axes


def columns_of(run: Run) -> list[str]:
    """Return the columns that say most: tracked outputs, inputs of the plant, parameters in the controller."""
    return [
        *run.scenario.tracking,
        *inputs_of(run).values(),
        *(run.scenario.held_column(p) for p in run.scenario.estimation.parameters),
    ]


def draw_column(axes: Axes, column: str, curves: Sequence[Curve], events: Sequence[Sequence[RecordedEvent]]) -> None:
    """Draw a column of each run: a tracked output with its reference, a parameter with its truth and uncertainty."""
    run = curves[0].run
    tidy(axes)
    settings = [c.run.scenario.scenario for c in curves]
    axes.set_xlim(min(s.start_time for s in settings), max(s.stop_time for s in settings))
    held = [{c.run.scenario.held_column(p): p for p in c.run.scenario.estimation.parameters} for c in curves]
    if all(column in of_run for of_run in held):
        _draw_parameter(axes, [of_run[column] for of_run in held], curves, events)
        return
    series = [c.run[column] for c in curves]
    references = [(c, c.run[name]) for c in curves if (name := _reference(c.run, column)) is not None]
    inputs = {of: name for name, of in inputs_of(run).items()}
    is_input = column in inputs
    wanted = value_range(series, percentile=0.5 if is_input else 0.0) or (0.0, 1.0)
    if references:
        wanted = tracking_limits(np.concatenate([values for _, values in references]), series)
    limits = set_linear(axes, wanted)
    for curve, values in zip(curves, series, strict=True):
        line(axes, curve, tame(values, limits), "steps-pre" if is_input else "default")
    _draw_dashed(axes, "reference", references, limits)
    name = inputs.get(column) or (VariableName(column).variable if "." in column else column)
    axes.set_ylabel(label(name, units_of(run).get(column)))


def _draw_parameter(
    axes: Axes,
    parameters: Sequence[EstimatedParameter],
    curves: Sequence[Curve],
    events: Sequence[Sequence[RecordedEvent]],
) -> None:
    """Draw a parameter of the controller, which each run may have under another name and in another place."""
    p = parameters[0]
    truths = [(c, c.run.true_parameters[own.name]) for c, own in zip(curves, parameters, strict=True)]
    held = [c.run.estimates[own.name] for c, own in zip(curves, parameters, strict=True)]
    limits, is_log = parameter_axis(axes, p, [*(values for _, values in truths), *held])
    for curve, own, values, recorded in zip(curves, parameters, held, events, strict=True):
        draw_band(axes, curve.run, own.name, recorded, curve.style.colour)
        line(axes, curve, tame(values, limits, is_log), "steps-post")
    known = [(c, values) for c, values in truths if np.any(np.isfinite(values))]
    _draw_dashed(axes, "truth", known, limits, is_log, "steps-post")
    axes.set_ylabel(label(p.name, p.unit))


def _reference(run: Run, column: str) -> str | None:
    """Return the column of a tracked output's reference, None for any other column."""
    return run.scenario.tracking.get(VariableName(column)) if "." in column else None


def _draw_dashed(
    axes: Axes,
    text: str,
    series: Sequence[tuple[Curve, Series]],
    limits: AxisLimits,
    is_log: bool = False,
    drawstyle: DrawStyle = "default",
) -> None:
    """Draw references or true values (n,): the first run's in black, below it others that differ, in colour."""
    for k, (curve, values) in enumerate(series):
        first, of_first = series[0]
        if k and not is_own(curve.run, values, first.run, of_first):
            continue
        colour, told = (curve.style.colour, f"{text}, {curve.text}") if k else (BLACK, text)
        axes.plot(
            curve.run.time, tame(values, limits, is_log), "--", color=colour, linewidth=1.0, label=told,
            drawstyle=drawstyle, zorder=2.0 if k else 2.1,
        )  # fmt: skip
