"""Run folders: what happened, readable whenever the writing stops."""

import csv
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa

from .errors import CosimError

ROWS_PER_BATCH = 50
SERIES, EVENTS, MANIFEST, RESULT = "series.arrow", "events.jsonl", "manifest.json", "result.json"
ESTIMATES = "estimates.ssv"
LATENCIES = "latencies.json"
"""Wall time of each evaluation [s], a list a macro step that had any: no two runs agree in them."""


class FolderError(CosimError):
    """A run folder cannot be made, written or read."""


def new_run_folder(scenario: str, out: Path | None) -> Path:
    """Make the run folder: `out`, which must be absent or empty, or the next free runs/SCENARIO-n.

    Raises FolderError.
    """
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            if any(out.iterdir()):
                raise FolderError(f"{out} is not empty; give --out a new or empty folder.")
            return out
        for n in range(1, 1_000_000):
            folder = Path("runs") / f"{scenario}-{n}"
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            return folder
    except OSError as e:
        raise FolderError(f"cannot make the run folder {out or 'runs'}: {e.strerror or e}.") from e
    raise FolderError("runs/ holds a million runs of this scenario.")


class Recorder:
    """Writes one run: rows to an Arrow IPC stream, events to JSON lines. Without a folder it only remembers rows."""

    def __init__(self, folder: Path | None, columns: Sequence[str]) -> None:
        self.columns = tuple(columns)
        self._rows: list[tuple[float, ...]] = []
        self._n_written = 0
        self._schema = pa.schema([(name, pa.float64()) for name in columns])
        self._events: IO[str] | None = None
        self._writer: Any = None
        if folder is not None:
            try:
                self._file = open(folder / SERIES, "wb")  # noqa: SIM115  closed in close
                self._events = open(folder / EVENTS, "w", encoding="utf-8")  # noqa: SIM115
                self._writer = pa.ipc.new_stream(self._file, self._schema)
            except OSError as e:
                raise FolderError(f"cannot write in {folder}: {e.strerror or e}.") from e

    def row(self, values: Sequence[float]) -> None:
        """Take the values of one communication point, in the order of the columns."""
        self._rows.append(tuple(values))
        if len(self._rows) - self._n_written >= ROWS_PER_BATCH:
            self.flush()

    def event(self, t: float, kind: str, detail: Mapping[str, Any]) -> None:
        """Write one event."""
        if self._events is not None:
            self._events.write(to_json({"t": t, "kind": kind, **detail}) + "\n")

    def flush(self) -> None:
        """Hand everything so far to the operating system."""
        pending = self._rows[self._n_written :]
        self._n_written = len(self._rows)
        if self._writer is not None and self._events is not None:
            if pending:
                table = np.array(pending).T
                self._writer.write_batch(pa.record_batch([pa.array(c) for c in table], schema=self._schema))
            self._file.flush()
            self._events.flush()

    def close(self) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        """End the files; the recorded series by column."""
        self.flush()
        if self._writer is not None and self._events is not None:
            self._writer.close()
            self._file.close()
            self._events.close()
            self._writer = self._events = None
        table = np.array(self._rows).T if self._rows else np.empty((len(self.columns), 0))
        return dict(zip(self.columns, table, strict=True))


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a whole JSON file at once or not at all."""
    write_text(path, to_json(content, indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a whole text file at once or not at all. Raises FolderError."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file at once or not at all: temporary file, fsync, rename. Raises FolderError."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
        try:
            with open(handle, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as e:
        raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e


def write_csv(path: Path, series: Mapping[str, Sequence[float] | np.ndarray[Any, Any]]) -> None:
    """The series as CSV, every digit kept."""
    try:
        with open(path, "w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(series)
            writer.writerows(zip(*(np.asarray(c).tolist() for c in series.values()), strict=True))
    except OSError as e:
        raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e


def read_series(folder: Path) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """The recorded series of a run folder, also of a run that was killed: as far as it was written.

    Raises FolderError where there is none.
    """
    batches: list[Any] = []
    try:
        with open(folder / SERIES, "rb") as file:
            reader = pa.ipc.open_stream(file)
            batches.extend(_readable(reader))
    except (OSError, pa.ArrowInvalid) as e:
        raise FolderError(f"{folder} has no readable {SERIES}: {e}.") from e
    table = pa.Table.from_batches(batches, reader.schema)
    return {name: table[name].to_numpy() for name in table.column_names}


def _readable(reader: Any) -> Iterator[Any]:
    """Batches up to where the writing stopped."""
    while True:
        try:
            yield reader.read_next_batch()
        except (StopIteration, pa.ArrowInvalid, OSError):
            return


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def to_json(value: object, indent: int | None = None) -> str:
    """JSON with null for what is not finite."""
    return json.dumps(_jsonable(value), indent=indent, allow_nan=False)


def _jsonable(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(v) for v in value]
    if isinstance(value, np.generic | np.ndarray):
        return _jsonable(value.tolist())
    return value
