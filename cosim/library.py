"""The FMUs that come with the package: built once, kept in the user's cache under their guid."""

import os
from pathlib import Path

from platformdirs import user_cache_path

from fmu_models.build import NAMES, build, guid

from .errors import ScenarioError
from .names import did_you_mean


def find_fmu(fmu: str, folder: Path) -> Path:
    """The file of a built-in FMU's name (built where the cache lacks it), or of a path relative to folder.

    Raises ScenarioError.
    """
    if fmu in NAMES:
        return _cached(fmu)
    path = folder / fmu
    if not path.is_file():
        known = f"; built-in FMUs are {', '.join(NAMES)}" if path.suffix != ".fmu" else ""
        raise ScenarioError(f"no FMU '{fmu}': {path} is not a file{did_you_mean(fmu, NAMES) or known}.")
    return path


def _cached(name: str) -> Path:
    cache = Path(os.environ.get("FMU_RETUNE_CACHE") or user_cache_path("fmu-retune"))
    folder = cache / "fmus" / guid(name)
    path = folder / f"{name}.fmu"
    if path.is_file():
        return path
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return build(name, folder)
    except OSError as e:
        raise ScenarioError(f"cannot build {name}.fmu in {folder}: {e.strerror or e}; set FMU_RETUNE_CACHE.") from e
