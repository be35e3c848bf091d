"""Arrays of FMI 3.0 as their elements, so that everything above an FMU's calls knows scalars only.

Element (1, 2) of R is named R[1,2], of der(R) der(R[1,2]), in the structured naming convention of FMI. Where an FMU has
no variable of a name, r_x is another name of r[1] and R_12 of R[1,2]: scenarios hold for FMUs of either version.
"""

import copy
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from math import prod
from typing import Any, Final, cast

from fmpy.model_description import ModelDescription, ModelVariable

from .types import TYPES

_AXES: Final = "xyz"
_ELEMENT = re.compile(r"(?P<stem>.*?\w)(?P<held>_held)?\[(?P<index>\d+(,\d+)*)\](?P<end>\)?)")


def handle(reference: int, place: int) -> int:
    """Return one number for a value reference and an element's place in its array; the reference itself for place 0."""
    return place << 32 | reference


def of_handle(number: int) -> tuple[int, int]:
    """Return the value reference and the place that a handle stands for."""
    return number & 0xFFFFFFFF, number >> 32


def scalarized(description: ModelDescription) -> ModelDescription:
    """Return a copy of the description with every array replaced by its elements, the last index fastest.

    A `valueReference` is a `handle` then, an Enumeration of the type whose functions set and get it.
    """
    elements = {id(v): _elements(v) for v in description.modelVariables}
    for v in description.modelVariables:
        if v.derivative is not None:
            for rate, state in zip(elements[id(v)], elements[id(v.derivative)], strict=True):
                rate.derivative = state
    result = copy.copy(description)
    result.modelVariables = [element for parts in elements.values() for element in parts]
    return result


def starts_of(variable: ModelVariable) -> Sequence[str | None]:
    """Return the start value of each element: one value is that of all."""
    n = prod(variable.shape or ())
    if not variable.shape or variable.start is None or TYPES[variable.type].is_text:
        return [variable.start] * n
    starts = variable.start.split()
    return starts * n if len(starts) == 1 else starts


def element_names(name: str, shape: Iterable[int]) -> list[str]:
    """Return the names of an array's elements: der(r), (3,) -> der(r[1]), der(r[2]), der(r[3])."""
    stem, end = (name[:-1], ")") if name.endswith(")") else (name, "")
    indices = product(*(range(1, n + 1) for n in shape))
    return [f"{stem}[{','.join(map(str, index))}]{end}" for index in indices]


def indices_of(name: str) -> tuple[int, ...]:
    """Return the indices of an element, none for a scalar: R[1,2] -> (1, 2), der(r[3]) -> (3,)."""
    match = _ELEMENT.fullmatch(name)
    return () if match is None else tuple(int(i) for i in match["index"].split(","))


def plain(name: str) -> str:
    """Return the other name of an element: r[1] -> r_x, R[1,2] -> R_12, der(r[1]) -> der(r_x); else the name itself."""
    match = _ELEMENT.fullmatch(name)
    if match is None:
        return name
    index = indices_of(name)
    if len(index) == 1 and index[0] > len(_AXES):
        return name
    subscript = _AXES[index[0] - 1] if len(index) == 1 else "".join(map(str, index))
    return f"{match['stem']}_{subscript}{match['held'] or ''}{match['end']}"


def resolved(name: str, known: Mapping[str, object]) -> str:
    """Return the name of a variable in `known`; the name itself where it has none."""
    if name in known:
        return name
    return next((k for k in known if plain(k) == plain(name)), name)


def _elements(variable: ModelVariable) -> list[ModelVariable]:
    parts: list[ModelVariable] = []
    names = element_names(variable.name, variable.shape) if variable.shape else [variable.name]
    for place, (name, start) in enumerate(zip(names, starts_of(variable), strict=True)):
        part = copy.copy(variable)
        part.name, part.start, part.shape, part.dimensions = name, start, (), []
        part.valueReference = handle(variable.valueReference, place)
        access = TYPES[part.type].fmi3
        if access is not None:
            part.type = cast(Any, access.functions)
        parts.append(part)
    return parts
