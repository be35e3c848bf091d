"""Scalar variables of an FMU, and the arrays in which their values are handed to the C functions of FMI 2.0."""

import math
import struct
from collections.abc import Sequence
from ctypes import c_size_t, c_uint
from typing import Any, NamedTuple

from .types import TYPES, UNFILLED


class ScalarVariable(NamedTuple):
    """A scalar variable of a model description, as far as calls need it."""

    name: str
    type: str
    """A type of `TYPES`, an Enumeration as the type whose functions set and get it."""
    reference: int
    """The value reference; in FMI 3.0 with the place in an array: see `elements.handle`."""


class ValueBuffer:
    """The variables of one type among those that are set or got together, in arrays that live as long as the FMU."""

    def __init__(self, type_name: str, variables: Sequence[ScalarVariable], positions: Sequence[int]) -> None:
        access = TYPES[type_name].fmi2
        assert access is not None
        self.getter, self.setter = f"get_{access.functions.lower()}", f"set_{access.functions.lower()}"
        self.positions = tuple(positions)
        n = len(positions)
        self._is_real = TYPES[type_name].is_real
        self._references = (c_uint * n)(*[variables[i][2] for i in positions])
        self._values: Any = (access.c_type * n)()
        self._pack = struct.Struct(f"{n}{memoryview(access.c_type()).format[-1]}")
        self._memory = memoryview(self._values).cast("B")
        self._unfilled = self._pack.pack(*([math.nan if self._is_real else UNFILLED] * n))
        self.arguments = (self._references, c_size_t(n), self._values)
        """References, their number, values: ctypes objects, so that a call has nothing to convert."""

    def fill(self, values: Sequence[float]) -> None:
        """Put into the array what belongs to this buffer among all the values that are set together."""
        if not self._is_real:
            values = [int(values[i]) for i in self.positions]
        elif len(values) != len(self.positions):
            values = [values[i] for i in self.positions]
        self._pack.pack_into(self._values, 0, *values)

    def clear(self) -> None:
        """Mark every value as not filled."""
        self._memory[:] = self._unfilled

    def read(self) -> tuple[float, ...]:
        """Return the array's values; NaN where a get has filled nothing."""
        values = self._pack.unpack(self._memory)
        return values if self._is_real else tuple(math.nan if v == UNFILLED else float(v) for v in values)


def buffers_of(variables: Sequence[ScalarVariable]) -> list[ValueBuffer]:
    """Return a buffer for each type of the variables, each in their order."""
    return [ValueBuffer(kind, variables, positions) for kind, positions in positions_by_type(variables).items()]


def positions_by_type(variables: Sequence[ScalarVariable]) -> dict[str, list[int]]:
    """Return the positions of the variables of each type, in the order in which the types come."""
    positions: dict[str, list[int]] = {}
    for i, variable in enumerate(variables):
        positions.setdefault(variable[1], []).append(i)
    return positions
