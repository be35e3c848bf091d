"""Whether a run folder holds what was written into it."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from .record import MANIFEST, FolderError, sha256, to_json, write_json

_SEAL: Final = "seal"


def write_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Write the manifest, with the SHA-256 of its own content. Raises FolderError."""
    write_json(folder / MANIFEST, {**content, _SEAL: _digest(json.loads(to_json(content)))})


def check_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Raises FolderError for a manifest that is not as it was written; one of an older version has no seal."""
    if content.get(_SEAL, _digest(content)) != _digest(content):
        raise FolderError(f"{folder} is damaged: {MANIFEST} is not as it was written.")


def check_file(folder: Path, name: str, digests: Mapping[str, str]) -> None:
    """Raises FolderError for a file that is not the one whose SHA-256 the manifest has; one of which it has none may
    be anything."""
    try:
        is_whole = name not in digests or sha256(folder / name) == digests[name]
    except OSError as e:
        raise FolderError(f"{folder} is damaged: cannot read {name}: {e.strerror or e}.") from e
    if not is_whole:
        raise FolderError(f"{folder} is damaged: {name} is not as it was written.")


def _digest(content: Mapping[str, Any]) -> str:
    """SHA-256 of JSON values, whatever their order."""
    rest = {key: value for key, value in content.items() if key != _SEAL}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
