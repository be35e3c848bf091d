"""Run folders: what happened, readable whenever the writing stops."""

import csv
import hashlib
import io
import json
import math
import os
import re
import signal
import sys
import tempfile
import threading
from array import array
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
import pyarrow as pa
from pyarrow import csv as arrow_csv

from ..errors import CosimError, UnfinishedError
from ..files import readable
from .growing import GrowingFile, Prefix

ROWS_PER_BATCH = 50
SERIES, EVENTS, MANIFEST, RESULT = "series.arrow", "events.jsonl", "manifest.json", "result.json"
ESTIMATES, CSV = "estimates.ssv", "series.csv"
CHECKPOINT, LOCK = "checkpoint.bin", "lock"
LATENCIES = "latencies.json"
"""Wall time of each evaluation [s], a list a macro step that had any: no two runs agree in them."""
_OWNER: Final = re.compile(rb"(process \d+ on [^\n]*)?")
_LONGEST_OWNER: Final = 1000


class FolderError(CosimError):
    """A run folder cannot be made, written or read."""


def new_run_folder(scenario: str, out: Path | None) -> Path:
    """Make the run folder: `out`, which must be absent or empty, or the next free runs/SCENARIO-n.

    What a command that was killed before it had written anything leaves is nothing: its lock, and empty folders beside
    it. Whether that is a living command's, `locked` says. Raises FolderError.
    """
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            if not _is_empty(out):
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


def _is_empty(folder: Path) -> bool:
    others = [path for path in folder.iterdir() if path.name != LOCK]
    if not (folder / LOCK).is_symlink() and not (folder / LOCK).exists():
        return not others
    return is_lock(folder / LOCK) and all(p.is_dir() and not p.is_symlink() and not any(p.iterdir()) for p in others)


def is_lock(path: Path) -> bool:
    """Whether this is a lock file, and not something of the user's of that name. Raises OSError."""
    if path.is_symlink() or not path.is_file():
        return False
    with open(path, "rb") as file:
        return _OWNER.fullmatch(file.read(_LONGEST_OWNER)) is not None


@dataclass(frozen=True)
class Place:
    """How far a record goes."""

    series: Prefix
    """Of the series' file."""
    events: Prefix
    """Of the events'."""


class Recorder:
    """Writes one run: rows to an Arrow IPC stream, events to JSON lines. Without a folder it only remembers rows.

    With one it remembers only those that are not written yet: an hour of a quadrotor at 100 Hz is 230 MB.
    Its methods raise UnfinishedError where the disk is full; what is written already stays whole.
    """

    def __init__(self, folder: Path | None, columns: Sequence[str], place: Place | None = None) -> None:
        """place: go on with an old record from there; what comes after it is cut off.

        Raises FolderError where there is a record already, or another than that, or the folder cannot be written.
        """
        self.columns = tuple(columns)
        self._folder = folder
        self._values = array("d")  # of the rows held, one after the other
        self._lines: list[str] = []  # events held
        self._room = ROWS_PER_BATCH * len(self.columns) if folder is not None else math.inf
        self._schema = pa.schema([(name, pa.float64()) for name in columns])
        self._series: GrowingFile | None = None
        self._events: GrowingFile | None = None
        if folder is None:
            return
        try:
            self._series = GrowingFile(folder / SERIES, place and place.series)
            self._events = GrowingFile(folder / EVENTS, place and place.events)
            if place is None or not place.series.size:
                self._series.append(self._schema.serialize())
        except ValueError as e:
            self.release()
            raise FolderError(f"{folder} is damaged: {e}.") from e
        except OSError as e:
            self.release()
            raise FolderError(f"cannot write in {folder}: {e.strerror or e}.") from e

    def row(self, values: Sequence[float]) -> None:
        """Take the values of one communication point, in the order of the columns."""
        self._values.extend(values)
        if len(self._values) >= self._room:
            self.flush()

    def event(self, t: float, kind: str, detail: Mapping[str, Any]) -> None:
        """Take one event."""
        if self._events is not None:
            self._lines.append(to_json({"t": t, "kind": kind, **detail}) + "\n")

    def flush(self) -> None:
        """Hand everything so far to the operating system."""
        if self._series is None or self._events is None:
            return
        with uninterrupted(), recording(self._folder):
            if self._values:
                columns = [_array(column) for column in self._table()]
                self._series.append(pa.record_batch(columns, schema=self._schema).serialize())
                self._values = array("d")
            if self._lines:
                self._events.append("".join(self._lines).encode())
                self._lines = []

    def place(self) -> Place:
        """How far the record goes, once all of it is on the disk. Raises ValueError without a folder."""
        if self._series is None or self._events is None:
            raise ValueError("a record without a folder has no place.")
        self.flush()
        with recording(self._folder):
            return Place(self._series.sync(), self._events.sync())

    def close(self) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        """End the files; the recorded series by column."""
        self.flush()
        if self._folder is None or self._series is None:
            return dict(zip(self.columns, self._table(), strict=True))
        with recording(self._folder):
            self._series.append(_END_OF_STREAM)
        self.release()
        return read_series(self._folder)

    def release(self) -> None:
        """Give the files back as they are; idempotent."""
        for file in (self._series, self._events):
            if file is not None:
                file.close()

    def _table(self) -> np.ndarray[Any, np.dtype[np.float64]]:
        """The rows held, as contiguous columns."""
        return np.ascontiguousarray(np.array(self._values).reshape(-1, len(self.columns)).T)


_END_OF_STREAM: Final = b"\xff\xff\xff\xff\0\0\0\0"
"""Arrow columnar format, section "IPC streaming format": a continuation marker and no message."""


@contextmanager
def recording(folder: Path | None) -> Generator[None]:
    """Tell in one line what the disk does to a run that is being recorded. Raises UnfinishedError."""
    try:
        yield
    except (OSError, FolderError) as e:
        reason = f"cannot write in {folder}: {e.strerror or e}" if isinstance(e, OSError) else str(e).rstrip(".")
        advice = f"; what is written stays: make room, then retune resume {folder}" if _is_resumable(folder) else ""
        raise UnfinishedError(f"{reason}{advice}.") from e


def _is_resumable(folder: Path | None) -> bool:
    """Whether a run is recorded there that `resume` knows: not that of a system of which nothing is estimated."""
    if folder is None or not (folder / LOCK).exists():
        return False
    try:
        return "estimator" in json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError):
        return False


_POLITE: Final = (signal.SIGINT, signal.SIGTERM, *([] if sys.platform == "win32" else [signal.SIGHUP]))


@contextmanager
def uninterrupted() -> Generator[None]:
    """Put SIGINT, SIGTERM and SIGHUP off until what is inside is done; the caller's handler gets the first one then.

    Elsewhere than in the main thread, to which alone Python gives signals, there is nothing to put off.
    """
    came: list[int] = []
    with ExitStack() as stack:
        stack.callback(lambda: signal.raise_signal(came[0]) if came else None)
        if threading.current_thread() is threading.main_thread():
            for number in _POLITE:
                if callable(signal.getsignal(number)):  # else it ends the process or is ignored: no exception
                    handler = signal.signal(number, lambda n, _: came.append(n))
                    stack.callback(signal.signal, number, handler)
        yield


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a whole JSON file at once or not at all."""
    write_text(path, to_json(content, indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a whole text file at once or not at all. Raises FolderError."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file at once or not at all. Raises FolderError."""
    with _replaced(path) as file:
        file.write(content)


def write_csv(path: Path, series: Mapping[str, Sequence[float] | np.ndarray[Any, Any]]) -> None:
    """The series as CSV, every digit kept, at once or not at all. Raises FolderError."""
    header = io.StringIO()
    csv.writer(header, lineterminator="\n").writerow(series)
    rows = pa.RecordBatch.from_arrays([_array(c) for c in series.values()], names=list(series))
    with _replaced(path) as file:
        file.write(header.getvalue().encode())
        arrow_csv.write_csv(rows, file, arrow_csv.WriteOptions(include_header=False))


@contextmanager
def _replaced(path: Path) -> Generator[IO[bytes]]:
    """A file that takes the place of path once it is whole: temporary file, fsync, rename. Raises FolderError."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
        try:
            with open(handle, "wb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as e:
        raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e


def read_series(folder: Path) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
    """The recorded series of a run folder, also of a run that was killed: as far as it was written.

    Raises FolderError where there is none.
    """
    batches: list[Any] = []
    try:
        with open(readable(folder / SERIES), "rb") as file:
            reader = pa.ipc.open_stream(file)
            batches.extend(_readable(reader))
    except (OSError, pa.ArrowInvalid) as e:
        raise FolderError(f"{folder} has no readable {SERIES}: {e}.") from e
    table = pa.Table.from_batches(batches, reader.schema)
    return {name: _column(table[name].chunks) for name in table.column_names}


def _array(column: Sequence[float] | np.ndarray[Any, Any]) -> Any:
    """The column as Arrow's: pa.array imports pandas, 0.25 s, to see whether it was given one of its arrays."""
    values = np.ascontiguousarray(column, dtype=np.float64)
    return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)])


def _column(chunks: Sequence[Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    parts = [np.from_dlpack(chunk) for chunk in chunks]  # to_numpy imports pandas too
    return np.concatenate(parts, dtype=np.float64) if parts else np.empty(0)


def _readable(reader: Any) -> Iterator[Any]:
    """Batches up to where the writing stopped."""
    while True:
        try:
            yield reader.read_next_batch()
        except (StopIteration, pa.ArrowInvalid, OSError):
            return


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal. Raises OSError."""
    with open(readable(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def to_json(value: object, indent: int | None = None) -> str:
    """JSON with null for what is not finite."""
    try:
        return json.dumps(value, indent=indent, allow_nan=False)
    except (TypeError, ValueError):  # NumPy's types, or a number that is not finite
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
