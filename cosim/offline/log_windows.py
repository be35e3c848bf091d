"""Windows of a log: consecutive rows, with every input known, over which a plant can be simulated.

An error in a log is refused in one line or, where harmless, passed over with a warning.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from estimator.space import Vector

from ..fmi.component import Component
from ..text_table import counted
from ..unit_text import understood
from ..units import Unit, conversion
from .logs import Column, Log, LogError

LARGEST: Final = 1e100
"""Largest absolute value that is taken for a measurement, in the variable's unit: its square can be summed."""
GAP: Final = 10.0
"""Distance of two rows that counts as a gap, in median distances of time stamps."""
_IN_A_SECOND: Final = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_DATES: Final = (6e8, 5e9)
"""Time since 1970 [s] that is taken for a date: 1989 to 2128."""
Cut = tuple[float, float]
"""From, to: time of the log [s]."""


@dataclass(frozen=True)
class LogColumns:
    """Columns of a log by role."""

    inputs: Mapping[str, str]
    """Column by input of the FMU."""
    measured: Mapping[str, str]
    """Column by output of the FMU."""
    start: Mapping[str, str]
    """Column by variable of the FMU that starts with its value in a window's first row."""
    time: str | None = None
    """Column of time stamps; None: the one called time or t."""
    time_unit: str | None = None
    """Unit of the time stamps; None: the log's, or s."""


@dataclass(frozen=True)
class LogWindow:
    """Rows of a log, in the FMU's units."""

    name: str
    """The log's file, and the part of it."""
    time: Vector
    """Time stamps (n,) [s], as in the log, n >= 2, increasing."""
    origin: float
    """The log's first time stamp [s], at which the FMU's time is 0."""
    inputs: Vector
    """Inputs (n, p), all known."""
    measured: Vector
    """Measured outputs (n, c); NaN where there is none."""
    start: Mapping[str, float]
    """Start values from the first row."""
    states: Vector
    """The columns (n, s) of those start values, row by row; NaN where there is none."""
    n_fit: int
    """Number of first rows, which parameters are fitted to; the others are held out."""
    log: Path = Path()
    """The log's file."""
    time_unit: str = "s"
    """Unit that its time stamps were taken to be in."""
    part: int = 1
    """Number of the part, from 1, into which gaps split what was asked for."""


def windows_of(
    log: Log, signals: LogColumns, component: Component, cuts: Sequence[Cut] = (), holdout: float = 0.0
) -> tuple[list[LogWindow], list[str]]:
    """Return the windows of a log, and warnings about what was passed over.

    cuts: parts of the log to use, all of it where there are none; holdout: share of the rows, the last ones, that is
    held out. Raises LogError.
    """
    time, table, warnings, unit = _table(log, signals, component)
    limits = list(cuts) or [(float(time[0]), float(time[-1]))]
    windows: list[LogWindow] = []
    for low, high in limits:
        rows = np.flatnonzero((time >= low) & (time <= high))
        if len(rows) < 2:
            span = f"{time[0]:g} to {time[-1]:g} s"
            raise LogError(f"{log.path} has {len(rows)} rows in the window {low:g} to {high:g} s; it has {span}.")
        parts = _unbroken(rows, time, table["input"], table["start"])
        if not parts:
            raise LogError(f"{log.path} has no two rows after one another that know all inputs and start values.")
        warnings += _told(log, parts, rows, bool(signals.start))
        for number, part in enumerate(parts if signals.start else parts[:1], start=1):
            name = log.path.name + (f", {low:g} to {high:g} s" if cuts else "")
            windows.append(
                LogWindow(
                    name if len(parts) == 1 else f"{name}, part {number}",
                    time[part],
                    float(time[0]),
                    table["input"][part],
                    table["measured"][part],
                    dict(zip(signals.start, table["start"][part[0]].tolist(), strict=True)),
                    table["start"][part],
                    len(part),
                    log.path,
                    unit,
                    number,
                )
            )
    for i, (variable, column) in enumerate(signals.measured.items()):
        if not any(np.isfinite(w.measured[:, i]).any() for w in windows):
            raise LogError(f"{log.path}: column '{column}', measured for {variable}, has no values there.")
    return _held_out(windows, holdout), warnings


def unused_columns(log: Log, signals: LogColumns) -> list[str]:
    """Return the columns of a log that have no role, nor are its time stamps."""
    roles = (*signals.inputs.values(), *signals.measured.values(), *signals.start.values())
    time = log.time_name(signals.time)
    used = {log.name_of(name) for name in (*roles, *([time] if time else []))}
    return [name for name in log.columns if name not in used]


def _table(log: Log, signals: LogColumns, component: Component) -> tuple[Vector, dict[str, Vector], list[str], str]:
    """Return increasing time stamps (n,) [s], columns (n, k) by role in the FMU's units, warnings, and the unit that
    the stamps were in. Raises LogError."""
    if signals.time is None:
        log = log.on_one_raster(signals.inputs.values(), [*signals.measured.values(), *signals.start.values()])
    stamps, warnings = _stamps(log, signals)
    time = _converted(stamps, understood("s"), f"{log.path}: time", understood)
    roles = {"input": signals.inputs, "measured": signals.measured, "start": signals.start}
    table = {role: _columns(log, columns, component, len(time)) for role, columns in roles.items()}
    known = np.isfinite(time)
    if n := np.count_nonzero(~known):
        warnings.append(f"{log.path}: {counted(int(n), 'row')} without a time stamp left out.")
        time, table = time[known], {role: values[known] for role, values in table.items()}
    if len(time) < 2:
        raise LogError(f"{log.path} must have two rows or more, got {len(time)}.")
    distance = np.diff(time)
    if np.any(distance < 0.0):
        i = int(np.argmax(distance < 0.0))
        raise LogError(
            f"{log.path}: time must not go back, as it does from {time[i]:g} to {time[i + 1]:g} s after row {i + 1}; "
            "make it two logs, or sort it."
        )
    if not np.any(distance > 0.0):
        raise LogError(f"{log.path}: time is {time[0]:g} s in all rows; give --time the column of time stamps.")
    last = np.append(distance > 0.0, True)
    if n := np.count_nonzero(~last):
        warnings.append(f"{log.path}: {n} repeated time stamps; of rows with the same one the last is used.")
        time, table = time[last], {role: values[last] for role, values in table.items()}
    return time, table, warnings, stamps.unit or "s"


def _stamps(log: Log, signals: LogColumns) -> tuple[Column, list[str]]:
    """Return the column of time stamps, in the unit that is stated, and warnings. Raises LogError."""
    stamps, unit = log.time_column(signals.time), signals.time_unit
    if unit is not None and stamps.is_date and unit != "s":
        raise LogError(f"{log.path}: time consists of dates, which are read in seconds; leave out --time-unit {unit}.")
    if unit is None and stamps.unit is None:
        _check_epoch(log, stamps)
    if unit is None:
        return stamps, []
    is_other = stamps.unit not in (None, unit) and not stamps.is_date
    text = f"{log.path}: its heading says that time is in {stamps.unit}; --time-unit {unit} is used."
    return replace(stamps, unit=unit), [text] if is_other else []


def _check_epoch(log: Log, stamps: Column) -> None:
    """Raise LogError where time stamps without a unit are too large for seconds, and a date in a smaller unit."""
    known = stamps.values[np.isfinite(stamps.values)]
    begin, distance = float(known[0]) + stamps.first if len(known) else 0.0, np.diff(known)
    for unit, n in _IN_A_SECOND.items():
        if _DATES[0] < begin / n < _DATES[1]:
            apart = f", its rows {float(np.median(distance)) / n:g} s apart" if len(distance) else ""
            raise LogError(
                f"{log.path}: time begins at {begin:.6g}: is it in {unit} since 1970{apart}? "
                f"Give --time-unit {unit}, or --time-unit s where it is in seconds."
            )


def _columns(log: Log, columns: Mapping[str, str], component: Component, n: int) -> Vector:
    """Return columns (n, k) in the units of the FMU's variables. Raises LogError."""

    def unit_of(name: str) -> Unit:
        return component.units.get(name) or understood(name)

    values = np.empty((n, len(columns)))
    for i, (variable, name) in enumerate(columns.items()):
        declared = component.unit(variable)
        if declared is not None and declared.exponents is None:
            declared = replace(understood(declared.name), name=declared.name)
        converted = _converted(log.column(name), declared, f"{log.path}: column '{name}' for {variable}", unit_of)
        if len(converted) != n:
            raise LogError(f"{log.path}: column '{name}' has {len(converted)} values, time has {n}.")
        values[:, i] = converted
        largest = float(np.max(np.abs(converted), where=~np.isnan(converted), initial=0.0))
        if largest > LARGEST:
            raise LogError(f"{log.path}: column '{name}' for {variable} has values up to {largest:.3g}: too large.")
    return values


def _converted(column: Column, target: Unit | None, what: str, unit_of: Callable[[str], Unit]) -> Vector:
    try:
        linear = conversion(unit_of(column.unit) if column.unit else None, target)
    except ValueError as e:
        raise LogError(f"{what}: {e}.") from e
    with np.errstate(over="ignore", invalid="ignore"):
        return linear.factor * column.values + linear.offset


def _unbroken(rows: NDArray[np.intp], time: Vector, inputs: Vector, start: Vector) -> list[NDArray[np.intp]]:
    """Return parts of the rows without a gap in the inputs, each beginning where the start values are known.

    A plant without inputs is simulated across every gap.
    """
    known = np.all(np.isfinite(inputs[rows]), axis=1)
    breaks = np.zeros(len(rows), dtype=bool)
    if inputs.shape[1]:
        distance = np.diff(time[rows])
        breaks[1:] = (distance > GAP * float(np.median(distance))) | (known[1:] != known[:-1])
    parts = [part for part in np.split(rows, np.flatnonzero(breaks)) if np.isfinite(inputs[part[0]]).all()]
    begins = [np.flatnonzero(np.isfinite(start[part]).all(axis=1)) for part in parts]
    trimmed = [part[begin[0] :] for part, begin in zip(parts, begins, strict=True) if len(begin)]
    return [part for part in trimmed if len(part) > 1]


def _told(log: Log, parts: Sequence[NDArray[np.intp]], rows: NDArray[np.intp], has_start: bool) -> list[str]:
    n_left_out = len(rows) - sum(len(part) for part in (parts if has_start else parts[:1]))
    warnings: list[str] = []
    if len(parts) > 1 and has_start:
        warnings.append(f"{log.path}: gaps split it into {len(parts)} windows; each starts from its own first row.")
    elif len(parts) > 1:
        warnings.append(
            f"{log.path}: gaps split it into {len(parts)} windows; only the first is used, since nothing says in which "
            "state the others start (--start VARIABLE=COLUMN)."
        )
    if n_left_out:
        warnings.append(f"{log.path}: {n_left_out} of {len(rows)} rows are left out, inputs or start being unknown.")
    return warnings


def _held_out(windows: Sequence[LogWindow], holdout: float) -> list[LogWindow]:
    """Return the windows with the last share of all their rows held out."""
    remaining = ceil((1.0 - holdout) * sum(len(w.time) for w in windows))
    shared: list[LogWindow] = []
    for window in windows:
        n_fit = min(remaining, len(window.time))
        remaining -= n_fit
        shared.append(replace(window, n_fit=n_fit if n_fit > 1 else 0))
    return shared
