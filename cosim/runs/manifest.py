"""The manifest of a run folder: scenario, versions, status, and hashes that show whether the files are unchanged."""

import hashlib
import json
import os
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

from pydantic import TypeAdapter, ValidationError

from ..errors import FolderError, one_line
from ..files import readable, sha256, to_json, write_json
from ..scenarios.scenario import Scenario
from ..system.plant import Plant
from ..user_code import CodeOrigin
from .run_files import MANIFEST
from .signature import is_signed, signature_of

Status = Literal["done", "diverged", "faulted", "interrupted", "running", "unfinished"]
"""Status of a run; the last two only of a folder, whose run goes on in another process or was killed."""
PACKAGES: Final = ("fmu-retune", "fmpy", "pythonfmu", "numpy", "scipy", "GPy", "pyarrow")
_SEAL, _SIGNATURE = "seal", "signature"


@dataclass(frozen=True)
class Manifest:
    """The part of a manifest that is read."""

    status: Status
    """Status at the end of the run, or `running`."""
    estimator: str
    """Name of the estimator."""
    seed: int
    """Seed of noise and search."""
    plant: Plant
    """The component whose derivatives were sampled."""
    folder: Path
    """Folder of the scenario."""
    scenario: dict[str, Any]
    """Tables of the scenario."""
    fmus: dict[str, dict[str, str]] = field(default_factory=dict[str, dict[str, str]])
    """File and SHA-256 of each component."""
    modules: dict[str, str] = field(default_factory=dict[str, str])
    """SHA-256 of the user's Python files."""
    versions: dict[str, str] = field(default_factory=dict[str, str])
    """Versions of the packages."""
    sha256: dict[str, str] = field(default_factory=dict[str, str])
    """SHA-256 of the files of a run that has ended."""
    seal: str = ""
    """SHA-256 of the rest of the manifest; none in one of an older version."""
    signature: str = ""
    """Signature of that, of a run whose Python code is the user's."""


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a run folder. Raises FolderError."""
    read_json(folder, MANIFEST, Manifest)
    content = json.loads((folder / MANIFEST).read_bytes())
    _check_seal(folder, content)
    return TypeAdapter(Manifest).validate_json(json.dumps(content))  # of what the hash is of, however it was written


def scenario_of(folder: Path, manifest: Manifest) -> Scenario:
    """Return the scenario of a run folder's manifest: a stranger's, unless this user made the run. Raises FolderError.

    Of the user's own only the modules as they were then are loaded.
    """
    is_own = is_signed(manifest.seal, manifest.signature)
    origin = CodeOrigin(files=manifest.modules) if is_own else CodeOrigin(str(folder))
    try:
        return Scenario.model_validate(manifest.scenario | {"folder": manifest.folder, "origin": origin})
    except ValidationError as e:
        raise FolderError(f"{folder} holds a scenario of another version: {_first(e)}.") from e


def _check_seal(folder: Path, content: Mapping[str, Any]) -> None:
    """Raise FolderError for a manifest that is not as it was written; one of an older version has no seal."""
    if content.get(_SEAL, _digest(content)) != _digest(content):
        raise FolderError(f"{folder} is damaged: {MANIFEST} is not as it was written.")


def read_sealed(folder: Path, name: str) -> tuple[dict[str, Any], bool]:
    """Return what write_manifest has written under a name, and whether it is this user's. Raises FolderError."""
    content = read_json(folder, name, dict[str, Any])
    seal = _digest(content)
    if content.get(_SEAL) != seal:
        raise FolderError(f"{folder} is damaged: {name} is not as it was written.")
    return content, is_signed(seal, str(content.get(_SIGNATURE, "")))


def write_manifest(folder: Path, content: Mapping[str, Any], is_own: bool, name: str = MANIFEST) -> None:
    """Write the manifest, with the SHA-256 of its own content. Raises FolderError.

    is_own: whether the Python code that it names is the user's; it is signed then.
    """
    seal = _digest(json.loads(to_json(content)))
    signature = signature_of(seal) if is_own else ""
    write_json(folder / name, {**content, _SEAL: seal, _SIGNATURE: signature})


def check_whole(folder: Path) -> None:
    """Raise FolderError where a file of a run that has ended is not as it was written; of any kind of run."""
    content = read_json(folder, MANIFEST, dict[str, Any])
    _check_seal(folder, content)
    digests = content.get("sha256", {})
    for name in digests:
        check_file(folder, name, digests)


def is_signed_run(folder: Path) -> bool:
    """Return whether a run folder's manifest has a signature, without which later commands take it for a stranger's."""
    return bool(read_json(folder, MANIFEST, dict[str, Any]).get(_SIGNATURE))


def check_file(folder: Path, name: str, digests: Mapping[str, str]) -> None:
    """Raise FolderError for a file that has not the SHA-256 of the manifest; a file without one there always passes."""
    try:
        is_whole = name not in digests or sha256(folder / name) == digests[name]
    except OSError as e:
        raise FolderError(f"{folder} is damaged: cannot read {name}: {e.strerror or e}.") from e
    if not is_whole:
        raise FolderError(f"{folder} is damaged: {name} is not as it was written.")


def versions() -> dict[str, str]:
    """Return the versions of Python and of all packages on which the bits of a run depend."""
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


def modules(folder: Path) -> dict[str, str]:
    """Return the SHA-256, by file, of loaded modules from where a scenario's model and estimator may be."""
    loaded = {file for module in list(sys.modules.values()) if (file := getattr(module, "__file__", None))}
    places = tuple(os.path.normcase(place / "_")[:-1] for place in (folder.resolve(), Path.cwd()))
    installed = os.path.normcase(Path(sys.prefix) / "_")[:-1]
    near = (Path(f) for f in loaded if (at := os.path.normcase(f)).startswith(places) and not at.startswith(installed))
    own = (f for f in near if f.suffix == ".py" and not {"site-packages", "dist-packages"}.intersection(f.parts))
    return {str(file): sha256(file) for file in sorted(own) if file.is_file()}


_T = TypeVar("_T")


def read_json(folder: Path, name: str, kind: type[_T]) -> _T:
    """Return the content of a JSON file. Raises FolderError."""
    try:
        return TypeAdapter(kind).validate_json(readable(folder / name).read_bytes())
    except OSError as e:
        raise FolderError(f"{folder} is no run folder: cannot read {name}: {e.strerror or e}.") from e
    except ValidationError as e:
        raise FolderError(f"{folder} holds no readable run: {name}: {_first(e)}.") from e


def _first(error: ValidationError) -> str:
    found = error.errors()[0]
    return one_line(": ".join([*map(str, found["loc"]), found["msg"]]))


def _digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of JSON values, independent of the order of their keys."""
    rest = {key: value for key, value in content.items() if key not in (_SEAL, _SIGNATURE)}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
