"""Checkpoints: all that a run needs to be resumed bit for bit, in one file of its folder.

The run is saved with everything that it holds, so that later attributes are in its checkpoints without further code:
see `cosim.runs.run_state`. A checkpoint is data; nothing in it is run, whoever has written it.
"""

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from pydantic import TypeAdapter, ValidationError

from ..errors import CosimError, FolderError, NotResumableError, one_line
from ..files import readable, to_json, write_bytes
from .record import Place, Recorder, recording
from .run_files import CHECKPOINT
from .run_restoration import restore_state
from .run_state import StartObjects, encoded

_SCHEMA: Final = "fmu-retune checkpoint"
_VERSION: Final = 2
"""Version of the file; one of another is refused. The first was a pickle."""


class Alive(Protocol):
    """A live part, such as an FMU in its process, which saves its own state; the resumed run's own restores it."""

    def to_checkpoint(self) -> object:
        """Return the state that from_checkpoint needs, as data. Raises NotResumableError with the reason."""
        ...

    def from_checkpoint(self, saved: Any) -> None:
        """Restore the saved state. Raises NotResumableError."""
        ...


@dataclass(frozen=True)
class Checkpoint:
    """The state of a run at the beginning of a communication point."""

    place: Place
    """End of its record at that point."""
    content: bytes
    """The run's state."""


@dataclass(frozen=True)
class _Header:
    """The second line of the file. The first is the SHA-256 of the rest; the content follows."""

    schema: Literal["fmu-retune checkpoint"]
    version: Literal[2]
    place: Place | None = None
    reason: str = ""
    """Reason why there is no content."""


class Checkpoints:
    """Writer of checkpoints, every `every` communication points from the first one on."""

    def __init__(self, folder: Path | None, every: int, start: StartObjects | None) -> None:
        """start: the run's objects; without them, without a folder, or with every = 0, no checkpoints are written."""
        self._folder, self._every, self._start = folder, every, start

    def offer(self, k: int, recorder: Recorder) -> None:
        """Write a checkpoint if one is due at the beginning of point k. Raises UnfinishedError, SlaveError.

        For a run that cannot be resumed the file holds the reason; an earlier checkpoint is kept instead.
        """
        if self._folder is None or self._start is None or not self._every or k % self._every:
            return
        path = self._folder / CHECKPOINT
        try:
            content = _encoded(self._start)
            header = _Header(_SCHEMA, _VERSION, recorder.place())
        except NotResumableError as e:
            self._every = 0
            if path.exists():
                return
            header, content = _Header(_SCHEMA, _VERSION, reason=str(e)), b""
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
    return Checkpoint(header.place, content)


def restore(start: StartObjects, checkpoint: Checkpoint) -> None:
    """Restore the state of a checkpoint in a run just initialised. Raises NotResumableError, SlaveError."""
    try:
        restore_state(start, checkpoint.content)
    except CosimError:
        raise
    except Exception as e:  # whatever content that does not fit leads to
        raise NotResumableError(f"its checkpoint does not fit the run: {type(e).__name__}: {one_line(str(e))}") from e


def _encoded(start: StartObjects) -> bytes:
    try:
        return encoded(start)
    except CosimError:
        raise
    except Exception as e:  # whatever a user's class raises
        raise NotResumableError(f"its state cannot be saved: {type(e).__name__}: {one_line(str(e))}") from e
