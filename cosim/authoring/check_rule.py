"""Checks of the tuning rule: what formulas give within the bounds, against what the controllers declare to take."""

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Final

import numpy as np

from estimator import ParameterSpace, Vector

from ..errors import CosimError, one_line
from ..findings import Finding, warning
from ..scenarios.scenario import Scenario
from ..scenarios.tuning_rule import TuningRule
from ..system.parameters import start_values
from ..system.plant import Described
from ..system.tuning import WriteCheck, check_first_values, tuning_rule, written_variables
from ..user_code import is_trusted
from ..variable_name import VariableName

_WHERE: Final = "estimation.parameters"
_MOST_CORNERS: Final = 8
"""Most parameters at all of whose corners the rule is evaluated: of more, at those of the first ones."""
_SHARES: Final = (0.0, 0.3, 0.55, 0.8, 1.0)
"""Places in a parameter's bounds at which formulas are compared: no two are symmetric but the ends."""
_INSIDE: Final = 200
"""Points inside the bounds at which the rule is evaluated."""


def check_rule(scenario: Scenario, fmus: Mapping[str, Described], first: Vector) -> Iterator[Finding]:
    """Yield what is wrong or risky in the formulas; a user's function is called, a stranger's is not.

    first (d,): the parameters that the controllers begin with.
    """
    variables = written_variables(scenario, fmus)
    if not variables:
        return
    functions = {text for text in scenario.formulas.values() if ":" in text}
    if unknown := sorted(text for text in functions if not is_trusted(text, scenario.origin)):
        yield Finding(_WHERE, f"{', '.join(unknown)} of {scenario.origin.stranger} was not called", False, True)
        return
    try:
        rule = tuning_rule(scenario)
        values = check_first_values(scenario, rule, first)
    except CosimError as e:
        yield Finding(_WHERE, one_line(str(e)).removeprefix(f"{_WHERE}: ").rstrip("."))
        return
    for text in sorted(functions):
        yield Finding(_WHERE, f"'{text}' was called, at the start values and within the bounds", False, True)
    yield from _starts(scenario, fmus, rule, values)
    yield from _unused(scenario, rule, first)
    check = WriteCheck(rule, variables)
    refusals = [reason for theta in _points(scenario.estimation.space) if (reason := check(theta))]
    if refusals:
        share = len(refusals) / (_INSIDE + 2 ** min(len(first), _MOST_CORNERS))
        more = (
            "the guard vetoes such a write" if scenario.guard.enabled else "without a guard such a write ends the run"
        )
        yield warning(_WHERE, f"{share:.0%} of the bounds cannot be written: {refusals[0]}; {more}")


def _starts(
    scenario: Scenario, fmus: Mapping[str, Described], rule: TuningRule, values: list[float]
) -> Iterator[Finding]:
    """Yield formulas that do not give what the controller's FMU starts with."""
    for name, value in zip(map(VariableName, rule.names), values, strict=True):
        if name not in scenario.formulas:
            continue
        try:
            (own,) = start_values(scenario, fmus, [name])
        except CosimError:  # it declares none: the formula gives it
            continue
        if abs(own - value) > 1e-3 * max(abs(own), abs(value)):
            text = f"'{name}' starts as {own:g} in the FMU, and its formula gives {value:g}"
            yield warning(_WHERE, f"{text} at the parameters' start: that is what is written from the first step on")


def _unused(scenario: Scenario, rule: TuningRule, first: Vector) -> Iterator[Finding]:
    """Yield parameters that nothing that is written depends on."""
    space = scenario.estimation.space
    for i, parameter in enumerate(scenario.estimation.parameters):
        values = [first[i], *((1.0 - share) * parameter.lower + share * parameter.upper for share in _SHARES)]
        moved = [_try(rule, [*first[:i], value, *first[i + 1 :]]) for value in values]
        if moved[0] is not None and all(other == moved[0] for other in moved):
            yield warning(f"{_WHERE}.{i} ({space.names[i]})", "nothing that is written depends on it")


def _try(rule: TuningRule, theta: list[float]) -> list[float] | None:
    try:
        return rule(theta)
    except ValueError:
        return None


def _points(space: ParameterSpace) -> Iterator[Vector]:
    """Yield the corners of the bounds, and points inside them."""
    n, rng = min(len(space), _MOST_CORNERS), np.random.default_rng(0)
    for corner in product((0.0, 1.0), repeat=n):
        yield space.from_unit(np.array([*corner, *[0.0] * (len(space) - n)]))
    for inside in rng.random((_INSIDE, len(space))):
        yield space.from_unit(inside)
