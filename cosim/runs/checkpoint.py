"""Checkpoints: all that a run needs to be resumed bit for bit, in one file of its folder.

The run is pickled with everything that it holds, so that later attributes are in its checkpoints without further code.
Live parts that cannot be pickled, such as an FMU in its process, are left out and save and restore their own state: see
`Alive`. A checkpoint is as trusted as a program: unpickling runs the code in it.
"""

import hashlib
import pickle
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol, cast

from pydantic import TypeAdapter, ValidationError

from ..errors import CosimError, FolderError, NotResumableError, one_line
from ..files import readable, to_json, write_bytes
from .record import Place, Recorder, recording
from .run_files import CHECKPOINT


class Alive(Protocol):
    """A live part that is not pickled: the resumed run has made its own of the same name and restores its state."""

    @property
    def checkpoint_name(self) -> str:
        """Name, unique within the run."""
        ...

    def to_checkpoint(self) -> object:
        """Return the state that from_checkpoint needs, to be pickled. Raises NotResumableError with the reason."""
        ...

    def from_checkpoint(self, saved: Any) -> None:
        """Restore the saved state. Raises NotResumableError."""
        ...


@dataclass(frozen=True)
class Checkpoint:
    """The state of a run at the beginning of a communication point."""

    place: Place
    """End of its record at that point."""
    n_parts: int
    """Number of live parts, the run itself among them."""
    content: bytes
    """Their names and states, pickled one after the other."""


@dataclass(frozen=True)
class _Header:
    """The second line of the file. The first is the SHA-256 of the rest; the content follows."""

    place: Place | None = None
    n_parts: int = 0
    reason: str = ""
    """Reason why there is no content."""


class Checkpoints:
    """Writer of checkpoints, every `every` communication points from the first one on."""

    def __init__(self, folder: Path | None, every: int) -> None:
        """folder, every: without a folder, or with every = 0, no checkpoints are written."""
        self._folder, self._every = folder, every

    def offer(self, k: int, run: Alive, recorder: Recorder) -> None:
        """Write a checkpoint if one is due at the beginning of point k. Raises UnfinishedError, SlaveError.

        For a run that cannot be resumed the file holds the reason; an earlier checkpoint is kept instead.
        """
        if self._folder is None or not self._every or k % self._every:
            return
        path = self._folder / CHECKPOINT
        try:
            content, parts = _dumped(run)
            header = _Header(recorder.place(), len(parts))
        except NotResumableError as e:
            self._every = 0
            if path.exists():
                return
            header, content = _Header(reason=str(e)), b""
        rest = to_json(asdict(header)).encode() + b"\n" + content
        with recording(self._folder):
            write_bytes(path, hashlib.sha256(rest).hexdigest().encode() + b"\n" + rest)


def read_checkpoint(folder: Path) -> Checkpoint:
    """Return the last checkpoint of a run. Raises NotResumableError if there is none, FolderError if it is damaged."""
    try:
        digest, _, rest = readable(folder / CHECKPOINT).read_bytes().partition(b"\n")
        if hashlib.sha256(rest).hexdigest().encode() != digest:
            raise FolderError(f"{folder} is damaged: {CHECKPOINT} is not as it was written.")
        head, _, content = rest.partition(b"\n")
        header = TypeAdapter(_Header).validate_json(head)
    except FileNotFoundError as e:
        raise NotResumableError("it has no checkpoint") from e
    except OSError as e:
        raise FolderError(f"{folder} is damaged: cannot read {CHECKPOINT}: {e.strerror or e}.") from e
    except ValidationError as e:
        raise NotResumableError("its checkpoint is of another version") from e
    if header.place is None:
        raise NotResumableError(header.reason)
    return Checkpoint(header.place, header.n_parts, content)


def restore(run: Alive, checkpoint: Checkpoint) -> None:
    """Restore the state of a checkpoint in a run just initialised. Raises NotResumableError, SlaveError."""
    _, parts = _dumped(run)
    unpickler = _Unpickler(checkpoint.content, parts)
    try:
        states = [cast(tuple[str, Any], unpickler.load()) for _ in range(checkpoint.n_parts)]
    except CosimError:
        raise
    except Exception as e:  # whatever a class that has changed raises
        raise NotResumableError(f"its checkpoint is of another version: {type(e).__name__}: {one_line(str(e))}") from e
    for name, state in states:
        parts[name].from_checkpoint(state)


def _dumped(run: Alive) -> tuple[bytes, dict[str, Alive]]:
    """Return the pickled states of the run and its live parts, one after the other, and these parts by name."""
    buffer = BytesIO()
    pickler = _Pickler(buffer)  # one for all: what two parts share stays shared
    pickler.persistent_id(run)
    try:
        while pickler.pending:
            part = pickler.pending.pop()
            pickler.dump((part.checkpoint_name, part.to_checkpoint()))
    except CosimError:
        raise
    except Exception as e:  # whatever a user's class raises that cannot be pickled
        raise NotResumableError(f"its state cannot be saved: {type(e).__name__}: {one_line(str(e))}") from e
    return buffer.getvalue(), pickler.parts


class _Pickler(pickle.Pickler):
    def __init__(self, file: BytesIO) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.parts: dict[str, Alive] = {}
        self.pending: list[Alive] = []

    def persistent_id(self, obj: Any) -> str | None:
        if not hasattr(type(obj), "to_checkpoint"):
            return None
        name = obj.checkpoint_name
        if name not in self.parts:
            self.parts[name] = obj
            self.pending.append(obj)
        elif self.parts[name] is not obj:
            raise ValueError(f"two parts are called '{name}'")
        return name


class _Unpickler(pickle.Unpickler):
    def __init__(self, content: bytes, parts: Mapping[str, Alive]) -> None:
        super().__init__(BytesIO(content))
        self._parts = parts

    def persistent_load(self, pid: str) -> Alive:
        if pid not in self._parts:
            raise NotResumableError(f"nothing in the new run is called '{pid}'")
        return self._parts[pid]
