"""The files of a run folder, and the creation of new folders."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..errors import FolderError

SERIES, EVENTS, MANIFEST, RESULT = "series.arrow", "events.jsonl", "manifest.json", "result.json"
ESTIMATES, CSV, LATENCIES = "estimates.ssv", "series.csv", "latencies.json"
CHECKPOINT, LOCK = "checkpoint.bin", "lock"


@dataclass(frozen=True)
class RunFile:
    """A file of a run folder."""

    name: str
    """File name."""
    content: str
    """Description of its content, in a line."""
    is_made_at_end: bool = False
    """True where it is written at the end of a run; a run that starts or is resumed removes an earlier one."""
    is_required: bool = False
    """True where a run that has ended cannot be read without it."""
    is_sealed: bool = True
    """True where the manifest of a run that has ended holds its SHA-256."""


RUN_FILES: Final = (
    RunFile(MANIFEST, "scenario, seed, versions, hashes of FMUs, modules and of the files here", is_sealed=False),
    RunFile(SERIES, "variables at every communication point, a compressed Arrow IPC stream", is_required=True),
    RunFile(EVENTS, "what re-tuning did and why, an event a line"),
    RunFile(RESULT, "the run's figures", is_made_at_end=True, is_required=True),
    RunFile(
        LATENCIES, "wall time of each evaluation [s], a list a macro step that had any: no two runs agree in them",
        is_made_at_end=True, is_required=True,
    ),
    RunFile(ESTIMATES, "what the controller holds in the end, for SSP tools", is_made_at_end=True),
    RunFile(CSV, "the series of a short run once more, as text", is_made_at_end=True),
    RunFile(CHECKPOINT, "where a run that was left goes on", is_sealed=False),
    RunFile(LOCK, "which command is at work here", is_sealed=False),
)  # fmt: skip
"""All files of a run folder but its pictures. A new file needs a row here, and code that writes it."""
MADE_AT_END: Final = tuple(file.name for file in RUN_FILES if file.is_made_at_end)
REQUIRED: Final = tuple(file.name for file in RUN_FILES if file.is_required)
SEALED: Final = tuple(file.name for file in RUN_FILES if file.is_sealed)


_OWNER: Final = re.compile(rb"(process \d+ on [^\n]*)?")
_LONGEST_OWNER: Final = 1000


def new_run_folder(scenario: str, out: Path | None) -> Path:
    """Make the run folder: `out`, which must be absent or empty, or the next free runs/SCENARIO-n.

    A lock with only empty folders beside it, as a command leaves that was killed before it wrote anything, counts as
    empty; `locked` checks whether a command still holds it. Raises FolderError.
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
    """Return whether the path is a lock file, and not a user's file of that name. Raises OSError."""
    if path.is_symlink() or not path.is_file():
        return False
    with open(path, "rb") as file:
        return _OWNER.fullmatch(file.read(_LONGEST_OWNER)) is not None
