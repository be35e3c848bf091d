"""Variables of an FMU, and the arrays in which their values are handed to its C functions."""

import math
import struct
from collections.abc import Sequence
from ctypes import c_double, c_int, c_size_t, c_uint
from typing import Any, Final, NamedTuple, TypeAlias

Value: TypeAlias = float | int | bool | str
PYTHON_TYPE: Final[dict[str, type]] = {"Real": float, "Integer": int, "Boolean": bool, "String": str} | {
    **dict.fromkeys(("Float32", "Float64"), float),
    **{f"{sign}Int{bits}": int for sign in ("", "U") for bits in (8, 16, 32, 64)},
}
"""Of a Value, by the type of its variable."""

_UNFILLED: Final = -(2**31)  # what an Integer or Boolean that a get left alone reads as; reported as NaN


class Variable(NamedTuple):
    """A scalar variable of a model description, as far as calls need it."""

    name: str
    type: str
    """'Real', 'Integer', 'Boolean' or 'String', an enumeration an Integer; or a type of FMI 3.0."""
    reference: int
    """The value reference; of FMI 3.0, with the place in an array: `elements.handle`."""


class Block:
    """The variables of one type among those that are set or got together, in arrays that live as long as the FMU."""

    def __init__(self, kind: str, variables: Sequence[Variable], positions: Sequence[int]) -> None:
        self.getter, self.setter = f"get_{kind.lower()}", f"set_{kind.lower()}"
        self.is_real = kind == "Real"
        self.positions = tuple(positions)
        references = [variables[i][2] for i in positions]
        self._references = (c_uint * len(positions))(*references)
        self._values: Any = ((c_double if self.is_real else c_int) * len(positions))()
        self._pack = struct.Struct(f"{len(positions)}{'d' if self.is_real else 'i'}")
        self._memory = memoryview(self._values).cast("B")
        self._unfilled = self._pack.pack(*([math.nan if self.is_real else _UNFILLED] * len(positions)))
        self.arguments = (self._references, c_size_t(len(positions)), self._values)
        """References, their number, values: ctypes objects, so that a call has nothing to convert."""

    def fill(self, values: Sequence[float]) -> None:
        """Put into the array what belongs to this block among all the values that are set together."""
        if not self.is_real:
            values = [int(values[i]) for i in self.positions]
        elif len(values) != len(self.positions):
            values = [values[i] for i in self.positions]
        self._pack.pack_into(self._values, 0, *values)

    def clear(self) -> None:
        """Mark every value as not filled."""
        self._memory[:] = self._unfilled

    def read(self) -> tuple[float, ...]:
        """The array's values; NaN where a get has filled nothing."""
        values = self._pack.unpack(self._memory)
        return values if self.is_real else tuple(math.nan if v == _UNFILLED else float(v) for v in values)


def blocks_of(variables: Sequence[Variable]) -> list[Block]:
    """variables grouped by type, each group in its order."""
    positions: dict[str, list[int]] = {}
    for i, variable in enumerate(variables):
        positions.setdefault(variable[1], []).append(i)
    return [Block(kind, variables, of_kind) for kind, of_kind in positions.items()]
