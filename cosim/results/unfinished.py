"""Run folders that were left before their run was done: whether it can go on, and from where."""

from pathlib import Path

from ..errors import NotResumableError
from ..scenarios.system import fmu_paths
from .checkpoint import Checkpoint, read_checkpoint
from .record import EVENTS, SERIES, FolderError, sha256
from .result import Manifest, read_manifest, scenario_of, versions


def read_unfinished(folder: Path) -> tuple[Manifest, Checkpoint]:
    """What was run, and how far it had come. Nothing but reading is done.

    Raises FolderError for a folder that holds no run or a damaged one; NotResumableError where the same bits cannot
    be had: the run has ended, it has no checkpoint, or what it depends on has changed.
    """
    manifest = read_manifest(folder)
    if manifest.status in ("done", "diverged"):
        raise NotResumableError(f"it is {manifest.status}")
    checkpoint = read_checkpoint(folder)
    now = versions()
    for name, version in manifest.versions.items():
        if now.get(name) != version:
            raise NotResumableError(f"it was begun with {name} {version}, and this is {now.get(name, 'without')}")
    files = {path: manifest.fmus[name]["sha256"] for name, path in fmu_paths(scenario_of(folder, manifest)).items()}
    for path, digest in {**files, **{Path(file): digest for file, digest in manifest.modules.items()}}.items():
        if not path.is_file() or sha256(path) != digest:
            raise NotResumableError(f"{path} has changed since it was begun")
    for name, prefix in ((SERIES, checkpoint.place.series), (EVENTS, checkpoint.place.events)):
        try:
            if prefix.digest_of(folder / name) is None:
                raise FolderError(f"{folder} is damaged: {name} is not as it was written.")
        except OSError as e:
            raise FolderError(f"{folder} is damaged: cannot read {name}: {e.strerror or e}.") from e
    return manifest, checkpoint
