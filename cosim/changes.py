"""What happens to the plant over time: values, formulas, or rows of them."""

from collections.abc import Callable, Mapping
from itertools import pairwise

from .formula import compile_formula

Change = float | str | tuple[tuple[float, float | str], ...]
"""A value, a formula in t, or rows [time, value or formula]: each holds from its time on."""


def change_functions(
    definitions: Mapping[str, float | str], changes: Mapping[str, Change]
) -> dict[str, Callable[[float], float]]:
    """Each changed parameter as a function of t [s]; a definition may use those before it. Raises ValueError."""
    defined: dict[str, Callable[[float], float]] = {}
    for name, text in definitions.items():
        defined[name] = compile_formula(str(text), defined)
    return {name: _change_function(name, change, defined) for name, change in changes.items()}


def _change_function(
    name: str, change: Change, defined: Mapping[str, Callable[[float], float]]
) -> Callable[[float], float]:
    if not isinstance(change, tuple):
        return compile_formula(str(change), defined)
    times = [row[0] for row in change]
    if not times or any(b <= a for a, b in pairwise(times)):
        raise ValueError(f"{name}: the times of a change must rise, got {times}")
    pieces = [compile_formula(str(row[1]), defined) for row in change]

    def value(t: float) -> float:
        # Half a nanosecond late counts as in time: t is a rounded product.
        reached = [piece for since, piece in zip(times, pieces, strict=True) if t >= since - 5e-10]
        return (reached[-1] if reached else pieces[0])(t)

    return value
