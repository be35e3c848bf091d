"""Checks of start values, connections, inputs, loops and steps of a scenario against its FMUs' declarations."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from ..errors import WiringError
from ..findings import Finding, warning
from ..fmi.archive import has_fixed_step, needs_its_tool
from ..fmi.component import Component, is_disturbance
from ..fmi.feedthrough import algebraic_loops
from ..fmi.table import is_table
from ..fmi.types import is_real
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..system.unit_conversions import different
from ..units import IDENTITY, conversion
from ..variable_name import VariableName
from .guess import CONTROLLER, PLANT, SWAPPED, are_swapped, is_desired

MOST_LISTED: Final = 20
"""Variables that are listed one by one."""
_LITTLE: Final = 0.01
"""Share of a table's rows below which their times are perhaps in ms."""
_LONG: Final = 50.0
"""Number of the FMU's own steps from which on a macro step is unusually long."""
Components = Mapping[str, Component]
"""Components that could be read, by instance name."""


def parts(reference: str, components: Components) -> tuple[Component | None, str]:
    """Return the component of a reference, None if it could not be read, and the variable's name."""
    name, variable = VariableName(reference).parts
    return components.get(name), variable


def refusal(component: Component, role: str, name: str) -> str | None:
    """Return the reason why a variable cannot have a role ('input', 'tunable parameter', 'output'), or None."""
    try:
        component.catalogue.ports(role, [name])
    except WiringError as e:
        return str(e).rstrip(".")
    return None


def output_refusal(component: Component, name: str) -> str | None:
    """Return the reason why a variable cannot be read at communication points, or None."""
    if name in component.outputs:
        return None
    return refusal(component, "output", name) or f"'{name}' is no output of {component.fmu.name}" + did_you_mean(
        name, component.outputs
    )


def output_refusals(component: Component, names: Iterable[str]) -> Iterator[str]:
    """Yield the reasons why variables cannot be read at communication points: the first ones, and how many more."""
    refused = [name for name in names if name not in component.outputs]
    yield from (text for name in refused[:MOST_LISTED] if (text := output_refusal(component, name)))
    if len(refused) > MOST_LISTED:
        yield f"{len(refused) - MOST_LISTED} more are no outputs of {component.fmu.name}"


def unit_finding(
    where: str, source: str, target: str, components: Components, is_converted: bool = False
) -> Iterator[Finding]:
    """Yield problems with the units of two variables, one of which takes the other's number, converted or not."""
    (a, name_a), (b, name_b) = parts(source, components), parts(target, components)
    if a is None or b is None or name_a not in a.variables or name_b not in b.variables:
        return
    unit_a, unit_b = a.unit(name_a), b.unit(name_b)
    if unit_a is None or unit_b is None:
        if unit_a is not unit_b:
            silent, unit = (source, unit_b) if unit_a is None else (target, unit_a)
            yield warning(where, f"'{silent}' has no unit, the other end {unit.name if unit else ''}")
        return
    try:
        if conversion(unit_a, unit_b) == IDENTITY:
            return
        rule = "and is converted" if is_converted else "and both must be in one unit"
        yield Finding(where, f"{different(source, target, components)}, {rule}", is_error=not is_converted)
    except ValueError as e:
        is_known = unit_a.exponents is not None and unit_b.exponents is not None
        yield Finding(where, f"'{source}' to '{target}': {e}", is_error=is_known or is_table(a.fmu))


def check_starts(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield start values that an FMU does not take, or that are outside its limits."""
    for name, component in components.items():
        catalogue = component.catalogue
        for variable, value in scenario.components[name].start.items():
            where = f"components.{name}.start.{variable}"
            try:
                port = catalogue.start_port(variable, value)
            except WiringError as e:
                yield Finding(where, str(e).rstrip("."))
                continue
            problem = None if isinstance(value, str) else port.problem([float(value)])
            if problem:
                yield Finding(where, problem)


def check_connections(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield ends of connections that are not an input or output, or differ in type or unit."""
    for target, source in scenario.connections.items():
        where = f'connections."{target}"'
        (to, to_name), (of, of_name) = parts(target, components), parts(source, components)
        problems = [to and refusal(to, "input", to_name), of and output_refusal(of, of_name)]
        yield from (Finding(where, problem) for problem in problems if problem)
        if any(problems) or to is None or of is None:
            continue
        types = [str(of.variables[of_name].type), str(to.variables[to_name].type)]
        if types[0] != types[1] and not is_real(types[1]):
            yield warning(
                where, f"{types[0]} output, {types[1]} input: a value that is not a whole number ends the run"
            )
        yield from unit_finding(where, source, target, components, is_converted=True)


def check_inputs(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield inputs that are neither connected nor changed, but for disturbances."""
    taken = {*scenario.connections, *scenario.changes}
    for name, component in components.items():
        for v in component.having("input"):
            if not is_disturbance(v) and f"{name}.{v.name}" not in taken:
                start = scenario.components[name].start.get(v.name, v.start)
                yield warning(f'connections."{name}.{v.name}"', f"the input is not connected: it stays {start}")


def check_roles(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield a warning where plant and controller seem to be swapped, or a set point is a measurement."""
    if are_swapped(components, scenario.connections.items()):
        yield warning("components", SWAPPED)
    for target, source in scenario.connections.items():
        is_set_point = target.component == CONTROLLER and is_desired(target.variable)
        if is_set_point and source.component == PLANT and not is_desired(source.variable):
            text = f"'{target.variable}' is a set point by its name, and '{source}' a measurement"
            yield warning(f'connections."{target}"', text)


def check_loops(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield outputs that depend on themselves within a communication point."""
    known: dict[str, str] = {
        target: source
        for target, source in scenario.connections.items()
        if all(c is not None and name in c.variables for c, name in (parts(r, components) for r in (target, source)))
    }
    for loop in algebraic_loops(components, known):
        way = " <- ".join([*loop.nodes, loop.nodes[0]])
        if loop.undeclared:
            silent = ", ".join(components[name].fmu.name for name in loop.undeclared)
            verb = "declares" if len(loop.undeclared) == 1 else "declare"
            what = f"there may be an algebraic loop, as {silent} {verb} no dependencies: {way}"
            yield warning("connections", what)
        else:
            yield warning("connections", f"algebraic loop, closed with the value of the previous macro step: {way}")


def check_steps(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield steps and times that an FMU is not made for."""
    settings = scenario.scenario
    for name, component in components.items():
        experiment = component.experiment
        if is_table(component.fmu):
            start, end = experiment["start_time"], experiment["stop_time"]
            if start > settings.start_time or end < settings.stop_time:
                text = f"its rows cover {start:g} to {end:g} s: outside them the nearest is held"
                yield warning(f"components.{name}", text)
            elif settings.stop_time - settings.start_time < _LITTLE * (end - start):
                text = f"the run is a small part of its rows, which end at {end:g} s: are their times in s?"
                yield warning(f"components.{name}", text)
            continue
        if needs_its_tool(component.description):
            yield warning(
                f"components.{name}",
                f"{component.fmu.name} needs the tool that made it to be installed on this machine",
            )
        step = experiment.get("step_size")
        is_fixed = has_fixed_step(component.description)
        if is_fixed and step is not None and abs(step - settings.macro_step) > 1e-9 * settings.macro_step:
            text = f"{component.fmu.name} supports no other steps than {step:g} s"
            yield warning("scenario.macro_step", text)
        elif not is_fixed and step is not None and settings.macro_step >= _LONG * step:
            text = f"{settings.macro_step / step:.3g} times the step that {component.fmu.name} is made for, {step:g} s"
            yield warning("scenario.macro_step", text)
