"""Checks of the variables that a scenario changes, tracks, samples and estimates against its FMUs' declarations."""

from collections.abc import Iterator
from math import isclose
from typing import Final

from ..errors import ScenarioError, seconds
from ..findings import Finding, warning
from ..fmi.component import Component
from ..fmi.ports import Catalogue, Ports, attribute
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..scenarios.schema.estimation import EstimatedParameter
from ..scenarios.schema.sampling import Derivative
from ..system.parameters import parameter_problem, unit_problem, value_of_change
from ..system.plant import connected_as_well
from ..variable_name import VariableName
from .check_wiring import Components, output_refusal, output_refusals, parts, refusal, unit_finding
from .set_points import size_of

_SAME: Final = 1e-6
"""Relative difference of start values that is none."""
_MOST_CHANGES: Final = 10_000
"""Most communication points at which a change is compared with the bounds."""
_MOST_POINTS: Final = 1_000_000
"""Most communication points at which a change is evaluated: of a longer run every second, third, ..."""


def check_changes(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield variables that cannot change while the plant runs, and an experiment in which nothing changes."""
    for reference in scenario.changes:
        component, name = parts(reference, components)
        is_input = component is not None and name in {v.name for v in component.having("input")}
        problem = component and refusal(component, "input" if is_input else "tunable parameter", name)
        if is_input and reference in scenario.connections:
            problem = connected_as_well(scenario, reference)
        if component is not None and not problem:
            catalogue = Catalogue(component.fmu.name, component.variables.values())
            is_lenient = is_input and scenario.scenario.out_of_range == "warning"
            port = catalogue.ports("input" if is_input else "tunable parameter", [name], is_lenient)
            problem = _first_problem(scenario, reference, port)
        if problem:
            yield Finding(f'changes."{reference}"', problem)
    if not scenario.changes:
        yield warning("changes", "nothing changes in the plant: there is nothing to estimate")


def _first_problem(scenario: Scenario, reference: VariableName, port: Ports) -> str | None:
    """Return the problem of the first value that a change would set, as `run` finds it, or None."""
    settings, change = scenario.scenario, scenario.change_functions()[reference]
    last = settings.n_steps
    for k in range(0, last + 1, max(1, last // _MOST_POINTS)):
        t = settings.time(k)
        try:
            problem = port.problem([value_of_change(reference, change, t)])
        except ScenarioError as e:
            return str(e).removeprefix(f'changes."{reference}" ').rstrip(".")
        if problem and k < last:  # nothing steps from the last point on
            return f"{problem}, at t = {seconds(t)} s"
    return None


def check_tracking(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield tracked variables and references that are not outputs or have different units."""
    for tracked, reference in scenario.tracking.items():
        where = f'tracking."{tracked}"'
        ends = [parts(r, components) for r in (tracked, reference)]
        problems = [c and output_refusal(c, name) for c, name in ends]
        yield from (Finding(where, problem) for problem in problems if problem)
        yield from unit_finding(where, reference, tracked, components)


def check_tolerance(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield a guard that would take back no write, since it tolerates errors as large as all the set points."""
    guard, divergence = scenario.guard, scenario.limits.divergence
    tables = [(components[r.component], r.variable) for r in scenario.tracking.values() if r.component in components]
    sizes = [size for component, name in tables if (size := size_of(component, name)) is not None]
    tolerance = guard.tolerance_at(divergence)
    if guard.enabled and sizes and tolerance >= max(sizes):
        whence = "" if guard.tolerance else " (a hundredth of limits.divergence)"
        yield warning(
            "guard.tolerance",
            f"{tolerance:g}{whence} is as large as all the set points of the tracked outputs ({max(sizes):g}): "
            "no error that a write makes would be large enough to take it back",
        )


def check_sampling(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield sampled variables that are neither derivative nor state, states and inputs that cannot be read."""
    plant, sampling = components.get(scenario.plant), scenario.sampling
    if plant is None:
        return
    if sampling.filter is None:  # else `check_filter` looks at its states
        for reference, derivative in sampling.derivatives.items():
            if problem := _derivative_problem(scenario, plant, reference, derivative):
                yield Finding(f'sampling.derivatives."{reference}"', problem)
        for reference in sampling.states:
            if problem := _state_problem(scenario, plant, reference):
                yield Finding(f'sampling.states."{reference}"', problem)
        for problem in output_refusals(plant, plant.derivatives if sampling.derivatives else ()):
            yield Finding("sampling", f"the model takes every state: {problem}")
    for v in plant.having("input"):
        try:
            float(v.start or 0.0)
        except ValueError:
            yield Finding("sampling", f"the input '{v.name}' of {plant.fmu.name} starts as {v.start!r}")


def _derivative_problem(
    scenario: Scenario, plant: Component, reference: VariableName, derivative: Derivative
) -> str | None:
    """Return the reason why a derivative cannot be sampled, or of which state it is, is not known; else None."""
    name, of, declared = reference.variable, derivative.of, plant.derivatives
    if problem := output_refusal(plant, name):
        return problem
    if of is None and name not in declared.values():
        hint = did_you_mean(name, declared.values()) or f'; say of which: of = "{scenario.plant}.STATE"'
        return f"'{name}' is not declared as a state's derivative{hint}"
    states = {*declared} or {state.variable for state in scenario.sampling.states}
    if of is not None and of.variable not in states:
        return f"'{of}' is no state{did_you_mean(of.variable, states) or '; name the states in sampling.states'}"
    return None


def _state_problem(scenario: Scenario, plant: Component, reference: VariableName) -> str | None:
    """Return the reason why a variable is no state that can be sampled, or None."""
    component, name = reference.parts
    if component == scenario.plant and not plant.derivatives:
        return output_refusal(plant, name)
    if component == scenario.plant and name in plant.derivatives:
        return None
    return f"no state with a declared derivative{did_you_mean(name, plant.derivatives)}"


def check_parameters(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield parameters that the controller takes not at all or in part only, and those that the plant does not have."""
    for i, parameter in enumerate(scenario.estimation.parameters):
        where = f"estimation.parameters.{i} ({parameter.name})"
        yield from (Finding(where, text) if is_error else warning(where, text)
                    for is_error, text in _problems(scenario, parameter, components))  # fmt: skip


def check_undeclared(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield the parameters that a controller takes whatever is written: in one line, however many there are."""
    free: dict[str, list[str]] = {}
    for parameter in scenario.estimation.parameters:
        for reference in parameter.written if parameter.is_written_as_it_is else ():
            owner = components.get(reference.component)
            v = owner.variables.get(reference.variable) if owner else None
            if owner and v and attribute(v, "min") is None and attribute(v, "max") is None:
                free.setdefault(owner.fmu.name, []).append(parameter.name)
    for fmu, names in free.items():
        text = f"{fmu} declares neither min nor max of {', '.join(names)}: only lower and upper limit what is written"
        yield warning("estimation.parameters", text)


def _problems(scenario: Scenario, parameter: EstimatedParameter, components: Components) -> Iterator[tuple[bool, str]]:
    true = scenario.true_reference(parameter)
    plant, name = parts(true, components)
    if plant is not None and name not in plant.variables:
        hint = did_you_mean(name, plant.variables)
        yield True, f"no variable '{name}' in {plant.fmu.name}{hint or '; give the one it stands for with true = ...'}"
    elif plant is not None and true not in scenario.changes and _start(scenario, true, components) is None:
        yield True, f"'{true}' has no start value; give it one under components.{scenario.plant}.start"
    if plant is not None and name in plant.variables:
        yield from _beginnings(scenario, parameter, true, components)
        yield from _outside(scenario, parameter, true)
    for reference in parameter.written:
        yield from _written(scenario, parameter, reference, components)
    if plant is None or name not in plant.variables:
        return
    if problem := unit_problem(parameter, true, plant.variables[name]):
        yield not parameter.is_written_as_it_is, problem.rstrip(".")


def _beginnings(
    scenario: Scenario, parameter: EstimatedParameter, true: VariableName, components: Components
) -> Iterator[tuple[bool, str]]:
    """Yield a plant that begins with another value of the parameter than its controller."""
    if true in scenario.changes:  # its author has said what it begins with
        return
    begins = _start(scenario, true, components)
    own = next(iter(parameter.written), None)
    if parameter.start is not None or own is None:
        holds, whose = parameter.start, f"'{parameter.name}' of the controller"
    elif own.component in components and own.variable in components[own.component].variables:
        holds, whose = _start(scenario, own, components), f"'{own}'"
    else:
        return
    if begins is not None and holds is not None and not isclose(begins, holds, rel_tol=_SAME):
        yield False, f"'{true}' starts at {begins:.6g}, and {whose} at {holds:.6g}"


def _outside(scenario: Scenario, parameter: EstimatedParameter, true: VariableName) -> Iterator[tuple[bool, str]]:
    """Yield a change of the plant's parameter to where its estimate cannot follow."""
    if true not in scenario.changes:
        return
    settings, change = scenario.scenario, scenario.change_functions()[true]
    last = settings.n_steps
    times = (settings.time(k) for k in range(0, last, max(1, last // _MOST_CHANGES)))
    try:
        values = [value_of_change(true, change, t) for t in times]
    except ScenarioError:  # `check_changes` tells
        return
    outside = [value for value in values if not parameter.lower <= value <= parameter.upper]
    if outside:
        farthest = max(outside, key=lambda value: abs(value - 0.5 * (parameter.lower + parameter.upper)))
        bounds = f"[{parameter.lower:g}, {parameter.upper:g}]"
        yield False, f"'{true}' changes to {farthest:.6g}, outside {bounds}: no estimate can follow it there"


def _written(
    scenario: Scenario, parameter: EstimatedParameter, reference: VariableName, components: Components
) -> Iterator[tuple[bool, str]]:
    """Yield problems with a parameter of the controller that is written; those of a formula's value: `check_rule`."""
    controller, name = parts(reference, components)
    if controller is None:
        return
    problem = refusal(controller, "tunable parameter", name)
    if problem:
        yield True, problem
        return
    if not parameter.is_written_as_it_is:
        return
    true = scenario.true_reference(parameter)
    yield from ((f.is_error, f.what) for f in unit_finding("", true, reference, components) if f.is_error)
    variable = controller.variables[name]
    if problem := parameter_problem(parameter, variable):
        yield True, problem.rstrip(".")
    start = _start(scenario, reference, components)
    if start is None:
        yield True, f"'{reference}' has no start value; give it one under components.{reference.component}.start"
    elif not parameter.to_parameter().contains(start):
        yield False, f"'{reference}' starts at {start:g}, outside [{parameter.lower:g}, {parameter.upper:g}]"


def _start(scenario: Scenario, reference: VariableName, components: Components) -> float | None:
    component, name = reference.parts
    value = scenario.components[component].start.get(name, components[component].variables[name].start)
    try:
        return None if value is None else float(value)
    except ValueError:
        return None
