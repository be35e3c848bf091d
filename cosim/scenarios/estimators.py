"""Estimators by name, for a scenario: ours, and classes of the user's."""

import importlib
import importlib.util
import sys
from dataclasses import dataclass
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import numpy as np

from estimator import METHODS, AskTell, Method, Solver, Vector

from ..errors import USERS, ScenarioError
from ..names import did_you_mean
from .scenario import Scenario
from .schema import Loop

ESTIMATORS = (*METHODS, "none", "true")
"""`none` leaves the controller alone; `true` is the floor: it writes the plant's true parameters."""
_INSTALL = {"cyipopt": "Ipopt: pip install 'fmu-retune[ipopt]'; 'ipm-scipy' does without"}


def find_method(name: str, scenario: Scenario) -> Method:
    """The estimator of that name: one of ours, or the class that `module:Class` names.

    Raises ScenarioError for an unknown name, and for an estimator that the scenario or this machine lacks something of.
    """
    if ":" not in name and name not in METHODS:
        known = f"; the estimators are {', '.join(ESTIMATORS)}, or package.module:Class."
        raise ScenarioError(f"no estimator '{name}'{did_you_mean(name, ESTIMATORS) or known}")
    method = _user_method(name, scenario) if ":" in name else METHODS[name]
    if method.needs_package and not importlib.util.find_spec(method.needs_package):
        raise ScenarioError(f"estimator '{name}' needs {_INSTALL.get(method.needs_package, method.needs_package)}.")
    if method.needs_linear_form and scenario.estimation.linear is None:
        raise ScenarioError(f"estimator '{name}' needs estimation.linear, the model's linear form.")
    return method


def check_estimator(name: str, scenario: Scenario) -> None:
    """Raises ScenarioError for a name that is none of `ESTIMATORS`, and what `find_method` raises."""
    if name not in ("none", "true"):
        find_method(name, scenario)


def load(reference: str, folder: Path, key: str = "estimation.model") -> Any:
    """What `module:name` names; modules beside the scenario and in the working directory are found too.

    Raises ScenarioError, which names the key.
    """
    module_name, _, name = reference.partition(":")
    places = [str(folder.resolve()), str(Path.cwd())]
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
    """Let go of a module of that name that came from beside another scenario: here it is another one."""
    spec = getattr(sys.modules.get(name), "__spec__", None)
    here = PathFinder.find_spec(name, places)
    if spec is None or here is None or None in (spec.origin, here.origin) or spec.origin == here.origin:
        return
    folder = Path(spec.origin).parent if spec.submodule_search_locations is None else Path(spec.origin).parents[1]
    if str(folder) in sys.path:  # of an installed package, of the standard library, of the user's program
        return
    for loaded in [m for m in sys.modules if m == name or m.startswith(f"{name}.")]:
        del sys.modules[loaded]


@dataclass(frozen=True)
class _NoSettings:
    """Of a user's estimator that has none."""


def _user_method(name: str, scenario: Scenario) -> Method:
    found = load(name, scenario.folder, "estimator")
    if not isinstance(found, type):
        raise ScenarioError(f"estimator '{name}' must be a class, got {type(found).__name__}.")
    method = Method(
        found,
        getattr(found, "Settings", _NoSettings),
        defaults=getattr(found, "defaults", {}),
        needs_linear_form=getattr(found, "needs_linear_form", False),
    )
    try:
        scenario.estimation.check_method(name, method)
    except (TypeError, ValueError) as e:
        raise ScenarioError(f"{str(e).rstrip('.')}.") from e
    return method


def make_estimator(
    name: str, method: Method, scenario: Scenario, start: Vector, rng: np.random.Generator
) -> tuple[AskTell | Solver, Loop]:
    """An estimator beginning at theta (d,), and the loop's settings for it. Raises ScenarioError."""
    estimation = scenario.estimation
    own = None if name in METHODS else method
    try:
        made = method.estimator(estimation.space, start, rng, estimation.settings(name, own))
    except USERS as e:
        raise ScenarioError(f"estimator '{name}' cannot be made: {type(e).__name__}: {e}.") from e
    if not isinstance(made, AskTell | Solver):
        raise ScenarioError(
            f"estimator '{name}' must have is_whitened, restart and estimate, and ask and tell or solve: "
            "see estimator/contract.py."
        )
    return made, estimation.loop(name, own)
