"""Files that grow while a run goes on: whole pieces only, and a digest of what is in them."""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from ..files import readable

_CHUNK: Final = 1 << 20


@dataclass(frozen=True)
class Prefix:
    """The beginning of a file, as it was at some time."""

    size: int
    """Bytes."""
    sha256: str
    """Of these bytes, in hexadecimal."""

    def digest_of(self, path: Path) -> Any:
        """The running SHA-256 of that many bytes of the file, or None where they are others. Raises OSError."""
        digest, left = hashlib.sha256(), self.size
        with open(readable(path), "rb") as file:
            while left and (chunk := file.read(min(left, _CHUNK))):
                digest.update(chunk)
                left -= len(chunk)
        return digest if not left and digest.hexdigest() == self.sha256 else None


EMPTY: Final = Prefix(0, hashlib.sha256().hexdigest())
"""Of any file."""


class AppendFile:
    """A file that only grows. What cannot be written whole is not in it: the disk may be full."""

    def __init__(self, path: Path, prefix: Prefix | None = None) -> None:
        """A new file or, with prefix, an old one that goes on behind it; what comes after it there is cut off.

        Raises OSError: FileExistsError for a new one that is there; ValueError where the prefix is another.
        """
        digest = hashlib.sha256() if prefix in (None, EMPTY) else prefix.digest_of(path)
        if digest is None:
            raise ValueError(f"{path.name} has changed")
        self._digest, self._size = digest, prefix.size if prefix else 0
        self._file = open(path, "xb" if prefix is None else "a+b", buffering=0)  # noqa: SIM115  closed in close
        self._file.truncate(self._size)
        self._file.seek(self._size)

    def append(self, piece: bytes) -> None:
        """Hand the piece to the operating system. Raises OSError, the file being as it was."""
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
        """Wait until everything is on the disk; what is there. Raises OSError."""
        os.fsync(self._file.fileno())
        return Prefix(self._size, self._digest.hexdigest())

    def close(self) -> None:
        """Give the file back; idempotent."""
        self._file.close()
