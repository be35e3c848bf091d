"""Loading of user code from beside a scenario or from the working directory, and never a stranger's unasked."""

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any, Final

from .errors import ScenarioError
from .files import sha256
from .shadowing import namesake


@dataclass(frozen=True)
class CodeOrigin:
    """Owner of the Python code that a scenario names: the user, unless it came in somebody else's file.

    It is no part of what the scenario says: scenarios of different owners may be equal.
    """

    stranger: str = field(default="", compare=False)
    """That file or folder, as the user gave it; empty for the user's own."""
    own: frozenset[str] = field(default=frozenset(), compare=False)
    """References and keys that the user has given beside that file: those are the user's all the same."""
    files: Mapping[str, str] | None = field(default=None, compare=False)
    """SHA-256 of the modules that the user ran the scenario with, by file; None where they may be any."""


OWN: Final = CodeOrigin()


def load(reference: str, folder: Path, key: str = "estimation.model", origin: CodeOrigin = OWN) -> Any:
    """Return the object that `module:name` names; also searches the folder of the scenario and the working directory.

    A module that a stranger's file names is not searched for, unless it is a built-in plant's. Raises ScenarioError,
    which names the key.
    """
    if not is_trusted(reference, origin):
        raise ScenarioError(f"{key}: '{reference}' is Python code that {origin.stranger} names: only --trust runs it.")
    module_name, _, name = reference.partition(":")
    places = places_of(reference, folder, origin)
    if (path := namesake(module_name, places)) is not None:
        raise ScenarioError(f"{key}: {path} has the name of a package of fmu-retune: rename it.")
    if is_built_in(reference):
        places = []
    elif reference not in origin.own and (changed := _changed(origin.files or {})) is not None:
        raise ScenarioError(f"{key}: {changed} is not as it was in the run: only --trust runs it as it is.")
    _forget(module_name.partition(".")[0], places)
    sys.path[:0] = places
    try:
        return getattr(importlib.import_module(module_name), name)
    except USERS as e:
        raise ScenarioError(f"{key}: cannot load '{reference}': {type(e).__name__}: {e}.") from e
    finally:
        for place in places:
            sys.path.remove(place)


def is_trusted(reference: str, origin: CodeOrigin) -> bool:
    """Return whether the code of a reference may run: it is the user's, or a built-in plant's."""
    return not origin.stranger or reference in origin.own or is_built_in(reference)


def is_built_in(reference: str) -> bool:
    """Return whether a reference is to a function of a built-in plant, such as `fmu_models.pendulum:derivative`."""
    package, _, plant = reference.partition(":")[0].partition(".")
    return package == "fmu_models" and plant.isidentifier() and (_PLANTS / plant / "equations.py").is_file()


_PLANTS: Final = Path(__file__).resolve().parents[1] / "fmu_models"


def places_of(reference: str, folder: Path, origin: CodeOrigin) -> list[str]:
    """Return the folders in which a trusted reference is searched for before those of Python's path."""
    here, there, files = str(folder.resolve()), Path.cwd(), origin.files
    if origin.stranger:  # in whose folder there may be a module of any name
        return [] if is_built_in(reference) else [str(there)]
    if files is None or reference in origin.own or any(there in Path(file).parents for file in files):
        return [here, str(there)]
    return [here]  # the run was made elsewhere, and who knows what lies here


def _changed(files: Mapping[str, str]) -> str | None:
    """Return the first file that is not as it was, or is gone; else None."""
    for file, digest in files.items():
        try:
            is_same = sha256(Path(file)) == digest
        except OSError:
            is_same = False
        if not is_same:
            return file
    return None


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
