"""Unfinished runs in folders: checks that they can be resumed, and from where."""

from dataclasses import dataclass
from pathlib import Path

from ..errors import CosimError, FolderError, NotResumableError
from ..files import sha256
from ..system.fmu_cache import fmu_paths
from .append_file import EMPTY, Prefix
from .checkpoint import Checkpoint, read_checkpoint
from .manifest import Manifest, read_manifest, scenario_of, versions
from .record import Place
from .run_files import CHECKPOINT, EVENTS, MADE_AT_END, MANIFEST, SERIES
from .series import read_series


def has_begun(folder: Path) -> bool:
    """Return whether the folder may hold a run."""
    return (folder / MANIFEST).exists()


def has_ended(folder: Path) -> bool:
    """Return whether the folder holds a run that is complete. Raises FolderError."""
    return has_begun(folder) and read_manifest(folder).status in ("done", "diverged")


def why_not_resumable(folder: Path) -> str | None:
    """Return the reason why the run of a folder cannot be resumed, without a full stop; None where it can."""
    try:
        read_unfinished(folder)
    except CosimError as e:
        return str(e).rstrip(".")
    return None


@dataclass(frozen=True)
class Unfinished:
    """An unfinished run that can be resumed."""

    manifest: Manifest
    """Manifest of the run."""
    checkpoint: Checkpoint | None
    """Last checkpoint; None where no row is recorded yet."""

    @property
    def place(self) -> Place:
        """Point of the record from which it is continued."""
        return self.checkpoint.place if self.checkpoint else Place(EMPTY, EMPTY)


def read_unfinished(folder: Path) -> Unfinished:
    """Return the unfinished run of a folder, which is only read.

    Raises FolderError for a folder that holds no run or a damaged one; NotResumableError where the run cannot be
    resumed bit for bit: it has ended, it has no checkpoint, or what it depends on has changed.
    """
    manifest = read_manifest(folder)
    for name in MADE_AT_END:  # anew
        if (folder / name).exists() and not (folder / name).is_file():
            raise FolderError(f"{folder} is damaged: {name} is not a file.")
    if manifest.status in ("done", "diverged"):
        raise NotResumableError(f"it is {manifest.status}")
    now = versions()
    for name, version in manifest.versions.items():
        if now.get(name) != version:
            raise NotResumableError(f"it was begun with {name} {version}, and this is {now.get(name, 'without')}")
    components = fmu_paths(scenario_of(folder, manifest))
    files = {Path(file): digest for file, digest in manifest.modules.items()}
    files |= {path: manifest.fmus.get(name, {}).get("sha256", "") for name, path in components.items()}
    for path, digest in files.items():
        if not path.is_file() or sha256(path) != digest:
            raise NotResumableError(f"{path} has changed since it was begun")
    try:
        checkpoint = read_checkpoint(folder)
    except NotResumableError:
        if (folder / CHECKPOINT).exists() or _has_rows(folder):
            raise
        return Unfinished(manifest, None)
    for name, prefix in ((SERIES, checkpoint.place.series), (EVENTS, checkpoint.place.events)):
        _check(folder, name, prefix)
    return Unfinished(manifest, checkpoint)


def _has_rows(folder: Path) -> bool:
    try:
        return any(map(len, read_series(folder).values()))
    except FolderError:  # killed before the first word of it
        return False


def _check(folder: Path, name: str, prefix: Prefix) -> None:
    """Raise FolderError for a file that does not begin with its content at the checkpoint."""
    try:
        is_whole = prefix.digest_of(folder / name) is not None
    except OSError as e:
        raise FolderError(f"{folder} is damaged: cannot read {name}: {e.strerror or e}.") from e
    if not is_whole:
        raise FolderError(f"{folder} is damaged: {name} is not as it was written.")
