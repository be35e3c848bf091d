"""Private folders that FMUs are unpacked into, and that are removed however a process ends.

A process that is killed cannot clean up. So each folder is locked (flock, which ends with its holder) for as long as it
is used, and a process that makes one first removes those that are no longer locked.
"""

import os
import re
import shutil
import sys
import tempfile
import time
import weakref
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from ..errors import ModelDescriptionError

PREFIX: Final = "fmu-retune-live-"
REMOVAL_S: Final = 2.0
"""Longest time for which the removal of a folder is tried again [s]."""

# What a file URI keeps as it is, and the space, which every loader decodes: pythonfmu's crashes on anything else.
_SAFE: Final = re.compile(r"[A-Za-z0-9._~/ -]*" if sys.platform != "win32" else r"[A-Za-z0-9._~/\\: -]*")
_OTHER_FOLDERS: Final = ("/tmp", "/var/tmp") if sys.platform != "win32" else (r"C:\Users\Public", r"C:\Temp")


class PrivateFolder:
    """A new, empty folder, from which FMUs can be loaded whatever the folder of temporary files is called.

    It is removed by `remove`, when it is garbage-collected, or at the end of the program.
    """

    path: str
    """Absolute path."""
    is_kept: Final = False

    def __init__(self) -> None:
        """Raises ModelDescriptionError where no folder has a name that every FMU can read."""
        for parent in (tempfile.gettempdir(), *_OTHER_FOLDERS):
            if _SAFE.fullmatch(parent) and os.access(parent, os.W_OK | os.X_OK):
                _remove_abandoned_once(parent)
                with suppress(OSError):
                    self._make(os.path.abspath(parent))
                    return
        raise ModelDescriptionError(
            f"no FMU can be unpacked: {tempfile.gettempdir()} is not a name that FMUs can be loaded from; "
            "set TMPDIR to a folder of plain letters, digits and -_.~ only."
        )

    def remove(self) -> None:
        """Remove it with all that is in it; idempotent."""
        self._finalizer()

    def __enter__(self) -> str:
        return self.path

    def __exit__(self, *_: object) -> None:
        self.remove()

    def _make(self, parent: str) -> None:
        """Make the folder. Raises OSError."""
        for _ in range(3):  # who clears up may take it for abandoned before it is locked
            self.path = os.path.join(parent, PREFIX + os.urandom(8).hex())
            # The finalizer first: an interrupt may come as soon as the folder is there.
            self._finalizer = weakref.finalize(self, _remove, self.path, os.getpid(), lock := _Lock())
            os.mkdir(self.path, 0o700)
            try:
                if lock.take(self.path) or sys.platform == "win32":
                    return
            except OSError:  # a file system without locks: nobody can take it for abandoned there either
                return
            self.remove()
        raise OSError(f"no folder can be kept in {parent}")


class _Lock:
    """The lock of a folder, on systems that have such locks."""

    def __init__(self) -> None:
        self._descriptor: int | None = None

    def take(self, folder: str) -> bool:
        """Take a folder's lock; return whether it was free and the folder exists. Raises OSError."""
        if sys.platform == "win32":
            return False
        import fcntl

        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except FileNotFoundError:
            return False
        try:
            if os.fstat(descriptor).st_uid != os.getuid():
                raise PermissionError(f"{folder} belongs to somebody else")
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_there = os.path.samestat(os.fstat(descriptor), os.stat(folder))
        except (BlockingIOError, FileNotFoundError):
            is_there = False
        except BaseException:
            os.close(descriptor)
            raise
        if not is_there:
            os.close(descriptor)
            return False
        self._descriptor = descriptor
        return True

    def give_back(self) -> None:
        """Give the lock back; idempotent."""
        if self._descriptor is not None:
            os.close(self._descriptor)
        self._descriptor = None


def remove_abandoned(parent: str) -> None:
    """Remove the folders in parent that were made here and that no living process holds."""
    for folder in Path(parent).glob(f"{PREFIX}*"):
        lock = _Lock()
        with suppress(OSError):
            if lock.take(str(folder)):
                remove_tree(str(folder))
        lock.give_back()


def remove_tree(folder: str) -> None:
    """Remove a folder with all that is in it, as far as it can be removed.

    Processes whose parent was killed may write to it until they notice, so it is tried again for REMOVAL_S.
    """
    deadline = time.monotonic() + REMOVAL_S
    while True:
        shutil.rmtree(folder, ignore_errors=True)
        if not os.path.lexists(folder) or time.monotonic() > deadline:
            return
        time.sleep(0.02)


class KeptFolder:
    """The folder of an unpacked FMU that `remove` gives back, for the next instance of the same file."""

    is_kept: Final = True

    def __init__(self, folder: PrivateFolder, give_back: Callable[[PrivateFolder], None]) -> None:
        self.path = folder.path
        self._finalizer = weakref.finalize(self, give_back, folder)

    def remove(self) -> None:
        """Give it back; idempotent."""
        self._finalizer()


@dataclass(frozen=True)
class BorrowedFolder:
    """The folder of an unpacked FMU that somebody else removes."""

    path: str
    is_kept: bool = False

    def remove(self) -> None:
        """Leave it."""


Folder = PrivateFolder | KeptFolder | BorrowedFolder


class KeptFolders:
    """Folders of unpacked FMUs that the next instance of the same file uses again, where they are as they were.

    For a process that makes one short run after the other: to make and remove the hundred small files of an FMU in
    Python takes as long as the run, since ext4 passes over the places of files removed a moment ago one by one. What
    Python compiles of them is kept with them.
    """

    def __init__(self) -> None:
        self._spare: dict[_File, list[PrivateFolder]] = {}
        self._unpacked: dict[str, tuple[_File, _Content]] = {}

    def take(self, fmu: Path) -> KeptFolder | None:
        """Return a folder that holds what is in the file; None where there is none to spare."""
        spare = self._spare.get(_file(fmu), [])
        while spare:
            folder = spare.pop()
            if self._unpacked[folder.path][1] == _content(folder.path):
                return KeptFolder(folder, self._give_back)
            self._drop(folder)
        return None

    def add(self, fmu: Path, folder: PrivateFolder) -> KeptFolder:
        """Add a folder that the file has been unpacked into."""
        self._unpacked[folder.path] = _file(fmu), _content(folder.path)
        return KeptFolder(folder, self._give_back)

    def _give_back(self, folder: PrivateFolder) -> None:
        """Keep a folder that was taken or added until the next instance; of many those given back last are kept."""
        file = self._unpacked[folder.path][0]
        self._spare[file] = [*self._spare.pop(file, []), folder]
        if sum(map(len, self._spare.values())) > MOST_KEPT:
            oldest = next(file for file, folders in self._spare.items() if folders)
            self._drop(self._spare[oldest].pop(0))

    def _drop(self, folder: PrivateFolder) -> None:
        del self._unpacked[folder.path]
        folder.remove()


_KEPT: Final[ContextVar[KeptFolders | None]] = ContextVar("kept folders", default=None)


@contextmanager
def folders_kept() -> Generator[None]:
    """Use the folders of FMUs again in this context, which makes one short run after the other."""
    token = _KEPT.set(KeptFolders())
    try:
        yield
    finally:
        _KEPT.reset(token)


def kept_folders() -> KeptFolders | None:
    """Return those of this context, if it has any."""
    return _KEPT.get()


MOST_KEPT: Final = 32
"""Folders that are kept while no instance uses them."""
_BYTECODE: Final = "__pycache__"
_File = tuple[str, int, int, int]
_Content = frozenset[tuple[str, int, int]]


def _file(path: Path) -> _File:
    """Return what tells a file from another, and from an earlier one of the same name."""
    state = path.stat()
    return os.path.realpath(path), state.st_ino, state.st_size, state.st_mtime_ns


def _content(folder: str) -> _Content:
    """Return the names of all folders in a folder; name, size and time of the last change of all files.

    What Python compiles is left out: Python itself compares it with its source.
    """
    found: list[tuple[str, int, int]] = []
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if name != _BYTECODE]
        found += [(os.path.join(place, name), 0, 0) for name in folders]
        for name in files:
            state = os.lstat(path := os.path.join(place, name))
            found.append((path, state.st_size, state.st_mtime_ns))
    return frozenset(found)


_remove_abandoned_once = cache(remove_abandoned)  # a process: the folder of temporary files may hold thousands


def _remove(path: str, process_id: int, lock: _Lock) -> None:
    if os.getpid() == process_id:  # not in a fork of it
        remove_tree(path)
        lock.give_back()
