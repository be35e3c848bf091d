"""One command at a time in a run folder: a lock file, held by the operating system for as long as its owner lives."""

import errno
import os
import platform
import stat
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Final

from ..errors import FolderError, one_line
from .run_files import LOCK, new_run_folder

if sys.platform != "win32":
    import fcntl
else:
    import msvcrt

_FAR: Final = 1 << 30
"""Byte that Windows locks: nobody else can read those that are locked."""


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Keep other commands out of the folder; inside it, the same process may come again.

    The file is removed at the end; where its owner was killed it stays, and keeps nobody out.
    Raises FolderError where another process holds it.
    """
    path, me = folder / LOCK, f"process {os.getpid()} on {platform.node()}"
    try:
        file = _taken(path)
        owner = _owner(path) if file is None else me
    except OSError as e:
        raise FolderError(f"cannot write in {folder}: {e.strerror or e}.") from e
    if owner != me:
        raise FolderError(f"{folder} is in use by {owner or 'another command'}; wait for it, or end it first.")
    if file is None:
        yield
        return
    try:
        try:
            file.truncate(0)
            file.write(me.encode())
        except OSError as e:
            raise FolderError(f"cannot write {path}: {e.strerror or e}.") from e
        yield
    finally:
        path.unlink(missing_ok=True)  # first: nobody shall take a file that is going to vanish
        file.close()


@contextmanager
def new_locked_folder(scenario: str, out: Path | None) -> Generator[Path]:
    """A new run folder, as new_run_folder makes it, kept for this process. Raises FolderError."""
    folder = new_run_folder(scenario, out)
    with locked(folder):
        new_run_folder(scenario, folder)  # another may have been in it before us
        for left in (path for path in folder.iterdir() if path.is_dir()):
            left.rmdir()  # of one that was killed
        yield folder


def is_locked(folder: Path) -> bool:
    """Whether a command is at work in the folder."""
    try:
        with _opened(folder / LOCK, os.O_RDWR) as file:
            return not _lock(file, shared=True)
    except OSError:
        return False


def _taken(path: Path) -> "IO[bytes] | None":
    """The open lock file, ours now, or None where it is another's. Raises OSError."""
    while True:
        file = _opened(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)  # closed by locked
        if not _lock(file):
            file.close()
            return None
        try:
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except FileNotFoundError:
            pass
        file.close()  # its owner has removed it between our open and our lock


def _opened(path: Path, flags: int) -> "IO[bytes]":
    """The file of that name itself; opening it waits for nobody. Raises OSError, also for what is no file."""
    for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"):  # what there is of them
        flags |= getattr(os, name, 0)
    if path.is_symlink():
        raise OSError(errno.ELOOP, f"{path.name} is a symbolic link")
    descriptor = os.open(path, flags, 0o666)
    if stat.S_ISREG(os.fstat(descriptor).st_mode):
        return open(descriptor, "r+b", buffering=0)
    os.close(descriptor)
    raise OSError(errno.EINVAL, f"{path.name} is not a regular file")


def _owner(path: Path) -> str:
    try:
        return one_line(path.read_text(encoding="utf-8", errors="replace"))
    except FileNotFoundError:
        return ""


def _lock(file: "IO[bytes]", shared: bool = False) -> bool:
    """Lock the file without waiting. Where the file system has no locks, nobody is kept out."""
    try:
        if sys.platform != "win32":
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        else:
            file.seek(_FAR)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return not shared
    return True
