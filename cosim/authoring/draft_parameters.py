"""Parameters in a draft scenario that plant and controller share, and their bounds: see `draft`."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, count
from typing import Final

from ..errors import one_line
from ..fmi.component import Component, ModelVariable
from ..fmi.ports import attribute
from ..fmi.types import is_real
from ..scenarios.formula import identifier
from .guess import CONTROLLER, LIKE, ORDER, PLANT, alike, best, have_one_unit, stem
from .toml_lines import quoted, said

_LIMITS: Final = {"lim", "limit", "max", "min", "sat", "saturation"}
_WIDE: Final = 10.0  # a guessed bound is this many times the start value


@dataclass(frozen=True)
class Shared:
    """A parameter that plant and controller share."""

    its: ModelVariable
    """The plant's."""
    own: tuple[ModelVariable, ...]
    """The controller's tunable ones that stand for it, one or more: the most alike first."""
    name: str
    """Name of the estimate as a function's argument, another one for each."""


def shared_parameters(components: Mapping[str, Component]) -> list[Shared]:
    """Return the plant's parameters that tunable ones of the controller stand for, in the controller's order."""
    if CONTROLLER not in components:
        return []
    claims: dict[str, list[ModelVariable]] = {}
    for own, its in _pairs(components[PLANT], components[CONTROLLER]):
        claims.setdefault(its.name, []).append(own)
    for name, claim in claims.items():
        claim.sort(key=lambda own, name=name: ORDER.index(alike(own.name, name) or LIKE))
    names, plant = _numbered(identifier(claim[0].name) for claim in claims.values()), components[PLANT].variables
    return [Shared(plant[its], (*claims[its],), name) for its, name in zip(claims, names, strict=True)]


def _numbered(names: Iterable[str]) -> list[str]:
    """Return the names, with a number after one that has come before: c, c_2."""
    found: list[str] = []
    for name in names:
        choices = chain([name], (f"{name}_{i}" for i in count(2)))
        found.append(next(choice for choice in choices if choice not in found))
    return found


def _pairs(plant: Component, controller: Component) -> list[tuple[ModelVariable, ModelVariable]]:
    """Return the controller's tunable parameters, each with the plant's parameter that it stands for."""
    there = [(plant, v) for v in plant.having("parameter") if is_real(v.type)]
    own = [v for v in controller.having("parameter", "tunable") if is_real(v.type) and not is_gravity(controller, v)]
    by_name = {v.name: its for v in own if (its := best(v.name, controller, there)) is not None}
    taken = {its.name for its in by_name.values()}
    left = [v for v in own if v.name not in by_name], [v for _, v in there if v.name not in taken]
    pairs = by_name | _of_one_value(controller, plant, *left)
    return [(v, pairs[v.name]) for v in own if v.name in pairs]


def _of_one_value(
    controller: Component, plant: Component, own: Iterable[ModelVariable], there: Iterable[ModelVariable]
) -> dict[str, ModelVariable]:
    """Return plant parameters that start at the value of one of the controller's, and share a word of its name.

    Limits are none: an actuator's are in both as well, and do not change.
    """

    def belong(v: ModelVariable, other: ModelVariable) -> bool:
        words, others = set(stem(v.name)), set(stem(other.name))
        if v.start is None or other.start is None or not words & others or (words | others) & _LIMITS:
            return False
        is_one_value = float(v.start) == float(other.start) != 0.0
        return is_one_value and have_one_unit(controller, v.name, plant, other.name) is not False

    found = {v.name: [other for other in there if belong(v, other)] for v in own}
    claims = Counter(other.name for others in found.values() for other in others)
    return {name: others[0] for name, others in found.items() if len(others) == 1 == claims[others[0].name]}


def parameters(components: Mapping[str, Component], shared: list[Shared], is_fmu: bool) -> Iterator[list[str]]:
    """Yield a table for each parameter shared by plant and controller, and comments on the controller's other ones.

    is_fmu: whether the model is an FMU, whose parameters have the plant's names.
    """
    yield from (_parameter(one, one.its.name if is_fmu else one.name) for one in shared)
    if not shared:
        yield [
            "[[estimation.parameters]]",
            said('name = "FILL"', "FILL the model's argument"),
            said("lower = 0.1", "FILL"),
            said("upper = 10.0", "FILL"),
            said('unit = "1"', "FILL"),
            said('writes = "controller.FILL"', "FILL a tunable parameter of the controller"),
        ]
    controller, written = components.get(CONTROLLER), {v.name for one in shared for v in one.own}
    others = [v.name for v in controller.having("parameter", "tunable")] if controller else []
    if names := ", ".join(one_line(name) for name in others if name not in written):
        about = "# Formulas can give those that follow from estimated ones: docs/scenario.md, Controllers with gains."
        yield [f"# Tunable in the controller too, but not estimated: {names}", about]


def _parameter(shared: Shared, name: str) -> list[str]:
    """Return the lines for a parameter, the estimate of which has this name."""
    own, its = shared.own[0], shared.its
    is_plain = len(shared.own) == 1
    low, high, notes = bounds(*shared.own, its)
    units = [unit for v in (own, its) if (unit := attribute(v, "unit"))]
    unit = units[0 if is_plain else -1] if units else None  # formulas give numbers in the plant's unit
    true = f"GUESS: {alike(own.name, its.name) or 'a word of the name, and the start value'}"
    return [
        said("[[estimation.parameters]]", f"[{unit or '1'}] {one_line(own.description or '')}".rstrip()),
        f"name = {quoted(name)}",
        said(f"lower = {low!r}", notes[0]),
        said(f"upper = {high!r}", notes[1]),
        *unit_and_scale(unit, low, high),
        *([f"writes = {quoted(f'{CONTROLLER}.{own.name}')}"] if is_plain else []),
        *([said(f"true = {quoted(f'{PLANT}.{its.name}')}", true)] if its.name != name else []),
        *([] if is_plain else _formulas(shared, name, min(max(_start(*shared.own, its), low), high))),
    ]


def _formulas(shared: Shared, name: str, start: float) -> list[str]:
    """Return the lines for an estimate that several of the controller's parameters take, and for its start value."""
    lines = [f"start = {start!r}", "[estimation.parameters.writes]"]
    for v in shared.own:
        text = f"{quoted(f'{CONTROLLER}.{v.name}')} = {quoted(identifier(name))}"
        lines.append(said(text, f"GUESS: {alike(v.name, shared.its.name)}"))
    return lines


def is_gravity(component: Component, v: ModelVariable) -> bool:
    return v.start is not None and 9.7 < abs(float(v.start)) < 9.9 and unit_name(component, v.name) in ("m/s2", "m/s^2")


def bounds(own: ModelVariable, *others: ModelVariable) -> tuple[float, float, tuple[str, str]]:
    """Return lower and upper bound, each with its source: the limits of all variables, or a guess from the start.

    Where no value is within the limits of all, those of the first are taken.
    """
    variables = (own, *others)
    lows = [float(x) for v in variables if (x := attribute(v, "min")) is not None and math.isfinite(float(x))]
    highs = [float(x) for v in variables if (x := attribute(v, "max")) is not None and math.isfinite(float(x))]
    if others and lows and highs and max(lows) >= min(highs):
        low, high, _ = bounds(own)
        note = "GUESS: no value is within the limits of both FMUs"
        return low, high, (note, note)
    start = _start(*variables)
    wide = sorted(float(f"{x:.6g}") for x in (start / _WIDE, start * _WIDE)) if start else [-1.0, 1.0]
    low = max(lows) if lows else wide[0]
    high = min(highs) if highs else wide[1]
    if low >= high:  # a guess that a declared bound has overtaken
        low, high = (low, low + abs(low) + 1.0) if lows else (high - abs(high) - 1.0, high)
    notes = (
        "of the FMUs" if lows else "GUESS: none is declared",
        "of the FMUs" if highs else "GUESS: none is declared",
    )
    return low, high, notes


def _start(*variables: ModelVariable) -> float:
    return next((float(v.start) for v in variables if v.start), 0.0)


def unit_and_scale(unit: str | None, low: float, high: float) -> list[str]:
    """Return the lines for a parameter's unit and scale; low, high: its bounds."""
    return [
        f"unit = {quoted(unit or '1')}",
        f'scale = "{"log" if low > 0.0 and high >= 10.0 * low else "linear"}"',
    ]


def described(component: Component, v: ModelVariable) -> str:
    return f"[{unit_name(component, v.name)}] {one_line(v.description or '')}".rstrip()


def unit_name(component: Component, name: str) -> str:
    unit = component.unit(name)
    return unit.name if unit else "1"


def last_name(v: ModelVariable) -> str:
    """Return the last part of a structured name, as an argument of a function: `J` of `inertia.J`."""
    return identifier(re.split(r"\.(?![^\[(]*[\])])", v.name)[-1])
