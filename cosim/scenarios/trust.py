"""Trust in what a scenario from somebody else's file asks for: Python code, and more than FMUs are granted by default.

A scenario that the user names is a program of the user's. One in an SSP package, or in the manifest of a run folder
that was not made by this user, is a stranger's: what is listed here it gets only when the user says so.
"""

from dataclasses import replace
from typing import Final

from ..errors import ScenarioError
from ..user_code import OWN, is_trusted
from .scenario import Scenario
from .schema.simulation import SimulationSettings

GRANTS: Final = {
    "isolation": "load its FMUs into retune's own process",
    "environment": "give its FMUs more of the environment",
    "most_components": "start more FMUs than usual",
}
"""Keys of the table `scenario` that grant the FMUs something unless they have their defaults, in words."""


def python_references(scenario: Scenario) -> dict[str, str]:
    """Return the Python objects `module:name` that a scenario names, by key."""
    settings = scenario.estimation
    named = {"estimation.model": settings.model or "", "estimation.objective": settings.objective}
    if settings.linear is not None:
        named |= {"estimation.linear.rows": settings.linear.rows}
        named |= {"estimation.linear.coefficients": settings.linear.coefficients}
    named |= {f'estimation.parameters: writes "{name}"': text for name, text in scenario.formulas.items()}
    return {key: name for key, name in named.items() if ":" in name and not name.endswith(".fmu")}


def distrusted(scenario: Scenario, estimator: str = "") -> list[str]:
    """Return what a stranger's scenario would do that the user has not asked for, in words; nothing of the user's own.

    estimator: name of one that the stranger's file names too.
    """
    origin = scenario.origin
    if not origin.stranger:
        return []
    names = [name for name in (*python_references(scenario).values(), estimator) if ":" in name]
    modules = dict.fromkeys(name.partition(":")[0] for name in names if not is_trusted(name, origin))
    code = [f"run Python code ({'modules' if len(modules) > 1 else 'module'} {', '.join(modules)})"] if modules else []
    fields = SimulationSettings.model_fields
    asked = [key for key in GRANTS if getattr(scenario.scenario, key) != fields[key].default]
    return code + [GRANTS[key] for key in asked if f"scenario.{key}" not in origin.own]


def check_trust(scenario: Scenario, estimator: str = "") -> None:
    """Raise ScenarioError, in one line, for what `distrusted` returns."""
    if found := distrusted(scenario, estimator):
        raise ScenarioError(
            f"{scenario.origin.stranger} would {' and '.join(found)}, which only --trust allows: look at it first."
        )


def trusted(scenario: Scenario) -> Scenario:
    """Return the scenario as the user's own."""
    return scenario.model_copy(update={"origin": OWN})


def with_own(scenario: Scenario, *names: str) -> Scenario:
    """Return the scenario with these references and keys as given by the user."""
    origin = scenario.origin
    return scenario.model_copy(update={"origin": replace(origin, own=origin.own.union(names))})
