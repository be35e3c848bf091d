"""Lock file that admits one command at a time to a run folder; the operating system releases it with its owner."""

import errno
import os
import platform
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from filelock import FileLock, Timeout

from ..errors import FolderError, one_line
from .run_files import LOCK, new_run_folder

_held: Final[set[Path]] = set()
"""Folders that this process has locked: to ask the operating system once more would be to wait for ourselves."""


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Lock the folder against other processes; the same process may lock it again.

    The file is removed at the end; where its owner was killed it stays, and locks nothing.
    Raises FolderError where another process holds it.
    """
    path, me, key = folder / LOCK, f"process {os.getpid()} on {platform.node()}", folder.resolve()
    if key in _held:
        yield
        return
    lock = FileLock(path, timeout=0.2, poll_interval=0.02)  # whoever only looks, `is_locked`, has it for a moment
    try:
        owner = None if _is_taken(lock, path) else _owner(path)
    except OSError as e:
        raise FolderError(f"cannot write in {folder}: {e.strerror or e}.") from e
    if owner is not None:
        raise FolderError(f"{folder} is in use by {owner or 'another command'}; wait for it, or end it first.")
    _held.add(key)
    try:
        try:
            path.write_text(me, encoding="utf-8")
        except OSError as e:
            raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e
        yield
    finally:
        _held.discard(key)
        path.unlink(missing_ok=True)  # first: nobody shall take a file that is going to vanish
        lock.release()


@contextmanager
def new_locked_folder(scenario: str, out: Path | None) -> Generator[Path]:
    """Yield a new run folder, as new_run_folder makes it, locked by this process. Raises FolderError."""
    folder = new_run_folder(scenario, out)
    with locked(folder):
        new_run_folder(scenario, folder)  # another may have been in it before us
        for left in (path for path in folder.iterdir() if path.is_dir()):
            left.rmdir()  # of one that was killed
        yield folder


def is_locked(folder: Path) -> bool:
    """Return whether a command holds the lock of the folder."""
    path = folder / LOCK
    lock = FileLock(path, timeout=0)
    try:
        if not path.exists() or not _is_taken(lock, path):
            return path.exists()
    except OSError:
        return False
    lock.release()
    return False


def _is_taken(lock: FileLock, path: Path) -> bool:
    """Acquire the lock; return False where another process holds it. Raises OSError, also where path is no file."""
    path.parent.stat()  # filelock would make the folder
    if path.is_symlink():
        raise OSError(errno.ELOOP, f"{path.name} is a symbolic link")
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, f"{path.name} is not a regular file")
    try:
        lock.acquire()
    except Timeout:
        return False
    return True


def _owner(path: Path) -> str:
    try:
        return one_line(path.read_text(encoding="utf-8", errors="replace"))
    except FileNotFoundError:
        return ""
