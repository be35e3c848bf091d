"""The files of a run folder, and how a new folder is made."""

import re
from pathlib import Path
from typing import Final

from ..errors import FolderError

SERIES, EVENTS, MANIFEST, RESULT = "series.arrow", "events.jsonl", "manifest.json", "result.json"


ESTIMATES, CSV = "estimates.ssv", "series.csv"


CHECKPOINT, LOCK = "checkpoint.bin", "lock"


LATENCIES = "latencies.json"
"""Wall time of each evaluation [s], a list a macro step that had any: no two runs agree in them."""


_OWNER: Final = re.compile(rb"(process \d+ on [^\n]*)?")


_LONGEST_OWNER: Final = 1000


def new_run_folder(scenario: str, out: Path | None) -> Path:
    """Make the run folder: `out`, which must be absent or empty, or the next free runs/SCENARIO-n.

    What a command that was killed before it had written anything leaves is nothing: its lock, and empty folders beside
    it. Whether that is a living command's, `locked` says. Raises FolderError.
    """
    try:
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
            if not _is_empty(out):
                raise FolderError(f"{out} is not empty; give --out a new or empty folder.")
            return out
        for n in range(1, 1_000_000):
            folder = Path("runs") / f"{scenario}-{n}"
            try:
                folder.mkdir(parents=True)
            except FileExistsError:
                continue
            return folder
    except OSError as e:
        raise FolderError(f"cannot make the run folder {out or 'runs'}: {e.strerror or e}.") from e
    raise FolderError("runs/ holds a million runs of this scenario.")


def _is_empty(folder: Path) -> bool:
    others = [path for path in folder.iterdir() if path.name != LOCK]
    if not (folder / LOCK).is_symlink() and not (folder / LOCK).exists():
        return not others
    return is_lock(folder / LOCK) and all(p.is_dir() and not p.is_symlink() and not any(p.iterdir()) for p in others)


def is_lock(path: Path) -> bool:
    """Whether this is a lock file, and not something of the user's of that name. Raises OSError."""
    if path.is_symlink() or not path.is_file():
        return False
    with open(path, "rb") as file:
        return _OWNER.fullmatch(file.read(_LONGEST_OWNER)) is not None
