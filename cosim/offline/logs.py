"""Reading of measured data from files: CSV, Parquet, MAT and MDF4. Nothing is interpolated."""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet

from estimator.space import Vector

from ..errors import CosimError, one_line
from ..files import readable
from ..names import did_you_mean

_HEADING: Final = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*)\]")
_TIMES: Final = ("time", "t", "timestamp", "time_s")
_COMMA: Final = re.compile(rb"[\n;][ \t]*[-+]?\d*,\d+(?:[eE][-+]?\d+)?[ \t]*(?:[;\r\n]|\Z)")
"""A cell that is a number with a decimal comma."""
_NOT_IN_CP1252: Final = (0x81, 0x8D, 0x8F, 0x90, 0x9D)
_NEVER: Final = -(2**63)
_EXACT: Final = 2**53
"""Largest whole number up to which a float holds each."""
_SPREADSHEETS: Final = (".xlsx", ".xlsm", ".xls", ".ods")
_MISSING: Final = ["", "nan", "NaN", "NAN", "-nan", "null", "NULL", "NA", "N/A", "#N/A", "None", "-"]


class LogError(CosimError):
    """Error for a log that cannot be read, or lacks the data asked for."""


@dataclass(frozen=True)
class Column:
    """One channel of a log."""

    values: Vector
    """Values (n,); NaN where there is none."""
    unit: str | None = None
    """Unit, as the log names it."""
    text: str | None = None
    """The first cell that is no number; the column has no values then."""
    time: Vector | None = None
    """Its own time stamps (n,) [s], in a log of several rasters."""
    first: int = 0
    """Whole number that the values are counted from: nanoseconds since 1970 are too large for a float."""
    is_date: bool = False
    """Whether the values are dates, counted from the first one."""
    text_row: int | None = None
    """Row of the first cell that is no number, from 1 below the header, where it is known."""
    is_text_alone: bool = False
    """Whether all cells after it are numbers."""


@dataclass(frozen=True)
class Log:
    """A file of measurements."""

    path: Path
    columns: Mapping[str, Column]
    """Columns by name, without the unit."""

    def name_of(self, name: str) -> str:
        """Return the name of the column called so, with or without its unit. Raises LogError where there is none."""
        heading = None if name in self.columns else _HEADING.fullmatch(name)
        found = heading["name"] if heading else name
        if found not in self.columns:
            known = ", ".join(self.columns) if len(self.columns) <= 12 else f"{len(self.columns)} others"
            raise LogError(
                f"{self.path} has no column '{name}'{did_you_mean(name, self.columns) or f', only {known}.'}"
            )
        return found

    def column(self, name: str) -> Column:
        """Return the column of that name, with or without its unit. Raises LogError where there is none of numbers."""
        found = self._numbers(name)
        return replace(found, values=found.values + found.first, first=0) if found.first else found

    def _numbers(self, name: str) -> Column:
        found = self.columns[self.name_of(name)]
        if found.text is not None:
            text = one_line(found.text)
            where = f" in row {found.text_row} below the header" if found.text_row is not None else ""
            told = f"{self.path}: column '{name}' must hold numbers, got '{text}'{where}"
            if found.text_row == 1 and found.is_text_alone:
                told += f"; if that row has units, leave it out, and name the column '{self.name_of(name)} [{text}]'"
            raise LogError(f"{told}.")
        return found

    def on_one_raster(self, held: Iterable[str], others: Iterable[str]) -> "Log":
        """Return the log with these columns at the time stamps of all of them; a log of one raster stays as it is.

        held: columns that keep each value until the next, as an input does; the others are NaN between their values.
        Raises LogError.
        """
        found = {name: self.column(name) for name in (*held, *others)}
        if any(column.time is None for column in found.values()):
            return self
        rasters = {name: column.time for name, column in found.items() if column.time is not None}
        time = np.unique(np.concatenate(list(rasters.values())))
        table = {_TIMES[0]: Column(time, "s")}
        for name, column in found.items():
            last = np.searchsorted(rasters[name], time, side="right") - 1
            known = last >= 0 if name in held else (last >= 0) & (np.append(rasters[name], np.nan)[last] == time)
            table[name] = Column(np.where(known, np.append(column.values, np.nan)[last], np.nan), column.unit)
        return Log(self.path, table)

    def time_name(self, name: str | None) -> str | None:
        """Return the name of the column of time stamps: the one asked for, or else the one called time or t, if any."""
        if name is not None:
            return name
        return next((c for usual in _TIMES for c in self.columns if c.strip().casefold() == usual), None)

    def time_column(self, name: str | None) -> Column:
        """Return the column of time stamps, the one named, or else the one called time or t. Raises LogError.

        Whole numbers beyond 2^53 are counted from `Column.first`.
        """
        if (found := self.time_name(name)) is None:
            raise LogError(f"{self.path} has no column 'time' or 't'; give --time COLUMN.")
        return self._numbers(found)


def read_log(path: Path) -> Log:
    """Read the log in a .csv, .txt, .tsv, .parquet, .mat, .mf4 or .mdf file. Raises LogError."""
    readers = {".parquet": _read_parquet, ".pq": _read_parquet, ".mat": _read_mat}
    try:
        readable(path)
        if path.suffix.lower() in _SPREADSHEETS:
            raise LogError(f"{path} is a spreadsheet; export it as CSV.")
        if path.suffix.lower() in (".mf4", ".mdf"):
            return Log(path, _read_mdf(path))
        headings, columns = readers.get(path.suffix.lower(), _read_csv)(path)
    except OSError as e:
        raise LogError(f"{path} cannot be read: {one_line(e.strerror or str(e))}.") from e
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as e:
        raise LogError(f"{path} cannot be read: {one_line(str(e))}") from e
    named = [m.group("name", "unit") if (m := _HEADING.fullmatch(h.strip())) else (h.strip(), None) for h in headings]
    names = [name for name, _ in named]
    repeated = next((name for name in names if names.count(name) > 1), None)
    if repeated is not None:
        raise LogError(f"{path} has two columns '{repeated}'; rename one.")
    table = {
        name: values if isinstance(values, Column) else _column(values, unit)
        for (name, unit), values in zip(named, columns, strict=True)
    }
    return Log(path, table)


def _read_csv(path: Path) -> tuple[Sequence[str], Sequence[Any]]:
    content = path.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):  # "Unicode text" of spreadsheets
        content = content.decode("utf-16", "replace").encode()
    encoding = "utf-8-sig"
    try:
        start = content[:100_000].decode(encoding, "ignore").splitlines()
        content.decode(encoding)
    except UnicodeDecodeError:  # spreadsheets of Western Europe
        encoding = "latin-1" if any(byte in content for byte in _NOT_IN_CP1252) else "cp1252"
        start = content[:100_000].decode(encoding).splitlines()
    if not start or b"\0" in content[:1000]:
        raise LogError(f"{path} is {'no text file' if start else 'empty'}; a log is CSV, Parquet, MAT or MDF4.")
    delimiter = max(",;\t", key=start[0].count)
    heading = next(csv.reader(start, delimiter=delimiter))
    if all(_is_number(cell) for cell in heading):
        raise LogError(f"{path} must begin with a header that names its columns, got '{one_line(start[0])}'.")
    is_decimal_comma = delimiter == ";" and _COMMA.search(content) is not None
    table = pyarrow.csv.read_csv(
        pa.py_buffer(content),
        pyarrow.csv.ReadOptions(encoding="utf8" if encoding == "utf-8-sig" else encoding, use_threads=False),
        pyarrow.csv.ParseOptions(delimiter=delimiter),
        pyarrow.csv.ConvertOptions(null_values=_MISSING, decimal_point="," if is_decimal_comma else "."),
    )
    found = zip(table.column_names, table.columns, strict=True)
    used = [(name, column) for name, column in found if name.strip() or not pa.types.is_null(column.type)]
    return [name for name, _ in used], [column for _, column in used]


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _is_plain_number(cell: str) -> bool:
    """Return whether a cell is a number as a log has it: neither 1_000 nor 1,000."""
    return _is_number(cell) and "_" not in cell and "," not in cell


def _read_parquet(path: Path) -> tuple[Sequence[str], Sequence[Any]]:
    table = pyarrow.parquet.ParquetFile(path).read()
    return table.column_names, table.columns


def _column(column: Any, unit: str | None) -> Column:
    """Convert an Arrow column to numbers, dates to seconds since the first. Not by to_numpy, which imports pandas."""
    kind = column.type
    if pa.types.is_null(kind):
        return Column(np.full(len(column), np.nan), unit)
    if pa.types.is_timestamp(kind):
        try:
            count = pc.cast(pc.cast(column, pa.timestamp("ns", tz=kind.tz)), pa.int64())
        except pa.ArrowInvalid:
            return Column(np.empty(0), "s", "a date that is not within 1678 to 2261")
        values = _array(pc.fill_null(count, _NEVER))
        known = values != _NEVER
        if not known.any():
            return Column(np.full(len(values), np.nan), "s")
        return Column(np.where(known, (values - values[known][0]) / 1e9, np.nan), "s", is_date=True)
    if pa.types.is_boolean(kind):
        column, kind = pc.cast(column, pa.int8()), pa.int8()
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
        cells = [(row, str(cell)) for row, cell in enumerate(column.to_pylist(), start=1) if cell is not None]
        texts = ((row, cell) for row, cell in cells if cell not in _MISSING and not _is_plain_number(cell))
        own = cells[0] if cells else (None, str(kind))  # a number in another form than those of other columns
        row, text = next(texts, own)
        return Column(np.empty(0), unit, text, text_row=row, is_text_alone=next(texts, None) is None)
    first = _first(column) if kind in (pa.int64(), pa.uint64()) else 0
    if first:
        counts = [pc.cast(column, pa.int64(), safe=False), pa.scalar(first, pa.int64())]
        column = pc.call_function("subtract", counts)  # pc.subtract has no type
    return Column(_array(pc.fill_null(pc.cast(column, pa.float64(), safe=False), float("nan"))), unit, first=first)


def _first(column: Any) -> int:
    """Return the first whole number of a column if a float cannot hold it exactly, else 0."""
    first = next((cell.as_py() for chunk in column.chunks for cell in chunk if cell.is_valid), 0)
    return first if _EXACT < abs(first) < 2**63 else 0


def _array(column: Any) -> Any:
    """Return a chunked Arrow column without nulls as one NumPy array."""
    chunks: list[Any] = [np.from_dlpack(chunk) for chunk in column.chunks]
    return np.concatenate(chunks) if chunks else np.empty(0)


def _read_mat(path: Path) -> tuple[Sequence[str], Sequence[Any]]:
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except NotImplementedError as e:
        raise LogError(f"{path} is a MAT file of version 7.3; save it with -v7.") from e
    except OSError:
        raise
    except Exception as e:  # of a damaged file any: IndexError, zlib.error
        raise LogError(f"{path} is no MAT file: {one_line(str(e))}.") from e
    arrays = _flat({name: value for name, value in content.items() if not name.startswith("__")})
    return list(arrays), [Column(values) for values in arrays.values()]


def _flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Vector]:
    """Return vectors by name, those in structs as `struct.field`, columns of a matrix as `x(1)`, `x(2)`, ..."""
    found: dict[str, Vector] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub" and value.ndim in (1, 2):
            columns = value[:, None] if value.ndim == 1 else value
            for i, column in enumerate(columns.T.astype(float), start=1):
                found[f"{prefix}{name}" if value.ndim == 1 else f"{prefix}{name}({i})"] = column
    return found


class _Channels(Mapping[str, Column]):
    """The channels of an MDF file's groups, each read when it is asked for: there may be thousands.

    A name that several groups have is followed by `@` and the group's number, from 0.
    """

    def __init__(self, path: Path, open_mdf: Any) -> None:
        self._path, self._open, self._read = path, open_mdf, dict[str, Column]()
        with open_mdf(path) as file:
            groups: list[list[str]] = [[channel.name for channel in group.channels] for group in file.groups]
            masters: Mapping[int, int] = dict(file.masters_db)
        found = [(name, i, k) for i, names in enumerate(groups) for k, name in enumerate(names) if k != masters.get(i)]
        counts = Counter(name for name, _, _ in found)
        self._places = {name if counts[name] == 1 else f"{name}@{i}": (i, k) for name, i, k in found}

    def __getitem__(self, name: str) -> Column:
        if name not in self._read:
            group, index = self._places[name]
            try:
                with self._open(self._path) as file:
                    self._read[name] = _channel(file.get(group=group, index=index))
            except Exception as e:  # as on opening a damaged file
                raise LogError(f"{self._path}: channel '{name}' cannot be read: {one_line(str(e))}.") from e
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)


def _read_mdf(path: Path) -> Mapping[str, Column]:
    try:
        from asammdf import MDF  # pyright: ignore[reportMissingImports]  optional
    except ImportError as e:
        raise LogError(f"{path} is an MDF file: pip install 'fmu-retune[mdf]' reads it.") from e
    try:
        channels = _Channels(path, MDF)
    except OSError:
        raise
    except Exception as e:  # of a damaged file any: ValueError, MdfException
        raise LogError(f"{path} is no MDF file: {one_line(str(e))}.") from e
    if not channels:
        raise LogError(f"{path} has no channels.")
    return channels


def _channel(signal: Any) -> Column:
    time = np.asarray(signal.timestamps, dtype=float)
    if signal.samples.dtype.kind in "fiub" and signal.samples.ndim == 1:
        return Column(signal.samples.astype(float), signal.unit or None, time=time)
    return Column(np.empty(0), signal.unit or None, f"{signal.samples.ravel()[:1].tolist()}", time)
