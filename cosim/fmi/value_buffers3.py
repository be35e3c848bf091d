"""The arrays in which values are handed to FMI 3.0's C functions: whole variables, of which some elements are named."""

import ctypes
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from fmpy.model_description import ModelDescription

from .elements import of_handle, starts_of
from .value_buffers import Variable

_C_TYPES: Final[dict[str, Any]] = {
    "Float32": ctypes.c_float, "Float64": ctypes.c_double, "Boolean": ctypes.c_bool,
    "Int8": ctypes.c_int8, "Int16": ctypes.c_int16, "Int32": ctypes.c_int32, "Int64": ctypes.c_int64,
    "UInt8": ctypes.c_uint8, "UInt16": ctypes.c_uint16, "UInt32": ctypes.c_uint32, "UInt64": ctypes.c_uint64,
}  # fmt: skip

Arrays = dict[int, list[float]]
"""Values of all elements, by value reference."""


def start_arrays(description: ModelDescription) -> Arrays:
    """What each numeric variable is before anybody has set it; zero where the description does not say."""
    return {
        v.valueReference: [_number(start) for start in starts_of(v)]
        for v in description.modelVariables
        if v.type in _C_TYPES or v.type == "Enumeration"
    }


class Block3:
    """The variables of one type among those that are set or got together, in arrays that live as long as the FMU.

    FMI 3.0 sets an array as a whole: elements that nobody names keep the values of `arrays`.
    """

    def __init__(self, kind: str, variables: Sequence[Variable], positions: Sequence[int], arrays: Arrays) -> None:
        self.getter, self.setter = f"fmi3Get{kind}", f"fmi3Set{kind}"
        self.positions = tuple(positions)
        places = [of_handle(variables[i][2]) for i in positions]
        first: dict[int, int] = {}
        n = 0
        for reference, _ in places:
            if reference not in first:
                first[reference] = n
                n += len(arrays[reference])
        self._first = first
        self._places = [first[reference] + element for reference, element in places]
        self._is_whole = self._places == list(range(n))
        self._references = (ctypes.c_uint * len(first))(*first)
        self._values: Any = (_C_TYPES[kind] * n)()
        self._convert: Any = bool if kind == "Boolean" else float if kind.startswith("Float") else int
        self._unfilled = [math.nan] * n if kind.startswith("Float") else None
        self.arguments = (self._references, len(first), self._values, n)

    def start(self, arrays: Arrays) -> None:
        """Take the elements that nobody names from these values."""
        for reference, at in self._first.items():
            values = arrays[reference]
            self._values[at : at + len(values)] = [self._convert(value) for value in values]

    def fill(self, values: Sequence[float]) -> None:
        """Put into the array what belongs to this block among all the values that are set together."""
        if self._is_whole and self._convert is float and len(values) == len(self.positions):
            self._values[:] = values
            return
        for place, i in zip(self._places, self.positions, strict=True):
            self._values[place] = self._convert(values[i])

    def clear(self) -> None:
        """Mark every floating-point value as not filled."""
        if self._unfilled is not None:
            self._values[:] = self._unfilled

    def read(self) -> list[float]:
        """The values of the variables that were named; NaN where a get has filled nothing."""
        values = self._values[:]
        return values if self._is_whole else [values[place] for place in self._places]


def blocks3_of(variables: Sequence[Variable], arrays: Arrays) -> list[Block3]:
    """variables grouped by type, each group in its order."""
    positions: dict[str, list[int]] = {}
    for i, variable in enumerate(variables):
        positions.setdefault(variable[1], []).append(i)
    return [Block3(kind, variables, of_kind, arrays) for kind, of_kind in positions.items()]


def overlaid(arrays: Mapping[int, Sequence[float]], values: Mapping[int, float]) -> Arrays:
    """The arrays with some elements replaced, by their handles."""
    result = {reference: list(elements) for reference, elements in arrays.items()}
    for number, value in values.items():
        reference, element = of_handle(number)
        result[reference][element] = value
    return result


def _number(start: str | None) -> float:
    return float(start in ("true", "1")) if start in ("true", "false") else float(start or 0.0)
