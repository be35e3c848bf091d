"""The types of FMI's variables, versions 2.0 and 3.0: one table, from which all that depends on a type derives.

A new type of FMI is one row here. What is read off a row: the arrays that cross to the FMU's C functions, the values
that a variable may have, how a start value is given and checked, and its names in SSP and SSV files.
"""

from ctypes import (
    c_bool,
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_int8,
    c_int16,
    c_int32,
    c_int64,
    c_uint8,
    c_uint16,
    c_uint32,
    c_uint64,
    sizeof,
)
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, TypeAlias

Value: TypeAlias = float | int | bool | str
"""A value that a variable can be set to by name."""

UNFILLED: Final = -(2**31)
"""Mark of an FMI 2.0 integer or Boolean that a get has not filled; the lowest c_int, which is no value of one."""
_EXACT: Final = 2**53  # a double holds every whole number up to this one


class Access(NamedTuple):
    """Functions and C type with which one version of FMI exchanges the values of a type."""

    functions: str
    """The type in the names of the functions that set and get it: 'Int64' for fmi3SetInt64."""
    c_type: Any
    """The C type of one value."""


@dataclass(frozen=True)
class FmiType:
    """A type of FMI's variables."""

    name: str
    """Its XML element in a model description."""
    python: type[float | str | bytes] | None
    """The Python type of a value; None for a type without values."""
    ssp: str | None
    """Its XML element in files of SSP 1.0; None where SSP has none. SSP 2.0 knows `name` too."""
    fmi2: Access | None = None
    """Its functions in FMI 2.0; None where that has no such type, or its values are not exchanged."""
    fmi3: Access | None = None
    """Its functions in FMI 3.0; None as above."""

    @property
    def is_real(self) -> bool:
        """True where its values are real numbers."""
        return self.python is float

    @property
    def is_double(self) -> bool:
        """True where its values are doubles, as those of most variables are."""
        access = self.fmi2 or self.fmi3
        return access is not None and access.c_type is c_double

    @property
    def is_whole(self) -> bool:
        """True where its values are whole numbers, Booleans (0 and 1) included."""
        return self.python in (int, bool)

    @property
    def is_numeric(self) -> bool:
        """True where its values are numbers, which can be exchanged at communication points."""
        return self.is_real or self.is_whole

    @property
    def is_text(self) -> bool:
        """True where it has an XML element for each start value, of which FMPy keeps the first, whitespace included."""
        return self.python in (str, bytes)

    @property
    def limits(self) -> tuple[int, int] | None:
        """Smallest and largest number of a whole type that a double holds exactly; None for any other type."""
        if self.python is bool:
            return 0, 1
        access = self.fmi2 or self.fmi3
        if self.python is not int or access is None:
            return None
        n_values = 2 ** (8 * sizeof(access.c_type))
        is_signed = access.c_type(-1).value < 0
        low, high = (-n_values // 2, n_values // 2 - 1) if is_signed else (0, n_values - 1)
        lowest = UNFILLED + 1 if self.fmi2 else low
        return max(lowest, -_EXACT), min(high, _EXACT)


_ROWS: Final = (
    #       name           Python  SSP 1.0        FMI 2.0                       FMI 3.0
    FmiType("Real",        float,  "Real",        Access("Real", c_double)),
    FmiType("Integer",     int,    "Integer",     Access("Integer", c_int)),
    FmiType("Boolean",     bool,   "Boolean",     Access("Boolean", c_int),     Access("Boolean", c_bool)),
    FmiType("String",      str,    "String",      Access("String", c_char_p),   Access("String", c_char_p)),
    FmiType("Enumeration", int,    "Enumeration", Access("Integer", c_int),     Access("Int64", c_int64)),
    FmiType("Float64",     float,  "Real",        None,                         Access("Float64", c_double)),
    FmiType("Float32",     float,  "Real",        None,                         Access("Float32", c_float)),
    FmiType("Int8",        int,    "Integer",     None,                         Access("Int8", c_int8)),
    FmiType("Int16",       int,    "Integer",     None,                         Access("Int16", c_int16)),
    FmiType("Int32",       int,    "Integer",     None,                         Access("Int32", c_int32)),
    FmiType("Int64",       int,    "Integer",     None,                         Access("Int64", c_int64)),
    FmiType("UInt8",       int,    "Integer",     None,                         Access("UInt8", c_uint8)),
    FmiType("UInt16",      int,    "Integer",     None,                         Access("UInt16", c_uint16)),
    FmiType("UInt32",      int,    "Integer",     None,                         Access("UInt32", c_uint32)),
    FmiType("UInt64",      int,    "Integer",     None,                         Access("UInt64", c_uint64)),
    FmiType("Binary",      bytes,  "Binary"),
    FmiType("Clock",       None,   None),
)  # fmt: skip
TYPES: Final = {row.name: row for row in _ROWS}
"""Every type by its name."""


def is_real(type_name: str) -> bool:
    """Return whether variables of a type are real numbers."""
    return TYPES[type_name].is_real
