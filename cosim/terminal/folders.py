"""Where a command writes: nothing that a user has is lost."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..errors import FolderError
from ..runs.lock import new_locked_folder
from ..runs.run_files import LOCK


@contextmanager
def new_folder(name: str, out: Path | None) -> Generator[Path]:
    """The folder to write in, nobody else's until the end; removed again where that fails before anything is in it.

    Raises FolderError where it is not empty, or another command's: nothing is changed then.
    """
    place = out or Path("runs")
    there = {path for path in (place, *place.parents) if path.exists()}
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
    """Remove the folders in it, where nothing is in any of them nor beside them."""
    below = [path for path in folder.iterdir() if path.name != LOCK]
    if all(path.is_dir() and not any(path.iterdir()) for path in below):
        for path in below:
            path.rmdir()


def must_be_new(path: Path | None, option: str) -> None:
    """Raises FolderError, before anything is computed, where a file of the user's would be lost."""
    if path is not None and (path.exists() or not path.parent.is_dir()):
        problem = "exists" if path.exists() else "is in no folder that there is"
        raise FolderError(f"{path} {problem}; give {option} a new file.")
