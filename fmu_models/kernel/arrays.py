"""Variables of FMI 3.0, where three axes are a vector and nine elements a matrix. Standard library only.

r_x, r_y, r_z -> r[3];  M_x_held, ... -> M_held[3];  R_11, R_12, ..., R_33 -> R[3,3], row by row;
der(v_x), ... -> der(v)[3]. They must be neighbours in the table and differ in nothing but name, text and start.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, fields

from .description import VariableRow

_AXES = "xyz"
_ELEMENTS = tuple(f"{i}{j}" for i in "123" for j in "123")


@dataclass(frozen=True)
class Array:
    """Variable of FMI 3.0: neighbours in a table, or one row of it."""

    name: str
    """FMI name."""
    description: str
    """One line for the user."""
    members: tuple[VariableRow, ...]
    """Elements, the last index fastest; one where it is a scalar."""
    shape: tuple[int, ...] = ()
    """Sizes of its dimensions; none for a scalar."""


def arrays(variables: Sequence[VariableRow]) -> list[Array]:
    """Return the variables of the table, with the elements of vectors and matrices joined."""
    found: list[Array] = []
    names = {v.name for v in variables}
    i = 0
    while i < len(variables):
        array = next((a for a in _candidates(variables, i) if a.name not in names), None)
        found.append(array or Array(variables[i].name, variables[i].description, (variables[i],)))
        i += len(found[-1].members)
    return found


def _candidates(variables: Sequence[VariableRow], i: int) -> list[Array]:
    """Return the matrix and the vector that begin at row i, if any."""
    candidates: list[Array] = []
    for subscripts, shape in ((_ELEMENTS, (3, 3)), (_AXES, (3,))):
        members = tuple(variables[i : i + len(subscripts)])
        stem = _stem(members[0].name, subscripts[0])
        names = [_stem(v.name, subscript) for v, subscript in zip(members, subscripts)]
        if stem and names == [stem] * len(subscripts) and len({_kind(v) for v in members}) == 1:
            candidates.append(Array(stem, _description(members[0], subscripts), members, shape))
    return candidates


def _stem(name: str, subscript: str) -> str | None:
    """Return the name without its subscript, or None where it has another: der(r_x), x -> der(r)."""
    stem, count = re.subn(rf"(\w)_{subscript}(_held)?(\)?)$", r"\1\2\3", name)
    return stem if count else None


def _kind(v: VariableRow) -> tuple[object, ...]:
    """Return the attributes that elements of one array have in common."""
    different = {"name", "description", "start", "dependencies", "derivative"}
    return (v.type, *(getattr(v, field.name) for field in fields(v) if field.name not in different))


def _description(first: VariableRow, subscripts: Sequence[str]) -> str:
    """Return the description of the array, from that of its first element."""
    if len(subscripts) == 9:
        return first.description.replace("row 1, column 1", "row by row").replace("_11", "")
    text = first.description.replace("_x", "")
    return re.sub(r"\bx\b", "x, y, z", text)
