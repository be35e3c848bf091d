"""Reasons to refuse what an importer sets or asks for, each in one line; None where there is none."""

from collections.abc import Sequence
from math import inf, isfinite

from .description import VariableRow

Bounds = tuple[int, float, float]
"""Place of a variable, its min and its max."""
SLACK, ROUNDING = 1e-6, 1e-9
"""Parts of a step and of the time that an importer's sum of steps may be off by."""


def bounds_of(variables: Sequence[VariableRow], is_latched: bool) -> list[Bounds]:
    """Return the bounds of the variables that have any, of those that are latched or of the others."""
    return [
        (i, -inf if v.min is None else v.min, inf if v.max is None else v.max)
        for i, v in enumerate(variables)
        if v.is_latched is is_latched and (v.min is not None or v.max is not None)
    ]


def of_step(last_end: float | None, current_time: float, step_size: float) -> str | None:
    """Return why a step cannot be taken; last_end: where it must begin [s], None for anywhere."""
    if not 0.0 < step_size < inf:
        return f"step_size must be positive, got {step_size} s."
    begin = current_time if last_end is None else last_end
    if not abs(current_time - begin) <= SLACK * step_size + ROUNDING * abs(begin):
        return f"a step must begin where the last ended, {begin} s, not {current_time} s."
    return None


def of_values(variables: Sequence[VariableRow], values: Sequence[float]) -> str | None:
    """Return the first value that is not finite; fewer values than variables are those of the first."""
    if isfinite(sum(values)):
        return None
    found = ((v.name, value) for v, value in zip(variables, values) if not isfinite(value))
    return next((f"{name} must be finite, got {value}." for name, value in found), None)


def of_bounds(variables: Sequence[VariableRow], values: Sequence[float], bounds: Sequence[Bounds]) -> str | None:
    """Return the first value that is outside its bounds."""
    for i, low, high in bounds:
        if not low <= values[i] <= high:
            return f"{variables[i].name} must be in [{low}, {high}], got {values[i]:g}."
    return None


def of_read(variables: Sequence[VariableRow], reference: int, kind: str) -> str:
    """Return why a value reference must not be read as a variable of a type."""
    is_known = 0 <= reference < len(variables)
    its_type = f"of type {variables[reference].type}" if is_known else "which no variable has"
    return f"{named(variables, reference)}, {its_type}, must not be read as {kind}."


def named(variables: Sequence[VariableRow], reference: int) -> str:
    """Return a variable's name, or a value reference that no variable has."""
    return variables[reference].name if 0 <= reference < len(variables) else f"value reference {reference}"
