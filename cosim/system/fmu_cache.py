"""Cache of the FMUs that come with the package: built once, kept in the user's cache under their guid."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from platformdirs import user_cache_path

from fmu_models.build import NAMES, PLANTS, Interface, build, build_all, guid

from ..errors import FolderError, ScenarioError, told_at
from ..files import write_bytes
from ..fmi.folder import PrivateFolder
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..scenarios.schema.simulation import ComponentSettings


def find_fmu(fmu: str, folder: Path, fmi: int = 2, interface: Interface = "CoSimulation") -> Path:
    """Return the file of a built-in FMU (built where the cache lacks it), or of a path relative to folder.

    fmi (2 or 3) and interface are those of a built-in FMU. Raises ScenarioError.
    """
    names = PLANTS if interface == "ModelExchange" else NAMES
    if fmu in names:
        return _cached(fmu, fmi, interface)
    path = folder / fmu
    if not path.is_file():
        _refuse_blank(fmu)
        if Path(fmu).is_file():  # beside the user, not beside the scenario
            raise ScenarioError(f"no FMU '{fmu}': {path} is not a file; the one here is {Path(fmu).resolve()}")
        known = f"; built-in FMUs are {', '.join(names)}" if path.suffix != ".fmu" else ""
        raise ScenarioError(f"no FMU '{fmu}': {path} is not a file{did_you_mean(fmu, names) or known}")
    return path


def _refuse_blank(name: str) -> None:
    """Raise ScenarioError for a name that `retune new` has left to fill in."""
    if Path(name).stem == "FILL":
        raise ScenarioError(f"'{name}' is still to be filled in: name a file, relative to the scenario's folder")


def find_table(table: str, folder: Path) -> Path:
    """Return the CSV file of a path relative to folder. Raises ScenarioError."""
    path = folder / table
    if not path.is_file():
        _refuse_blank(table)
        raise ScenarioError(f"no table '{table}': {path} is not a file.")
    return path


def cache_folder() -> Path:
    """Return the folder in which built FMUs and unpacked packages are kept."""
    return Path(os.environ.get("FMU_RETUNE_CACHE") or user_cache_path("fmu-retune"))


def _cached(name: str, fmi: int, interface: Interface) -> Path:
    folder = cache_folder() / "fmus" / guid(name, fmi, interface)
    path = folder / f"{name}.fmu"
    if path.is_file():
        return path
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with PrivateFolder() as staging:  # what a killed process leaves there is removed
            write_bytes(path, build(name, staging, fmi, interface).read_bytes())
    except (OSError, FolderError) as e:
        cause = e if isinstance(e, OSError) else e.__cause__
        reason = getattr(cause, "strerror", None) or e
        raise ScenarioError(f"cannot build {name}.fmu in {folder}: {reason}; set FMU_RETUNE_CACHE.") from cause
    return path


def build_into(
    folder: Path, is_forced: bool, builder: Callable[[Path], Mapping[str, Path]] = build_all
) -> list[tuple[Path, str]]:
    """Build FMUs, by default every built-in one, into a folder of the user's.

    Returns each file with its state: built, unchanged or replaced. builder: makes the FMUs in a given folder, and
    returns their paths by name.

    Each file appears whole or not at all. Raises FolderError before anything is written where a different file is in
    the way and is_forced is not set, and where the folder cannot be written.
    """
    try:
        with PrivateFolder() as staging:
            built = builder(Path(staging))
            targets = {name: folder / path.name for name, path in built.items()}
            states = {name: _state(path, targets[name]) for name, path in built.items()}
            in_the_way = next((targets[name] for name, state in states.items() if state == "replaced"), None)
            if in_the_way and not is_forced:
                raise FolderError(f"{in_the_way} exists and differs; give --force or another --out.")
            folder.mkdir(parents=True, exist_ok=True)
            for name, path in built.items():
                if states[name] != "unchanged":
                    write_bytes(targets[name], path.read_bytes())
    except OSError as e:
        raise FolderError(f"cannot build into {folder}: {e.strerror or e}.") from e
    return [(targets[name], states[name]) for name in built]


def _state(built: Path, target: Path) -> str:
    if not target.exists():
        return "built"
    return "unchanged" if target.is_file() and target.read_bytes() == built.read_bytes() else "replaced"


def fmu_paths(scenario: Scenario) -> dict[str, Path]:
    """Return the file of each component's FMU, built where need be, or table. Raises ScenarioError."""
    paths: dict[str, Path] = {}
    for name, component in scenario.components.items():
        with told_at(f"components.{name}.{component.file_key}"):
            paths[name] = component_path(component, scenario.folder)
    return paths


def component_path(component: ComponentSettings, folder: Path) -> Path:
    """Return the file of a component's FMU, built where need be, or table. Raises ScenarioError."""
    if component.fmu is not None:
        return find_fmu(component.fmu, folder, component.fmi)
    return find_table(component.file, folder)
