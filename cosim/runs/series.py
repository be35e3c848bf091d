"""Recorded series: reading from Arrow as far as they were written, and writing as CSV."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from ..errors import FolderError
from ..files import readable, replaced
from .run_files import SERIES


def write_csv(path: Path, series: Mapping[str, Sequence[float] | np.ndarray[Any, Any]]) -> None:
    """Write the series as CSV, with all digits, at once or not at all. Raises FolderError."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(series)
    rows = pa.RecordBatch.from_arrays([arrow_array(c) for c in series.values()], names=list(series))
    with replaced(path) as file:
        file.write(header.getvalue().encode())
        arrow_csv.write_csv(rows, file, arrow_csv.WriteOptions(include_header=False))


def read_series(folder: Path) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """Return the recorded series of a run folder; of a run that was killed, as far as they were written.

    Raises FolderError where there is none.
    """
    batches: list[Any] = []
    try:
        with open(readable(folder / SERIES), "rb") as file:
            reader = pa.ipc.open_stream(file)
            batches.extend(_readable(reader))
    except (OSError, pa.ArrowInvalid) as e:
        reason = e.strerror if isinstance(e, OSError) and e.strerror else e
        raise FolderError(f"{folder} has no readable {SERIES}: {reason}.") from e
    table = pa.Table.from_batches(batches, reader.schema)
    return {name: _column(table[name].chunks) for name in table.column_names}


def arrow_array(column: Sequence[float] | np.ndarray[Any, Any]) -> Any:
    """Return the column as an Arrow array; pa.array would import pandas, 0.25 s, to check for its types."""
    values = np.ascontiguousarray(column, dtype=np.float64)
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def _column(chunks: Sequence[Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    parts = [np.from_dlpack(chunk) for chunk in chunks]  # to_numpy imports pandas too
    return np.concatenate(parts, dtype=np.float64) if parts else np.empty(0)


def _readable(reader: Any) -> Iterator[Any]:
    """Yield the batches up to where the writing stopped."""
    while True:
        try:
            yield reader.read_next_batch()
        except (StopIteration, pa.ArrowInvalid, OSError):
            return
