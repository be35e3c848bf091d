"""Output folders of the commands, made so that no existing file is overwritten."""

import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import FolderError
from ..runs.lock import new_locked_folder
from ..runs.run_files import LOCK


@contextmanager
def new_folder(name: str, out: Path | None) -> Generator[Path]:
    """Yield a folder to write in, locked until the end; remove it again if the command fails before anything is in it.

    Raises FolderError if it is not empty or in use by another command; nothing is changed then.
    """
    place = out or Path("runs")
    there = {path for path in (place, *place.parents) if os.path.exists(path)}  # False for a name that is too long
    ours: Path | None = None
    try:
        with new_locked_folder(name, out) as ours:
            try:
                yield ours
            except BaseException:
                _remove_empty(ours)
                raise
    except BaseException:
        with suppress(OSError):  # it is not empty, or another command was quick to take it
            for path in (ours, *ours.parents) if ours else ():
                if path in there:
                    break
                path.rmdir()
        raise


def _remove_empty(folder: Path) -> None:
    """Remove the subfolders of a folder that contains nothing but empty ones."""
    below = [path for path in folder.iterdir() if path.name != LOCK]
    if all(path.is_dir() and not any(path.iterdir()) for path in below):
        for path in below:
            path.rmdir()


def must_be_new(path: Path | None, option: str) -> None:
    """Raise FolderError, before anything is computed, if a file of the user's would be overwritten."""
    if path is None:
        return
    if os.path.lexists(path):  # a link that leads nowhere, too
        raise FolderError(f"{path} exists; give {option} a new file.")
    if not path.parent.is_dir():
        raise FolderError(f"{path} is in no folder that there is; give {option} a new file.")
    if not os.access(path.parent, os.W_OK):
        raise FolderError(f"{path} is in a folder that cannot be written to; give {option} a new file.")
