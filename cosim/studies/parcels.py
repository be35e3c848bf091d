"""Files for workers that share no disk with the head: they travel once, by content hash, into a worker's own cache."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from ..errors import UnfinishedError
from ..fmi.table import is_table
from ..runs.manifest import modules
from ..scenarios.scenario import Scenario
from ..scenarios.trust import python_references
from ..system.fmu_cache import cache_folder, component_path, find_fmu
from ..system.package_cache import filled, hold
from ..user_code import is_built_in, load
from .recipe import Parcel
from .versions import OURS

SCENARIO, WORKING = "scenario", "working"
"""Folders of a parcel: that of the scenario, and the head's working directory, where modules of the user's may be."""


def own_references(scenario: Scenario, estimator_name: str) -> dict[str, str]:
    """Return the Python objects `module:name` of the user's that a run loads, by key."""
    references = python_references(scenario) | {"estimator": estimator_name}
    return {key: name for key, name in references.items() if ":" in name and not is_built_in(name)}


def own_modules(scenario: Scenario, references: Mapping[str, str]) -> dict[str, str]:
    """Return the SHA-256, by file, of the modules of the user's that references load. Raises ScenarioError."""
    for key, reference in references.items():
        load(reference, scenario.folder, key, scenario.origin)
    found = modules(scenario.folder) if references else {}
    return {file: digest for file, digest in found.items() if not any(map(Path(file).is_relative_to, OURS))}


def packed(
    scenario: Scenario, own: Mapping[str, str], digest_of: Mapping[Path, str]
) -> tuple[Scenario, Parcel, dict[str, Path]]:
    """Return the scenario as it is in a worker's folder, the parcel, and the head's file of each path in it.

    own: modules of the user's; digest_of: SHA-256 of the files of FMUs and tables.
    """
    tree = scenario.model_dump(mode="json")
    names = {path: f"{digest_of[path][:12]}/{path.name}" for path in files_of(scenario)}
    files = {f"{SCENARIO}/{name}": path for path, name in names.items()}
    for name, component in scenario.components.items():
        if (path := component_path(component, scenario.folder)) in names:
            tree["components"][name]["table" if is_table(path) else "fmu"] = names[path]
    for table, key in ((tree["estimation"], "model"), (tree["estimation"]["rollout"], "fmu")):
        if (path := scenario.folder / (table[key] or "")) in names:
            table[key] = names[path]
    there, here = scenario.folder.resolve(), Path.cwd()
    for file in map(Path, own):
        place, root = (SCENARIO, there) if file.is_relative_to(there) else (WORKING, here)
        files[f"{place}/{file.relative_to(root).as_posix()}"] = file
    digests = {name: own.get(str(path)) or digest_of[path] for name, path in sorted(files.items())}
    name = hashlib.sha256(json.dumps(digests).encode()).hexdigest()
    moved = Scenario.model_validate(tree | {"folder": Path(), "origin": scenario.origin})
    return moved, Parcel(digests, name), files


def unpacked(parcel: Parcel, files: Mapping[str, bytes] | None) -> Path | None:
    """Return the folder of a parcel in this machine's cache; None where it is not there and no files are given.

    Raises UnfinishedError where it cannot be written.
    """
    folder = cache_folder() / "studies" / parcel.name
    if files is None:
        return folder if hold(folder) else None

    def fill(stage: Path) -> None:
        for place in (SCENARIO, WORKING):
            (stage / place).mkdir()
        for name, content in files.items():
            if hashlib.sha256(content).hexdigest() != parcel.digests[name]:
                raise UnfinishedError(f"{name} has changed since the study began.")
            path = stage / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)

    try:
        return filled(folder, fill)
    except OSError as e:
        raise UnfinishedError(f"cannot write {folder}: {e.strerror or e}.") from e


def files_of(scenario: Scenario) -> list[Path]:
    """Return the files of FMUs and tables that a scenario names, without built-in ones. Raises ScenarioError."""
    found = [component_path(c, scenario.folder) for c in scenario.components.values()]
    settings = scenario.estimation
    if (settings.model or "").endswith(".fmu"):
        found.append(find_fmu(settings.model or "", scenario.folder, 3, "ModelExchange"))
    if settings.rollout.fmu is not None:
        found.append(find_fmu(settings.rollout.fmu, scenario.folder))
    return [path for path in dict.fromkeys(found) if not is_built(path)]


def is_built(path: Path) -> bool:
    """Return whether the file is a built-in FMU, in the cache in a folder with its guid's name."""
    return path.is_relative_to(cache_folder() / "fmus")
