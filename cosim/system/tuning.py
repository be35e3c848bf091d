"""The tuning rule of a scenario in its FMUs: first parameters, declared ranges and units of what is written."""

from collections.abc import Mapping

from estimator import Vector

from ..errors import ScenarioError
from ..fmi.component import ModelVariable
from ..fmi.ports import attribute
from ..scenarios.scenario import Scenario
from ..scenarios.tuning_rule import TuningRule
from ..user_code import load
from ..variable_name import VariableName
from .parameters import start_values
from .plant import Described


def tuning_rule(scenario: Scenario) -> TuningRule:
    """Return the scenario's tuning rule; loads the user's functions in it. Raises ScenarioError."""
    names = scenario.estimation.space.names
    where = "estimation.parameters"
    return TuningRule(
        names, {**scenario.written}, lambda reference: load(reference, scenario.folder, where, scenario.origin)
    )


def first_parameters(scenario: Scenario, slaves: Mapping[str, Described]) -> list[float]:
    """Return the estimated parameters (d,) that the controllers begin with. Raises WiringError."""
    plain = [p.writes for p in scenario.estimation.parameters if isinstance(p.writes, VariableName)]
    starts = iter(start_values(scenario, slaves, plain))
    return [next(starts) if p.start is None else p.start for p in scenario.estimation.parameters]


def written_variables(scenario: Scenario, slaves: Mapping[str, Described]) -> dict[VariableName, ModelVariable]:
    """Return the declarations of the parameters that formulas give; those written as they are, are left out."""
    owners = {name.component for name in scenario.formulas}
    known = {name: {v.name: v for v in slaves[name].description.modelVariables} for name in owners}
    return {name: known[name.component][name.variable] for name in scenario.formulas}


class WriteCheck:
    """Check that a tuning rule has values, and that the controllers declare to take them."""

    def __init__(self, rule: TuningRule, variables: Mapping[VariableName, ModelVariable]) -> None:
        """variables: the declarations of those with formulas."""
        self._rule = rule
        self._ranges = {name: _declared_range(v) for name, v in variables.items()}

    def __call__(self, theta: Vector) -> str | None:
        """Return the reason why parameters (d,) cannot be written, or None."""
        if self._rule.is_plain:  # whose bounds are inside what is declared
            return None
        try:
            values = self._rule(theta)
        except ValueError as e:
            return str(e)
        for name, value in zip(self._rule.names, values, strict=True):
            low, high = self._ranges.get(VariableName(name), (None, None))
            if (low is not None and value < low) or (high is not None and value > high):
                return f"{name} would be {value:.6g}, and it takes {low} to {high}"
        return None


def check_first_values(scenario: Scenario, rule: TuningRule, theta: Vector) -> list[float]:
    """Return what the rule gives at the start (d,).

    Raises ScenarioError where it has no values, and where it contradicts a start value that the scenario gives.
    """
    try:
        values = rule(theta)
    except ValueError as e:
        raise ScenarioError(f"estimation.parameters: at the start: {e}.") from e
    for name, value in zip(rule.names, values, strict=True):
        component, variable = VariableName(name).parts
        given = scenario.components[component].start.get(variable)
        if given is not None and abs(float(given) - value) > 1e-6 * max(abs(value), abs(float(given))):
            start = ", ".join(f"{n} = {v:g}" for n, v in scenario.estimation.space.named(theta).items())
            text = f"'{name}' is given the start value {float(given):g}, but its formula gives {value:g} at {start}"
            raise ScenarioError(f"{text}: leave out the start value, or change 'start' of the parameters.")
    return values


def _declared_range(variable: ModelVariable) -> tuple[float | None, float | None]:
    low, high = (attribute(variable, name) for name in ("min", "max"))
    return None if low is None else float(low), None if high is None else float(high)
