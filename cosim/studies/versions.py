"""Versions that the bits of a run depend on: of Python, of the packages, and of this package's own sources."""

import hashlib
from functools import cache
from pathlib import Path

import estimator
import fmu_models

from ..runs.manifest import versions

OURS = (Path(__file__).parents[1], *(Path(module.__file__ or "").parent for module in (estimator, fmu_models)))
"""Folders of our own packages."""


@cache
def all_versions() -> dict[str, str]:
    """Return the versions of Python and the packages, and the SHA-256 of our sources, which a checkout changes."""
    digest = hashlib.sha256()
    for folder in OURS:
        for path in sorted(folder.rglob("*.py")):
            digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return versions() | {"sources": digest.hexdigest()[:16]}
