"""A table of columns over time as a component: a CSV file that is played like an FMU's outputs, with no process.

    time [s], phi_ref [rad], phi_dot_ref [rad/s]
    0.0,      0.5,           0.0
    2.0,      1.0,           0.0

Values are interpolated linearly and held before the first and after the last row. A time that comes twice is a jump:
the later row holds from there on.
"""

import math
import re
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from fmpy.model_description import BaseUnit, DefaultExperiment, ModelDescription, ModelVariable, Unit, Unknown

from ..errors import ScenarioError, WiringError, one_line
from ..unit_text import understood
from ..units import BASE_UNITS
from .ports import Catalogue
from .types import Value

SUFFIX: Final = ".csv"
_HEADER: Final = re.compile(r"(?P<name>.+?)\s*(\[(?P<unit>[^\[\]]*)\])?")
_COMMA: Final = re.compile(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?")
_ROUNDING: Final = 1e-9  # of a macro step: t + h may fall short of the time of a jump by its last bit


@dataclass(frozen=True)
class TimeTable:
    """Columns over time."""

    times: tuple[float, ...]
    """Times [s] (n,), not decreasing."""
    rows: tuple[tuple[float, ...], ...]
    """Values (n, columns)."""
    units: Mapping[str, str | None]
    """Unit of each column, by its name, in the file's order."""

    def at(self, t: float, slack: float = 0.0) -> tuple[float, ...]:
        """Return the values at t [s]; a row that is less than slack [s] ahead counts as reached."""
        i = bisect_right(self.times, t + slack)
        if i in (0, len(self.times)):
            return self.rows[max(i - 1, 0)]
        before, after = self.times[i - 1], self.times[i]
        w = (max(t, before) - before) / (after - before)
        return tuple([a + w * (b - a) for a, b in zip(self.rows[i - 1], self.rows[i], strict=True)])


def is_table(path: Path) -> bool:
    """Return whether a component's file is a table, not an FMU."""
    return path.suffix.lower() == SUFFIX


def read_table(path: Path) -> TimeTable:
    """Read the table in a CSV file: a header, the first column `time [s]`, finite numbers.

    Commas, semicolons or tabs separate; empty lines and those that begin with # are passed over.
    Raises ScenarioError, one line with file and line number.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as e:
        reason = e.strerror if isinstance(e, OSError) else "it is not UTF-8"
        raise ScenarioError(f"{path} cannot be read: {reason}.") from e
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    if len(numbered) < 2:
        raise ScenarioError(f"{path} must have a header and at least one row.")
    separator = max(",;\t", key=numbered[0][1].count)
    header, *body = ([cell.strip().strip('"') for cell in line.split(separator)] for _, line in numbered)
    units = _units(header, path)
    rows: list[tuple[float, ...]] = []
    for (line, _), cells in zip(numbered[1:], body, strict=True):
        rows.append(_row(cells, header, f"{path}, line {line}"))
        if len(rows) > 1 and rows[-1][0] < rows[-2][0]:
            raise ScenarioError(f"{path}, line {line}: time must not go back, got {rows[-1][0]:g} s.")
    return TimeTable(tuple([row[0] for row in rows]), tuple([row[1:] for row in rows]), units)


def _units(header: Sequence[str], path: Path) -> dict[str, str | None]:
    """Return the unit of each column but the first. Raises ScenarioError."""
    columns = [_HEADER.fullmatch(cell) for cell in header]
    parts = [(m["name"], (m["unit"] or "").strip() or None) if m else ("", None) for m in columns]
    name, unit = parts[0]
    if name.lower() not in ("time", "t") or unit not in ("s", None):
        raise ScenarioError(f"{path}: the first column must be 'time [s]', got '{one_line(header[0])}'.")
    names = [name for name, _ in parts[1:]]
    if not names:
        raise ScenarioError(f"{path}: there is no column beside the time.")
    if not all(names) or len(set(names)) < len(names):
        raise ScenarioError(f"{path}: every column after the time must have a name of its own, got {', '.join(names)}.")
    return dict(parts[1:])


def _row(cells: Sequence[str], header: Sequence[str], place: str) -> tuple[float, ...]:
    if len(cells) != len(header):
        raise ScenarioError(f"{place}: must have {len(header)} numbers, got {len(cells)}.")
    values: list[float] = []
    for cell, column in zip(cells, header, strict=True):
        where = f"{place}, column '{one_line(column)}'"
        try:
            values.append(float("" if "_" in cell else cell))  # 1_0 is a number in Python, and a slip here
        except ValueError as e:
            comma = "; numbers have a decimal point" if _COMMA.fullmatch(cell.strip()) else ""
            raise ScenarioError(f"{where}: must be a number, got '{one_line(cell)}'{comma}.") from e
        if not math.isfinite(values[-1]):
            raise ScenarioError(f"{where}: every number must be finite, got {one_line(cell)}.")
    return tuple(values)


def describe(path: Path, table: TimeTable) -> ModelDescription:
    """Return the model description that an FMU with these outputs would have."""
    variables = [
        ModelVariable(
            name, i, "Real", causality="output", variability="continuous", initial="exact", unit=unit,
            start=repr(table.rows[0][i]),
        ) for i, (name, unit) in enumerate(table.units.items())
    ]  # fmt: skip
    description = ModelDescription("2.0", path.stem)
    description.unitDefinitions = [_defined(unit) for unit in dict.fromkeys(table.units.values()) if unit]
    description.modelVariables = variables
    description.outputs = [Unknown(variable=v, dependencies=[]) for v in variables]
    description.defaultExperiment = DefaultExperiment(repr(table.times[0]), repr(table.times[-1]))
    return description


def _defined(text: str) -> Unit:
    """Return a column's unit as a model description has it; undefined where it is not understood."""
    unit = understood(text)
    if unit.exponents is None:
        return Unit(text)
    exponents = dict(zip(BASE_UNITS, unit.exponents, strict=True))
    return Unit(text, BaseUnit(**exponents, factor=unit.factor, offset=unit.offset))


class TableSlave:
    """A table in a co-simulation, with the methods of a Slave that the master calls."""

    def __init__(self, path: Path, instance_name: str) -> None:
        """Raises ScenarioError."""
        self.name = instance_name
        self._table = read_table(path)
        self.description = describe(path, self._table)
        self._catalogue = Catalogue(path.name, self.description.modelVariables)
        self._bound: tuple[int, ...] = ()
        self._time = self._slack = 0.0

    def bind(self, inputs: Sequence[str] = (), tunables: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
        """Say which columns are got. Raises WiringError; a table has neither inputs nor parameters."""
        self._catalogue.ports("input", inputs)
        self._catalogue.ports("tunable parameter", tunables)
        self._bound = tuple([v.reference for v in self._catalogue.ports("output", outputs).variables])

    def initialize(self, start: Mapping[str, Value], start_time: float = 0.0, stop_time: float | None = None) -> None:
        """Go to start_time [s]. Raises WiringError for start values: there are none to set."""
        if start:
            raise WiringError(f"{self.name}: a table takes no start values.")
        self._time = start_time

    enter_initialization = initialize

    def propagate(self, inputs: Sequence[float] | None) -> tuple[float, ...]:
        """Return the bound columns: see get."""
        return self.get()

    def exit_initialization(self) -> None:
        """Do nothing: a table has no such mode, and nothing to free."""

    def get(self) -> tuple[float, ...]:
        """Return the bound columns at the present communication point."""
        values = self._table.at(self._time, self._slack)
        return tuple([values[i] for i in self._bound])

    def begin_step(self, inputs: Sequence[float], t: float, h: float, tunables: Sequence[float] | None = None) -> None:
        """Go from t to t + h [s]."""
        self._time, self._slack = t + h, _ROUNDING * h

    def end_step(self) -> tuple[float, ...]:
        """Return the bound columns: see get."""
        return self.get()

    def to_checkpoint(self) -> tuple[float, float]:
        """Return the present time; its rows are in its file."""
        return self._time, self._slack

    def from_checkpoint(self, saved: tuple[float, float]) -> None:
        """Go back to a checkpoint's time."""
        self._time, self._slack = saved

    def close(self) -> None:
        """Do nothing: a table has no such mode, and nothing to free."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
