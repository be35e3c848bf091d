"""Cache of unpacked SSP packages: a bounded number and size, those used longest ago go first, none that is in use.

A package is in use as long as a process lives that has read it or runs its FMUs: it holds a shared lock (flock) of the
folder. On Windows, which has no such lock, a package counts as in use for a day.
"""

import hashlib
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Final

from ..errors import SspError
from ..files import readable
from ..fmi.archive import unpack
from .fmu_cache import cache_folder

MOST_PACKAGES: Final = 32
MOST_BYTES: Final = 8 << 30
"""Bytes of all packages together; the newest may be larger."""
_DAY_S: Final = 86400.0
_held: dict[Path, int] = {}  # descriptors of the folders that this process uses


def unpacked_package(path: Path) -> Path:
    """Unpack a package into the cache, under its content's hash, and return its folder, which is in use from then on.

    Raises SspError, ModelDescriptionError for an archive that cannot be read or would write outside its folder.
    """
    try:
        with open(readable(path), "rb") as file:
            folder = _packages() / hashlib.file_digest(file, "sha256").hexdigest()
        return filled(folder, lambda stage: unpack(path, str(stage)))
    except OSError as e:
        raise SspError(f"{path} cannot be unpacked: {e.strerror or e}.") from e


def filled(folder: Path, fill: Callable[[Path], None]) -> Path:
    """Return a folder of the cache, filled at once or not at all where it is missing, and in use from then on.

    Raises OSError, and what fill raises.
    """
    if hold(folder):
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    stage = Path(tempfile.mkdtemp(dir=folder.parent, prefix=".unpacking-"))
    lock = _lock(stage, is_shared=True)
    try:
        fill(stage)
        os.rename(stage, folder)
    except OSError:
        if not folder.is_dir():  # another process has been faster
            raise
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        _give_back(lock)
    hold(folder)
    _remove_oldest(folder)
    return folder


def hold(folder: Path) -> bool:
    """Keep an unpacked package from being removed for as long as this process lives; return whether it is there."""
    lock = _lock(folder, is_shared=True)
    if not folder.is_dir():
        _give_back(lock)
        return False
    with suppress(OSError):
        os.utime(folder)
    _give_back(_held.pop(folder, None))
    if lock is not None:
        _held[folder] = lock
    return True


def hold_those_of(files: Iterable[Path]) -> None:
    """Keep the unpacked packages that files lie in from being removed."""
    packages = _packages()
    for folder in {packages / f.relative_to(packages).parts[0] for f in files if f.is_relative_to(packages)}:
        hold(folder)


def discard(folder: Path) -> None:
    """Remove an unpacked package that is refused, unless another process uses it."""
    _give_back(_held.pop(folder, None))
    _remove(folder)


def _packages() -> Path:
    return cache_folder() / "ssp"


def _remove_oldest(newest: Path) -> None:
    """Remove what is too much, and what killed processes have left half unpacked."""
    used: list[tuple[float, Path]] = []
    for path in newest.parent.iterdir():
        with suppress(OSError):
            if path.name.startswith("."):
                _remove(path)
            elif path != newest:
                used.append((path.stat().st_mtime, path))
    kept, n_bytes = 1, _size(newest)
    for _, path in sorted(used, reverse=True):
        kept, n_bytes = kept + 1, n_bytes + _size(path)
        if kept > MOST_PACKAGES or n_bytes > MOST_BYTES:
            _remove(path)


def _size(folder: Path) -> int:
    total = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                total += os.stat(os.path.join(place, name), follow_symlinks=False).st_size
    return total


def _remove(folder: Path) -> None:
    """Remove a folder that no process uses; one that cannot be removed stays, as it harms nobody."""
    lock = _lock(folder, is_shared=False)
    try:
        with suppress(OSError):
            if lock is not None or (sys.platform == "win32" and folder.stat().st_mtime <= time.time() - _DAY_S):
                gone = folder.with_name(f".removing-{os.getpid()}-{folder.name.lstrip('.')}")
                os.rename(folder, gone)  # at once, for another process that wants it
                shutil.rmtree(gone, ignore_errors=True)
    finally:
        _give_back(lock)


def _lock(folder: Path, is_shared: bool) -> int | None:
    """Return the descriptor that holds a folder's lock; None where that is impossible or another process is in it."""
    if sys.platform == "win32":
        return None
    import fcntl

    try:
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_SH if is_shared else fcntl.LOCK_EX | fcntl.LOCK_NB)  # who removes is soon done
        if os.path.samestat(os.fstat(lock), os.stat(folder)):
            return lock
    except OSError:  # it is held, it has gone, or the file system has no locks
        pass
    os.close(lock)
    return None


def _give_back(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)
