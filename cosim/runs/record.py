"""Recording of a run in its folder, readable up to wherever the writing stops."""

import io
import json
import math
import signal
import sys
import threading
from array import array
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from ..errors import FolderError, UnfinishedError
from ..files import to_json
from .append_file import AppendFile, Prefix
from .run_files import EVENTS, LOCK, MANIFEST, SERIES
from .series import arrow_array, read_series

ROWS_PER_BATCH = 100
"""Rows of a batch: 200 take 8 % less when compressed, 50 take 12 % more."""
_MOST_KEPT: Final = 1 << 20
"""Number of values up to which a record is kept in memory, too, 8 MB: to read it again takes as long as to write it."""


@dataclass(frozen=True)
class Place:
    """The end of a record: prefixes of its files."""

    series: Prefix
    """Prefix of the file of the series."""
    events: Prefix
    """Prefix of the file of events."""


class Recorder:
    """Writer of one run: rows to a compressed Arrow IPC stream, events to JSON lines.

    Without a folder it only keeps the rows. With one a long record is kept in memory only as far as it is not written
    yet: an hour of a quadrotor at 100 Hz is 230 MB.
    Its methods raise UnfinishedError where the disk is full; what is written already stays intact.
    """

    def __init__(self, folder: Path | None, columns: Sequence[str], place: Place | None = None) -> None:
        """place: continue an earlier record from there; the rest is cut off.

        Raises FolderError where a new record exists already, an earlier one differs, or the folder cannot be written.
        """
        self.columns = tuple(columns)
        self._folder = folder
        self._values = array("d")  # of the rows held, one after the other
        self._written: array[float] | None = None if place else array("d")  # of all others, while they are few
        self._lines: list[str] = []  # events held
        self._room = ROWS_PER_BATCH * len(self.columns) if folder is not None else math.inf
        self._schema = pa.schema([(name, pa.float64()) for name in columns])
        self._series: AppendFile | None = None
        self._events: AppendFile | None = None
        if folder is None:
            return
        try:
            self._series = AppendFile(folder / SERIES, place and place.series)
            self._events = AppendFile(folder / EVENTS, place and place.events)
            self._stream = _Stream(self._schema)
            if place is None or not place.series.size:
                self._series.append(self._stream.head)
        except ValueError as e:
            self.release()
            raise FolderError(f"{folder} is damaged: {e}.") from e
        except OSError as e:
            self.release()
            raise FolderError(f"cannot write in {folder}: {e.strerror or e}.") from e

    def row(self, values: Sequence[float]) -> None:
        """Record the values of one communication point, in the order of the columns."""
        self._values.extend(values)
        if len(self._values) >= self._room:
            self.flush()

    def event(self, t: float, kind: str, detail: Mapping[str, Any]) -> None:
        """Record one event."""
        if self._events is not None:
            self._lines.append(to_json({"t": t, "kind": kind, **detail}, is_compact=True) + "\n")

    def flush(self) -> None:
        """Hand everything recorded so far to the operating system."""
        if self._series is None or self._events is None:
            return
        with uninterrupted(), recording(self._folder):
            if self._values:
                columns = [arrow_array(column) for column in self._table(self._values)]
                self._series.append(self._stream.batch(pa.record_batch(columns, schema=self._schema)))
                self._keep()
            if self._lines:
                self._events.append("".join(self._lines).encode())
                self._lines = []

    def place(self) -> Place:
        """Write everything to the disk; return the end of the record. Raises ValueError without a folder."""
        if self._series is None or self._events is None:
            raise ValueError("a record without a folder has no place.")
        self.flush()
        with recording(self._folder):
            return Place(self._series.sync(), self._events.sync())

    def close(self) -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        """Complete and close the files; return the recorded series by column."""
        self.flush()
        if self._folder is None or self._series is None:
            return self._by_column(self._values)
        with recording(self._folder):
            self._series.append(_END_OF_STREAM)
        self.release()
        return read_series(self._folder) if self._written is None else self._by_column(self._written)

    def release(self) -> None:
        """Close the files as they are; idempotent."""
        for file in (self._series, self._events):
            if file is not None:
                file.close()

    def _keep(self) -> None:
        """Take the rows held for written."""
        if self._written is not None:
            self._written.extend(self._values)
            self._written = self._written if len(self._written) <= _MOST_KEPT else None
        self._values = array("d")

    def _by_column(self, values: "array[float]") -> dict[str, np.ndarray[Any, np.dtype[np.float64]]]:
        return dict(zip(self.columns, self._table(values), strict=True))

    def _table(self, values: "array[float]") -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the values of rows, one after the other, as contiguous columns."""
        return np.ascontiguousarray(np.array(values).reshape(-1, len(self.columns)).T)


class _Stream:
    """The bytes of an Arrow IPC stream with compressed batches, piece by piece; lossless."""

    def __init__(self, schema: Any) -> None:
        self.head: bytes = schema.serialize().to_pybytes()
        """The schema, with which a stream begins."""
        self._sink = io.BytesIO()
        self._writer = pa.ipc.new_stream(self._sink, schema, options=pa.ipc.IpcWriteOptions(compression="zstd"))
        none = [arrow_array(())] * len(schema)
        self.batch(pa.record_batch(none, schema=schema))  # it writes the schema with the first one

    def batch(self, batch: Any) -> bytes:
        """Return the bytes of the next batch."""
        self._writer.write_batch(batch)
        taken = self._sink.getvalue()
        self._sink.seek(0)
        self._sink.truncate()
        return taken


_END_OF_STREAM: Final = b"\xff\xff\xff\xff\0\0\0\0"
"""Arrow columnar format, section "IPC streaming format": a continuation marker and no message."""


@contextmanager
def recording(folder: Path | None) -> Generator[None]:
    """Turn failed writes to a run folder into UnfinishedError, with the reason in one line."""
    try:
        yield
    except (OSError, FolderError) as e:
        reason = f"cannot write in {folder}: {e.strerror or e}" if isinstance(e, OSError) else str(e).rstrip(".")
        advice = f"; what is written stays: make room, then retune resume {folder}" if _is_resumable(folder) else ""
        raise UnfinishedError(f"{reason}{advice}.") from e


def _is_resumable(folder: Path | None) -> bool:
    """Return whether the folder holds a run that `resume` accepts: not of a system in which nothing is estimated."""
    if folder is None or not (folder / LOCK).exists():
        return False
    try:
        return "estimator" in json.loads((folder / MANIFEST).read_bytes())
    except (OSError, ValueError):
        return False


_POLITE: Final = (signal.SIGINT, signal.SIGTERM, *([] if sys.platform == "win32" else [signal.SIGHUP]))


@contextmanager
def uninterrupted() -> Generator[None]:
    """Defer SIGINT, SIGTERM and SIGHUP to the end of the block; the caller's handler then gets the first one.

    Does nothing outside the main thread: Python delivers signals to that thread alone.
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
