"""Changes of the plant's parameters and inputs over time: values, formulas, or rows of them."""

from collections.abc import Callable, Mapping
from itertools import pairwise
from keyword import iskeyword
from math import nan
from typing import Annotated, Final

from pydantic import BeforeValidator, Strict

from ..variable_name import VariableName
from .formula import CONSTANTS, FUNCTIONS, compile_formula

MOST_DEFINITIONS: Final = 100
"""Named functions: each is a call within the call of the one that names it."""


def _not_boolean(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("must be a number or a formula, not a Boolean")
    return value


Number = Annotated[float, Strict()]
Change = Annotated[float | str | tuple[tuple[Number, Number | str], ...], BeforeValidator(_not_boolean)]
"""A value, a formula in t, or rows [time, value or formula]: each holds from its time on."""


def change_functions(
    definitions: Mapping[str, float | str], changes: Mapping[VariableName, Change]
) -> dict[VariableName, Callable[[float], float]]:
    """Return each change as a function of t [s]; a definition may use those before it. Raises ValueError."""
    defined: dict[str, Callable[[float], float]] = {}
    if len(definitions) > MOST_DEFINITIONS:
        raise ValueError(
            f"definitions: there are {len(definitions)}; at most {MOST_DEFINITIONS} can build on each other"
        )
    for name, text in definitions.items():
        if not name.isidentifier() or iskeyword(name) or name in {"t", *FUNCTIONS, *CONSTANTS}:
            raise ValueError(f"definitions: '{name}' must be a name of its own")
        defined[name] = _remembering(_named(f"definitions.{name}", text, defined))
    return {name: _change_function(f"changes.{name}", change, defined) for name, change in changes.items()}


def _remembering(function: Callable[[float], float]) -> Callable[[float], float]:
    """Return the function with its last value kept: else one that names two others, and so on, doubles each time."""
    last = [nan, nan]

    def value(t: float) -> float:
        if t != last[0]:
            last[:] = t, function(t)
        return last[1]

    return value


def _named(
    place: str, formula: float | str, defined: Mapping[str, Callable[[float], float]]
) -> Callable[[float], float]:
    try:
        return compile_formula(str(formula), defined)
    except ValueError as e:
        raise ValueError(f"{place}: {e}") from e


def _change_function(
    name: str, change: Change, defined: Mapping[str, Callable[[float], float]]
) -> Callable[[float], float]:
    if not isinstance(change, tuple):
        return _named(name, change, defined)
    times = [row[0] for row in change]
    if not times:
        raise ValueError(f"{name}: has no rows [time, value]")
    if any(b <= a for a, b in pairwise(times)):
        raise ValueError(f"{name}: the times of a change must rise, got {times}")
    pieces = [_named(name, row[1], defined) for row in change]

    def value(t: float) -> float:
        # Half a nanosecond late counts as in time: t is a rounded product.
        reached = [piece for since, piece in zip(times, pieces, strict=True) if t >= since - 5e-10]
        return (reached[-1] if reached else pieces[0])(t)

    return value
