"""Reading and writing of files: atomic replacement, hashes and JSON."""

import errno
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from .errors import FolderError


def readable(path: Path) -> Path:
    """Return the path, if opening it cannot block. Raises OSError for a pipe, a socket or a device."""
    if path.exists() and not path.is_file() and not path.is_dir():
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return path


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a whole JSON file at once or not at all."""
    write_text(path, to_json(content, indent=2) + "\n")


def write_text(path: Path, text: str) -> None:
    """Write a whole text file at once or not at all. Raises FolderError."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a whole file at once or not at all. Raises FolderError."""
    with replaced(path) as file:
        file.write(content)


@contextmanager
def replaced(path: Path) -> Generator[IO[bytes]]:
    """Yield a file that replaces path once it is complete: temporary file, fsync, rename. Raises FolderError."""
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
            with suppress(FileNotFoundError):  # an interrupt may come when it has been renamed
                os.unlink(name)
            raise
    except OSError as e:
        raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal. Raises OSError."""
    with open(readable(path), "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def to_json(value: object, indent: int | None = None, *, is_compact: bool = False) -> str:
    """Return a value as JSON, with null for numbers that are not finite; is_compact: without spaces."""
    separators = (",", ":") if is_compact else None
    try:
        return json.dumps(value, indent=indent, separators=separators, allow_nan=False)
    except (TypeError, ValueError):  # NumPy's types, or a number that is not finite
        return json.dumps(_jsonable(value), indent=indent, separators=separators, allow_nan=False)


def _jsonable(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _jsonable(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_jsonable(v) for v in value]
    if callable(to_list := getattr(value, "tolist", None)):  # NumPy's
        return _jsonable(to_list())
    return value
