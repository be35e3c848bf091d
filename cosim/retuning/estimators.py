"""Estimators of a scenario by name: those of the package, and classes of the user."""

import importlib
import importlib.util
from dataclasses import dataclass

import numpy as np

from estimator import METHODS, AskTell, Method, Solver, Vector
from estimator.methods import method_named

from ..errors import ScenarioError
from ..names import did_you_mean
from ..objectives.choice import chosen
from ..scenarios.scenario import Scenario
from ..scenarios.schema.estimation import LoopSettings, is_former_method
from ..user_code import USERS, load

ESTIMATORS = (*METHODS, "none", "true")
"""`none` leaves the controller alone; `true` is the floor: it writes the plant's true parameters."""
_INSTALL = {"cyipopt": "Ipopt: pip install 'fmu-retune[ipopt]'; 'ipm-scipy' does without"}


def find_method(name: str, scenario: Scenario) -> Method:
    """Return the estimator of that name: one of the package, or the class that `module:Class` names.

    Raises ScenarioError for an unknown name, and where the scenario or this machine lacks something that it needs.
    """
    if ":" not in name and name not in METHODS and not is_former_method(name):
        known = f"; the estimators are {', '.join(ESTIMATORS)}, or package.module:Class."
        raise ScenarioError(f"no estimator '{name}'{did_you_mean(name, ESTIMATORS) or known}")
    method = _user_method(name, scenario) if ":" in name else method_named(name)
    if method.needs_package and not importlib.util.find_spec(method.needs_package):
        raise ScenarioError(f"estimator '{name}' needs {_INSTALL.get(method.needs_package, method.needs_package)}.")
    if method.needs_linear_form and scenario.estimation.linear is None:
        raise ScenarioError(f"estimator '{name}' needs estimation.linear, the model's linear form.")
    return method


def check_estimator(name: str, scenario: Scenario) -> None:
    """Raise ScenarioError for a name that is none of `ESTIMATORS`, and what `find_method` raises."""
    if name not in ("none", "true"):
        find_method(name, scenario)


@dataclass(frozen=True)
class _NoSettings:
    """Settings of a user's estimator that has none."""


def _user_method(name: str, scenario: Scenario) -> Method:
    found = load(name, scenario.folder, "estimator", scenario.origin)
    if not isinstance(found, type):
        raise ScenarioError(f"estimator '{name}' must be a class, got {type(found).__name__}.")
    method = Method(
        found,
        getattr(found, "Settings", _NoSettings),
        defaults=getattr(found, "defaults", {}),
        needs_linear_form=getattr(found, "needs_linear_form", False),
        jumps=hasattr(found, "jump"),
    )
    try:
        scenario.estimation.check_method(name, method)
    except (TypeError, ValueError) as e:
        raise ScenarioError(f"{str(e).rstrip('.')}.") from e
    return method


def make_estimator(
    name: str, method: Method, scenario: Scenario, start: Vector, rng: np.random.Generator
) -> tuple[AskTell | Solver, LoopSettings]:
    """Return an estimator that starts at start (d,), and the loop's settings for it. Raises ScenarioError."""
    estimation = scenario.estimation
    own = method if ":" in name else None
    try:
        made = method.estimator(estimation.space, start, rng, estimation.settings(name, own))
    except USERS as e:
        raise ScenarioError(f"estimator '{name}' cannot be made: {type(e).__name__}: {e}.") from e
    if not isinstance(made, AskTell | Solver):
        raise ScenarioError(
            f"estimator '{name}' must have is_whitened, restart and estimate, and ask and tell or solve: "
            "see estimator/contract.py."
        )
    return made, estimation.loop(name, own, chosen(scenario).kind == "derivative")
