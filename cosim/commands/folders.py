"""Where a command writes: nothing that a user has is lost."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from ..results.record import FolderError, new_run_folder


@contextmanager
def new_folder(name: str, out: Path | None) -> Generator[Path]:
    """The folder to write in, removed again where that fails before anything is in it."""
    place = out or Path("runs")
    there = {path for path in (place, *place.parents) if path.exists()}
    folder = new_run_folder(name, out)
    try:
        yield folder
    except BaseException:
        below = list(folder.iterdir())
        if not any(path.is_file() or any(path.iterdir()) for path in below):
            for path in below:
                path.rmdir()
        for path in (folder, *folder.parents):
            if path in there or any(path.iterdir()):
                break
            path.rmdir()
        raise


def must_be_new(path: Path | None, option: str) -> None:
    """Raises FolderError, before anything is computed, where a file of the user's would be lost."""
    if path is not None and (path.exists() or not path.parent.is_dir()):
        problem = "exists" if path.exists() else "is in no folder that there is"
        raise FolderError(f"{path} {problem}; give {option} a new file.")
