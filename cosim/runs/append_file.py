"""Append-only files of a run in progress: complete pieces only, and a SHA-256 of the content."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ..files import readable

_CHUNK: Final = 1 << 20


@dataclass(frozen=True)
class Prefix:
    """The beginning of a file: its size and hash at some time."""

    size: int
    """Size in bytes."""
    sha256: str
    """SHA-256 of these bytes, in hexadecimal."""

    def digest_of(self, path: Path) -> Any:
        """Return the running SHA-256 of the file's first `size` bytes, or None where they differ. Raises OSError."""
        digest, left = hashlib.sha256(), self.size
        with open(readable(path), "rb") as file:
            while left and (chunk := file.read(min(left, _CHUNK))):
                digest.update(chunk)
                left -= len(chunk)
        return digest if not left and digest.hexdigest() == self.sha256 else None


EMPTY: Final = Prefix(0, hashlib.sha256().hexdigest())
"""Prefix of length zero, which every file has."""


class AppendFile:
    """An append-only file. A piece that cannot be written completely, as on a full disk, is cut off again."""

    def __init__(self, path: Path, prefix: Prefix | None = None) -> None:
        """prefix: continue an existing file behind it, cutting off the rest; None makes a new file.

        Raises OSError, FileExistsError where a new file exists already; ValueError where the prefix differs.
        """
        digest = hashlib.sha256() if prefix in (None, EMPTY) else prefix.digest_of(path)
        if digest is None:
            raise ValueError(f"{path.name} has changed")
        self._digest, self._size = digest, prefix.size if prefix else 0
        self._file = open(path, "xb" if prefix is None else "a+b", buffering=0)  # noqa: SIM115  closed in close
        self._file.truncate(self._size)
        self._file.seek(self._size)

    def append(self, piece: bytes) -> None:
        """Hand the piece to the operating system. Raises OSError and leaves the file unchanged."""
        left = memoryview(piece)
        try:
            while left:
                left = left[self._file.write(left) :]
        except BaseException:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(piece)
        self._digest.update(piece)

    def sync(self) -> Prefix:
        """Wait until everything is on the disk; return it as a prefix. Raises OSError."""
        os.fsync(self._file.fileno())
        return Prefix(self._size, self._digest.hexdigest())

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()
