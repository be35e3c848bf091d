"""The table of a study's results: a row a run, in a Parquet file."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from ..errors import FolderError
from ..files import replaced
from .ledger import Ledger, LedgerEntry

RESULTS: Final = "results.parquet"
"""File name, in the folder of the study."""
_ROWS_AT_A_TIME: Final = 20_000


def write_results(folder: Path, ledger: Ledger) -> Path:
    """Write the table of all runs, those without a result included; return its file. Raises FolderError."""
    path, schema = folder / RESULTS, _schema(ledger)
    with replaced(path) as file, pq.ParquetWriter(file, schema) as writer:
        for rows in _batches(ledger):
            columns = [pa.array([_as(field.type, row.get(field.name)) for row in rows], field.type) for field in schema]
            writer.write_table(pa.table(columns, schema=schema))
    return path


def read_results(folder: Path) -> Any:
    """Return the table of a study's folder, as Arrow has it. Raises FolderError."""
    try:
        return pq.read_table(folder / RESULTS)
    except (OSError, pa.ArrowInvalid) as e:
        raise FolderError(f"{folder} has no readable {RESULTS}: {e}.") from e


def _row(entry: LedgerEntry) -> dict[str, Any]:
    status = entry.result.get("status") or entry.state
    return {**entry.point, **entry.result, "status": status, "error": entry.result.get("error") or entry.why,
            "key": entry.key}  # fmt: skip


def _batches(ledger: Ledger) -> Iterator[list[dict[str, Any]]]:
    rows: list[dict[str, Any]] = []
    for entry in ledger.entries():
        rows.append(_row(entry))
        if len(rows) == _ROWS_AT_A_TIME:
            yield rows
            rows = []
    if rows:
        yield rows


def _schema(ledger: Ledger) -> Any:
    """Return the columns that any row has, and the type that fits all of their values."""
    found: dict[str, set[type]] = {}
    for entry in ledger.entries():
        for name, value in _row(entry).items():
            kinds = found.setdefault(name, set())
            if value is not None:
                kinds.add(type(value))
    return pa.schema([(name, _type_of(name, kinds)) for name, kinds in found.items()])


def _type_of(name: str, kinds: set[type]) -> Any:
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    if (kinds and kinds <= {int, float}) or (not kinds and name != "error"):
        return pa.float64()
    return pa.string()


def _as(kind: Any, value: Any) -> Any:
    if value is None or not pa.types.is_string(kind) or isinstance(value, str):
        return value
    return json.dumps(value)


def columns_of(table: Any, names: Sequence[str]) -> dict[str, Any]:
    """Return columns of a table as NumPy arrays, missing numbers as NaN."""
    return {name: table[name].to_numpy(zero_copy_only=False) for name in names}
