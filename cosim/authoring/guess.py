"""Connections between FMUs that are not wired yet, guessed from names, units and roles.

Names are compared by their words: `phiRef` and `phi_ref` are phi, ref. After that, words that only denote a variable's
role are left out, and only the last words of a structured name are compared: `s_meas` matches `mass.s`.

A plant takes the controller's outputs, and one of the reference that has exactly its input's name, such as the weather
that the controller measures. An output that an input takes by its exact name is given to no other input of the same
component by a likeness: `dU` beside `U` is a disturbance.
"""

import re
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import lru_cache
from typing import Final

from ..fmi.component import Component, ModelVariable, is_disturbance
from ..units import IDENTITY, Unit, conversion
from ..variable_name import VariableName

PLANT, CONTROLLER, REFERENCE = "plant", "controller", "reference"
"""Instance names."""

_DESIRED: Final = {"ref", "reference", "set", "setpoint", "sp", "des", "desired", "target", "goal"}
_ROLES: Final = _DESIRED | {"cmd", "command", "meas", "measured", "act", "actual", "sensor", "held", "in", "out"}
_WORDS: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
_LIKE: Final = 0.75  # of SequenceMatcher: `position` and `pos` are 0.55, `force` and `force1` 0.91
_SHORT: Final = 3  # letters of an abbreviation

SAME, SAME_WORDS, LAST_WORDS, LIKE, ONLY_UNIT = (
    "same name",
    "same words",
    "same last words",
    "similar name",
    "only unit",
)
_ECHOES: Final = {"held", "echo", "applied", "cmd", "command", "in"}
DISTURBANCE: Final = "a disturbance, which may be left unconnected"
SWAPPED: Final = "are plant and controller swapped? The plant takes set points, and the controller none"
ORDER: Final = (SAME, SAME_WORDS, LAST_WORDS, LIKE)


@dataclass(frozen=True)
class Guess:
    """Guess at the source of an input."""

    target: str
    """The input, `component.variable`."""
    source: str | None
    """The output, or None where nothing fits."""
    reason: str
    """Similarity of the two, or the reason why there is no source."""
    is_likely: bool
    """True where name and unit agree; otherwise somebody should check it."""
    beside: str | None = None
    """Another input of the plant, which takes the output with a name like this one's: it may be a disturbance."""


def guess_connections(components: Mapping[str, Component]) -> list[Guess]:
    """Return a guess for every input, those of the controller first."""
    inputs = {
        f"{name}.{v.name}": v
        for name in (CONTROLLER, PLANT, REFERENCE)
        for v in (components[name].having("input") if name in components else ())
    }
    guesses: dict[str, Guess] = {}
    exact = _exact(inputs, components)
    set_points: set[str | None] = set()
    for target, v in sorted(inputs.items(), key=lambda item: not is_desired(item[1].name)):  # set points come first
        if is_disturbance(v):
            guesses[target] = Guess(target, None, DISTURBANCE, True)
            continue
        guesses[target] = guess = _guess(target, v, components, set_points, exact)
        set_points |= {guess.source} if is_desired(v.name) else set()
    used = {g.source for g in guesses.values()}
    ordered = [guesses[target] for target in inputs]
    is_open = [g.source is None and not g.is_likely and g.beside is None for g in ordered]
    return [_by_unit(g, used, components) if is_it else g for g, is_it in zip(ordered, is_open, strict=True)]


def alike(name: str, other: str) -> str | None:
    """Return the similarity of two names: one of the constants above, or None."""
    if name == other:
        return SAME
    words, others = stem(name), stem(other)
    if words == others:
        return SAME_WORDS
    short, long = sorted((words, others), key=len)
    if short and long[-len(short) :] == short and "der" not in long[: -len(short)]:
        return LAST_WORDS
    pair = SequenceMatcher(None, " ".join(words), " ".join(others))  # the quick ones are upper bounds
    is_like = all(ratio() >= _LIKE for ratio in (pair.real_quick_ratio, pair.quick_ratio, pair.ratio))
    is_like |= len(words) == len(others) > 0 and all(map(_is_short_for, words, others))
    return LIKE if is_like and ("der" in words) == ("der" in others) else None


def _is_short_for(word: str, other: str) -> bool:
    """Return whether two words are the same, or one begins the other with three letters or more: `pos`, `position`."""
    short, long = sorted((word, other), key=len)
    return long.startswith(short) and (len(short) >= _SHORT or short == long)


def have_one_unit(a: Component, name: str, b: Component, other: str) -> bool | None:
    """Return whether two variables are in the same unit; None where that is not known."""
    units = a.unit(name), b.unit(other)
    if None in units:
        return None
    try:
        return conversion(*units) == IDENTITY
    except ValueError:
        return False if all(u is not None and u.exponents is not None for u in units) else None


def best(name: str, owner: Component, others: Iterable[tuple[Component, ModelVariable]]) -> ModelVariable | None:
    """Return the variable of another FMU that a name best matches, in no other unit; None if there is none."""
    found: list[tuple[int, ModelVariable]] = []
    for component, v in others:
        how = alike(name, v.name)
        if how in (SAME, SAME_WORDS, LAST_WORDS) and have_one_unit(owner, name, component, v.name) is not False:
            found.append((ORDER.index(how), v))
    return min(found, key=lambda pair: pair[0])[1] if found else None


def is_likely(how: str | None, has_one_unit: bool | None) -> bool:
    """Return whether a guess needs no checking: the names have the same words, and the units are known to be equal."""
    return how in (SAME, SAME_WORDS) and bool(has_one_unit)


def is_desired(name: str) -> bool:
    """Return whether a name is that of a set point: phi_ref, r_d_x."""
    words = _words(name)
    return bool(_DESIRED & set(words)) or "d" in words[1:]


def are_swapped(components: Mapping[str, Component], connections: Iterable[tuple[str, str]]) -> bool:
    """Return whether plant and controller seem to be swapped: the plant takes set points, and the controller none.

    connections: each connected input with its source. A plant's set points are not those that the controller gives it,
    unless these are its states; and where the plant declares derivatives of its states and the controller none, it is
    taken for the plant that it is.
    """
    if PLANT not in components or CONTROLLER not in components:
        return False
    plant, controller = components[PLANT], components[CONTROLLER]
    if plant.derivatives and not controller.derivatives:
        return False
    own_states = {f"{CONTROLLER}.{name}" for name in controller.derivatives}
    given = {t for t, source in connections if source.startswith(f"{CONTROLLER}.") and source not in own_states}
    own = [name for name in _set_points(plant) if f"{PLANT}.{name}" not in given]
    return bool(own) and not _set_points(controller)


def _set_points(component: Component) -> list[str]:
    """Return the inputs that are named as set points."""
    return [v.name for v in component.having("input") if is_desired(v.name) and not is_disturbance(v)]


def echoes(component: Component) -> set[str]:
    """Return the outputs that only tell an input again, `V_held` beside the input `V`: no states, and not tracked."""
    inputs = {tuple(_words(v.name)) for v in component.having("input")}
    states = set(component.derivatives)
    outputs = {v.name: _words(v.name) for v in component.having("output") if v.name not in states}
    return {name for name, words in outputs.items() if words[-1:] and words[-1] in _ECHOES and (*words[:-1],) in inputs}


def sources(name: str, variable: str) -> tuple[str, ...]:
    """Return the components whose outputs may feed an input, the likeliest first."""
    if name == CONTROLLER:
        return (REFERENCE, PLANT) if is_desired(variable) else (PLANT, REFERENCE)
    return (CONTROLLER,) if name == PLANT else (PLANT,)


def _offers(
    name: str, v: ModelVariable, components: Mapping[str, Component]
) -> Iterator[tuple[int, str, ModelVariable]]:
    """Yield what may feed an input: place of the component among its sources, component and output.

    The plant's may also be fed with the reference's output of exactly its name.
    """
    others = sources(name, v.name)
    for place, other in enumerate(others):
        for o in components[other].having("output") if other in components else ():
            yield place, other, o
    if name == PLANT and REFERENCE in components and v.name in components[REFERENCE].outputs:
        yield len(others), REFERENCE, components[REFERENCE].outputs[v.name]


def _exact(inputs: Mapping[str, ModelVariable], components: Mapping[str, Component]) -> dict[tuple[str, str], str]:
    """Return the input that takes an output by its exact name, by the input's component and the output."""
    found: dict[tuple[str, str], str] = {}
    for target, v in inputs.items():
        name = VariableName(target).component
        offered = [] if is_disturbance(v) else _offers(name, v, components)
        others = (other for _, other, o in offered if o.name == v.name)
        source = next((other for other in others if _can_feed(components[other], components[name], v.name)), None)
        if source is not None:
            found[name, f"{source}.{v.name}"] = target
    return found


def _can_feed(source: Component, owner: Component, name: str) -> bool:
    """Return whether an output is in the unit of the input of its name, or can be converted to it."""
    is_one = have_one_unit(source, name, owner, name)
    return is_one is not False or _can_be_converted(source.unit(name), owner.unit(name))


def _guess(
    target: str,
    v: ModelVariable,
    components: Mapping[str, Component],
    taken: Container[str | None],
    exact: Mapping[tuple[str, str], str],
) -> Guess:
    """Return the guess for an input.

    taken: outputs that are set points of another input, and so measure nothing; exact: see `_exact`.
    """
    name = VariableName(target).component
    found: list[tuple[bool, int, int, float, str, str, bool]] = []
    beside: list[tuple[int, str, str]] = []
    for place, other, o in _offers(name, v, components):
        source = f"{other}.{o.name}"
        how, unit = alike(v.name, o.name), have_one_unit(components[name], v.name, components[other], o.name)
        if how is None or unit is False:
            continue
        ratio = SequenceMatcher(None, v.name, o.name).ratio()
        reason = f"{how}, {'same unit' if unit else 'no unit to compare'}"
        is_crossed = is_desired(v.name) != is_desired(o.name)  # a measurement and a set point
        is_measured = is_desired(v.name) and other == PLANT  # is no set point
        if is_crossed and (source in taken or is_measured):
            continue
        if (its := _other_taker(target, source, exact)) is not None:
            beside.append((ORDER.index(how), its, source))
            continue
        is_weather = name == PLANT and other == REFERENCE  # comes after the controller's of the same words
        order = max(ORDER.index(how), ORDER.index(SAME_WORDS) if is_weather else 0)
        found.append((is_crossed, order, place, -ratio, source, reason, is_likely(how, unit) and not is_weather))
    if not found:
        return _converted(target, v, components, exact) or _nothing(target, beside)
    found.sort()
    source, reason, likely = found[0][4:]
    rival = next((f"; or {other[4]}" for other in found[1:] if other[:3] == found[0][:3]), "")
    return Guess(target, source, reason + rival, likely and not rival)


def _other_taker(target: str, source: str, exact: Mapping[tuple[str, str], str]) -> str | None:
    """Return the other input of the component that takes an output by its exact name, or None.

    Several inputs may take a set point of the reference.
    """
    component, name = VariableName(target).parts
    its = exact.get((component, source), target)
    is_shared = VariableName(source).component == REFERENCE and is_desired(name)
    return None if its == target or is_shared else its


def _nothing(target: str, beside: Iterable[tuple[int, str, str]]) -> Guess:
    """Return the guess for an input without a source; beside: likeness, input and output of those that are taken."""
    _, its, source = min(beside, default=(0, None, ""))
    if its is None:
        return Guess(target, None, "no output has a name like it", False)
    reason = f"the output with a name like it, {source}, goes to {its}"
    return Guess(target, None, reason, False, its if VariableName(target).component == PLANT else None)


def _converted(
    target: str, v: ModelVariable, components: Mapping[str, Component], exact: Mapping[tuple[str, str], str]
) -> Guess | None:
    """Return a guess with an output of the same words in another unit, which a run converts; or None."""
    name = VariableName(target).component
    for _, other, o in _offers(name, v, components):
        units = components[other].unit(o.name), components[name].unit(v.name)
        if _other_taker(target, f"{other}.{o.name}", exact) is not None:
            continue
        if alike(v.name, o.name) not in (SAME, SAME_WORDS) or is_desired(v.name) != is_desired(o.name):
            continue
        if units[0] is not None and _can_be_converted(*units):
            reason = f"{alike(v.name, o.name)}, converted from {units[0].name}"
            return Guess(target, f"{other}.{o.name}", reason, False)
    return None


def _can_be_converted(one: Unit | None, other: Unit | None) -> bool:
    try:
        conversion(one, other)
    except ValueError:
        return False
    return True


def _by_unit(guess: Guess, used: Iterable[str | None], components: Mapping[str, Component]) -> Guess:
    """Return a guess with the only output left in the input's unit, or the only one left where a unit is not known.

    The guess as it is if there is not exactly one. Derivatives are left out where the unit is not known.
    """
    name, variable = VariableName(guess.target).parts
    other = sources(name, variable)[0]
    owner = components.get(other)
    echoed = echoes(owner) if owner else set[str]()
    left = [o.name for o in owner.having("output") if o.name not in echoed] if owner else []
    free = [o for o in left if f"{other}.{o}" not in used]
    units = {o: have_one_unit(components[name], variable, components[other], o) for o in free}
    same = [o for o in free if units[o]]
    rates = set(owner.derivatives.values()) if owner else set[str]()
    open_ones = [o for o in free if units[o] is not False and o not in rates]
    if len(same) == 1:
        return Guess(guess.target, f"{other}.{same[0]}", "the only output left in this unit, by another name", False)
    if not same and len(open_ones) == 1:
        return Guess(guess.target, f"{other}.{open_ones[0]}", "the only output left, no unit to compare", False)
    return guess


def _words(name: str) -> list[str]:
    return [word.lower() for word in _WORDS.findall(name)]


@lru_cache(maxsize=100_000)
def stem(name: str) -> list[str]:
    """Return the words of a name without those that denote a role."""
    words = _words(name)
    return [w for i, w in enumerate(words) if w not in _ROLES and not (i and w == "d")] or words
