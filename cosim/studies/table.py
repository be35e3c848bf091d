"""The table of a study's results: a row a run, in a Parquet file."""

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
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
    path, kinds = folder / RESULTS, dict[str, set[type]]()
    batches = [_batch(rows, kinds) for rows in _rows(ledger)]
    schema = pa.schema([(name, _type_of(name, found)) for name, found in kinds.items()])
    with replaced(path) as file, pq.ParquetWriter(file, schema) as writer:
        for n, columns in batches:
            arrays = [
                columns[field.name].cast(field.type) if field.name in columns else pa.nulls(n, field.type)
                for field in schema
            ]
            writer.write_table(pa.table(arrays, schema=schema))
    return path


def read_results(folder: Path) -> Any:
    """Return the table of a study's folder, as Arrow has it. Raises FolderError."""
    try:
        return pq.read_table(folder / RESULTS)
    except (OSError, pa.ArrowInvalid) as e:
        raise FolderError(f"{folder} has no readable {RESULTS}: {e}.") from e


def row_in_table(entry: LedgerEntry) -> dict[str, Any]:
    """Return a run's row: factors and figures, or how far it is."""
    status = entry.result.get("status") or entry.state
    return {**entry.point, **entry.result, "status": status, "error": entry.result.get("error") or entry.why,
            "key": entry.key}  # fmt: skip


def _rows(ledger: Ledger) -> Iterator[list[dict[str, Any]]]:
    entries = ledger.entries()
    while rows := [row_in_table(entry) for entry in islice(entries, _ROWS_AT_A_TIME)]:
        yield rows


def _batch(rows: Sequence[Mapping[str, Any]], all_kinds: dict[str, set[type]]) -> tuple[int, dict[str, Any]]:
    """Return the number of rows and their columns as Arrow has them; add the types of their values to all_kinds."""
    columns: dict[str, Any] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        kinds = {_kind_of(value) for value in values if value is not None}
        all_kinds.setdefault(name, set()).update(kinds)
        kind = _type_of(name, kinds)
        if pa.types.is_string(kind):
            values = [value if value is None or isinstance(value, str) else json.dumps(value) for value in values]
        columns[name] = pa.array(values, kind)
    return len(rows), columns


def _kind_of(value: Any) -> type:
    """Return the type of a value; an integer of more than 64 bits, for which Arrow has no type, is a text."""
    return str if type(value) is int and not -(2**63) <= value < 2**63 else type(value)


def _type_of(name: str, kinds: set[type]) -> Any:
    if kinds == {bool}:
        return pa.bool_()
    if kinds == {int}:
        return pa.int64()
    if (kinds and kinds <= {int, float}) or (not kinds and name != "error"):
        return pa.float64()
    return pa.string()
