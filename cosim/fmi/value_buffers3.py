"""The arrays in which values are handed to the C functions of FMI 3.0: whole variables, some elements of them bound."""

import ctypes
import math
from collections.abc import Mapping, Sequence
from typing import Any

from fmpy.model_description import ModelDescription

from .elements import of_handle, starts_of
from .types import TYPES
from .value_buffers import ScalarVariable, positions_by_type

Arrays = dict[int, list[float]]
"""Values of all elements of each variable, by value reference."""


def start_arrays(description: ModelDescription) -> Arrays:
    """Return the start values of each numeric variable; zero where the description has none."""
    return {
        v.valueReference: [_number(start) for start in starts_of(v)]
        for v in description.modelVariables
        if TYPES[v.type].is_numeric
    }


class ValueBuffer3:
    """The variables of one type among those that are set or got together, in arrays that live as long as the FMU.

    FMI 3.0 sets an array as a whole: elements that are not bound keep the values of `arrays`.
    """

    def __init__(
        self, type_name: str, variables: Sequence[ScalarVariable], positions: Sequence[int], arrays: Arrays
    ) -> None:
        fmi_type = TYPES[type_name]
        access = fmi_type.fmi3
        assert access is not None
        self.getter, self.setter = f"fmi3Get{access.functions}", f"fmi3Set{access.functions}"
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
        self._values: Any = (access.c_type * n)()
        self._convert: Any = fmi_type.python
        self._unfilled = [math.nan] * n if fmi_type.is_real else None
        self.arguments = (self._references, len(first), self._values, n)

    def start(self, arrays: Arrays) -> None:
        """Take the elements that are not bound from these values."""
        for reference, at in self._first.items():
            values = arrays[reference]
            self._values[at : at + len(values)] = [self._convert(value) for value in values]

    def fill(self, values: Sequence[float]) -> None:
        """Put into the array what belongs to this buffer among all the values that are set together."""
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
        """Return the values of the bound variables; NaN where a get has filled nothing."""
        values = self._values[:]
        return values if self._is_whole else [values[place] for place in self._places]


def buffers3_of(variables: Sequence[ScalarVariable], arrays: Arrays) -> list[ValueBuffer3]:
    """Return a buffer for each type of the variables, each in their order."""
    return [
        ValueBuffer3(kind, variables, positions, arrays) for kind, positions in positions_by_type(variables).items()
    ]


def overlaid(arrays: Mapping[int, Sequence[float]], values: Mapping[int, float]) -> Arrays:
    """Return the arrays with some elements replaced, by their handles."""
    result = {reference: list(elements) for reference, elements in arrays.items()}
    for number, value in values.items():
        reference, element = of_handle(number)
        result[reference][element] = value
    return result


def _number(start: str | None) -> float:
    return float(start in ("true", "1")) if start in ("true", "false") else float(start or 0.0)
