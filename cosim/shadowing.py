"""Checks for user files with the name of one of our packages, which hide it or are hidden by it."""

from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import Final

_PACKAGES: Final = ("cosim", "estimator", "fmu_models")
_INSTALLED: Final = Path(__file__).resolve().parents[1]
"""The folder that our packages stand in, side by side."""


def check_packages() -> None:
    """Raise ImportError, in one line, where Python would import something else under the name of our packages."""
    for name in _PACKAGES:
        found = _place(find_spec(name))
        if found is not None and found != _INSTALLED / name:
            raise ImportError(f"{found} hides the package '{name}' of fmu-retune: rename it.", name=name)


def namesake(module: str, folders: Sequence[str]) -> Path | None:
    """Return the user's file or folder in these folders that would be imported as one of our packages, or None."""
    name = module.partition(".")[0]
    if name not in _PACKAGES:
        return None
    found = _place(PathFinder.find_spec(name, folders))
    return None if found == _INSTALLED / name else found


def _place(spec: ModuleSpec | None) -> Path | None:
    """Return the file of a module, or the folder of a package; None where there is neither."""
    if spec is None:
        return None
    folder = next(iter(spec.submodule_search_locations or ()), None)
    place = folder or spec.origin
    return Path(place).resolve() if place else None
