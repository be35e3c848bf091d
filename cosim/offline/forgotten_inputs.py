"""Warnings about inputs of the plant that a log has no column for."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from ..fmi.component import Component, is_disturbance

_MOST: Final = 6
"""Number of unused columns that are named."""


def forgotten_inputs(
    component: Component, inputs: Mapping[str, str], started: Iterable[str], unused: Sequence[str]
) -> list[str]:
    """Return a warning for each input that keeps the FMU's own start value though nobody said so.

    inputs: column by input; started: variables whose start value is given; unused: columns of the log without a role.
    """
    known = {*inputs, *started}
    named = ", ".join(f"'{column}'" for column in unused[:_MOST]) + (", ..." if len(unused) > _MOST else "")
    columns = f" (columns not used: {named})" if unused else ""
    return [
        f"input '{v.name}' of {component.fmu.name} has no column and stays {_value(component, v.name)}: give "
        f"--input {v.name}=COLUMN, or --start {v.name}=VALUE{columns}."
        for v in component.having("input")
        if v.name not in known and not is_disturbance(v)
    ]


def _value(component: Component, name: str) -> str:
    start, unit = component.variables[name].start, component.unit(name)
    if start is None:
        return "as it is"
    return f"{start} {unit.name}" if unit and unit.name != "1" else f"{start}"
