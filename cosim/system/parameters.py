"""Parameters of plant and controller: start values, true values over time, and checks that estimates can be written."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from estimator import Parameter

from ..errors import ScenarioError, WiringError, seconds, told_at
from ..fmi.component import ModelVariable
from ..fmi.ports import attribute
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..scenarios.schema.estimation import EstimatedParameter
from ..variable_name import VariableName
from .plant import Described, Plant


def start_value(scenario: Scenario, slaves: Mapping[str, Described], reference: str) -> float:
    """Return a variable's value before the first step: the scenario's, else the FMU's. Raises WiringError."""
    return start_values(scenario, slaves, [reference])[0]


def start_values(scenario: Scenario, slaves: Mapping[str, Described], references: Iterable[str]) -> list[float]:
    """Return the values of several variables before the first step: see start_value."""
    declared: dict[str, dict[str, Any]] = {}
    found: list[float] = []
    for reference in references:
        component, variable = VariableName(reference).parts
        start: Any = scenario.components[component].start.get(variable)
        if start is None:
            if component not in declared:
                declared[component] = {v.name: v.start for v in slaves[component].description.modelVariables}
            known = declared[component]
            if variable not in known:
                raise WiringError(f"no variable '{variable}' in {component}{did_you_mean(variable, known) or '.'}")
            start = known[variable]
        if start is None:
            raise WiringError(f"'{reference}' has no start value; give it one under components.{component}.start.")
        found.append(float(start))
    return found


def first_states(scenario: Scenario, slaves: Mapping[str, Described], plant: Plant) -> tuple[list[float], list[str]]:
    """Return the plant's states before the first step, zero where only its FMU knows them; and the names of those."""
    description = slaves[plant.name].description
    declared = {v.name for v in description.modelVariables if v.start is not None}
    known = declared | scenario.components[plant.name].start.keys()
    hidden = [name for name in plant.states if name not in known]
    starts = start_values(scenario, slaves, [f"{plant.name}.{name}" for name in plant.states if name in known])
    given = iter(starts)
    return [0.0 if name in hidden else next(given) for name in plant.states], hidden


def check_parameters(scenario: Scenario, slaves: Mapping[str, Described]) -> None:
    """Raise WiringError unless the controller takes every estimate within the bounds, and holds no true value."""
    writes = scenario.written
    for parameter in scenario.estimation.parameters:
        with told_at(key_of(parameter)):
            if (true := scenario.true_reference(parameter)) in writes:
                raise WiringError(f"'{true}' is written: 'true' of '{parameter.name}' must name the plant's parameter.")
            for reference in parameter.written:
                found = _variable(slaves, reference)
                problem = parameter_problem(parameter, found) if parameter.is_written_as_it_is else None
                if problem is not None:
                    raise WiringError(problem)
            if not parameter.is_written_as_it_is:
                problem = unit_problem(parameter, true, _variable(slaves, true))
                if problem is not None:
                    raise WiringError(problem)


def key_of(parameter: EstimatedParameter) -> str:
    """Return the place of a parameter in the scenario's file."""
    return f"estimation.parameters '{parameter.name}'"


def _variable(slaves: Mapping[str, Described], reference: VariableName) -> ModelVariable:
    """Return a variable's declaration. Raises WiringError."""
    component, name = reference.parts
    found = {v.name: v for v in slaves[component].description.modelVariables}
    if name not in found:
        raise WiringError(f"no variable '{name}' in {component}{did_you_mean(name, found) or '.'}")
    return found[name]


def unit_problem(parameter: EstimatedParameter, reference: VariableName, variable: ModelVariable) -> str | None:
    """Return the reason why a variable is not in the parameter's unit, or None, as where it declares none."""
    unit = attribute(variable, "unit")
    if unit is None or unit == parameter.unit:
        return None
    return f"'{reference}' has the unit {unit}, but '{parameter.name}' {parameter.unit}."


def parameter_problem(parameter: EstimatedParameter, variable: ModelVariable) -> str | None:
    """Return the reason why the variable that it is written to does not take every estimate of a parameter, or None."""
    writes = next(iter(parameter.written))
    if problem := unit_problem(parameter, writes, variable):
        return problem
    if narrower := narrower_range(parameter.to_parameter(), variable):
        bounds = f"[{parameter.lower:g}, {parameter.upper:g}] {parameter.unit}"
        return f"'{writes}' takes {narrower} {parameter.unit}; '{parameter.name}' has {bounds}."
    return None


def narrower_range(parameter: Parameter, variable: ModelVariable) -> str | None:
    """Return the range that a variable declares where it does not hold all of the parameter's bounds, else None."""
    declared = [attribute(variable, name) for name in ("min", "max")]
    low, high = (None if x is None else float(x) for x in declared)
    if (low is not None and parameter.lower < low) or (high is not None and parameter.upper > high):
        return f"{low} to {high}"
    return None


def true_parameters(scenario: Scenario, slaves: Mapping[str, Described]) -> dict[str, Callable[[float], float]]:
    """Return the true values of all that is changed or estimated, functions of t [s]. Raises WiringError.

    The functions raise ScenarioError where a formula has no value.
    """
    truth: dict[str, Callable[[float], float]]
    truth = {name: partial(value_of_change, name, change) for name, change in scenario.change_functions().items()}
    for parameter in scenario.estimation.parameters:
        reference = scenario.true_reference(parameter)
        if reference not in truth:
            with told_at(key_of(parameter)):
                truth[reference] = partial(_constant, start_value(scenario, slaves, reference))
    return truth


def value_of_change(name: str, change: Callable[[float], float], t: float) -> float:
    """Return the value of a changed parameter or input at t [s]. Raises ScenarioError."""
    try:
        return change(t)
    except (ArithmeticError, ValueError) as e:
        raise ScenarioError(f'changes."{name}" has no value at t = {seconds(t)} s: {e}.') from e


def _constant(value: float, t: float) -> float:
    return value
