"""Loading of user code from beside a scenario or from the working directory."""

import importlib
import sys
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, Final

from .errors import ScenarioError
from .shadowing import namesake


def load(reference: str, folder: Path, key: str = "estimation.model") -> Any:
    """Return the object that `module:name` names; also searches the folder of the scenario and the working directory.

    Raises ScenarioError, which names the key.
    """
    module_name, _, name = reference.partition(":")
    places = [str(folder.resolve()), str(Path.cwd())]
    if (path := namesake(module_name, places)) is not None:
        raise ScenarioError(f"{key}: {path} has the name of a package of fmu-retune: rename it.")
    _forget(module_name.partition(".")[0], places)
    sys.path[:0] = places
    try:
        return getattr(importlib.import_module(module_name), name)
    except USERS as e:
        raise ScenarioError(f"{key}: cannot load '{reference}': {type(e).__name__}: {e}.") from e
    finally:
        for place in places:
            sys.path.remove(place)


def _forget(name: str, places: list[str]) -> None:
    """Unload a module of that name that was loaded from the folder of another scenario."""
    spec = getattr(sys.modules.get(name), "__spec__", None)
    here = PathFinder.find_spec(name, places)
    if spec is None or here is None or None in (spec.origin, here.origin) or spec.origin == here.origin:
        return
    folder = Path(spec.origin).parent if spec.submodule_search_locations is None else Path(spec.origin).parents[1]
    if str(folder) in sys.path:  # of an installed package, of the standard library, of the user's program
        return
    for loaded in [m for m in sys.modules if m == name or m.startswith(f"{name}.")]:
        del sys.modules[loaded]


USERS: Final = (Exception, SystemExit, GeneratorExit)
"""Exceptions that user code may raise: all but KeyboardInterrupt."""
