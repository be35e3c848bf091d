"""What may cross into and out of an FMU: which variables in which role, and which values."""

import difflib
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, SupportsFloat

from fmpy.model_description import ModelVariable

from ..errors import WiringError
from .value_buffers import Value, Variable

_LARGEST: Final = sys.float_info.max
_DEFAULT_RANGE: Final = {
    "Integer": (-(2.0**31) + 1, 2.0**31 - 1), "Boolean": (0.0, 1.0),
    **{f"Int{bits}": (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1) - 1) for bits in (8, 16, 32)},
    **{f"UInt{bits}": (0.0, 2.0**bits - 1) for bits in (8, 16, 32)},
    "Int64": (-(2.0**53), 2.0**53), "UInt64": (0.0, 2.0**53),  # what a double holds exactly
}  # fmt: skip
_ANY_NUMBER: Final = (-_LARGEST, _LARGEST)
_NOT_WHOLE: Final = ("Real", "Float32", "Float64")
_NO_NUMBERS: Final = ("String", "Binary", "Clock")


class Ports:
    """Variables whose values cross together: their names, and the values they may have."""

    def __init__(self, role: str, variables: Sequence[ModelVariable], is_lenient: bool = False) -> None:
        """is_lenient: min and max are not looked at by `problem`, but by `strayed`."""
        self.variables = [Variable(v.name, _type_of(v), v.valueReference) for v in variables]
        self._role = role
        self._units = [attribute(v, "unit") or "" for v in variables]
        self._declared = [_range_of(v) for v in variables]
        self._ranges = [_default_range(v) for v in variables] if is_lenient else self._declared
        self._whole = [i for i, v in enumerate(self.variables) if v.type not in _NOT_WHOLE]
        self._bounded = [(i, *limits) for i, limits in enumerate(self._ranges) if limits != _ANY_NUMBER]

    def problem(self, values: Sequence[float]) -> str | None:
        """What is wrong with the first value that is not finite, outside [min, max] or not of its type, or None."""
        if math.isfinite(sum(values)):  # all are finite then: the sum of others is an infinity or NaN
            for i, low, high in self._bounded:
                if not low <= values[i] <= high:
                    break
            else:
                return self._fraction(values) if self._whole else None
        return self._first_problem(values)

    def strayed(self, values: Sequence[float]) -> Iterator[tuple[str, str]]:
        """Name, and what is wrong, of each value outside the declared [min, max]."""
        for i, (value, limits) in enumerate(zip(values, self._declared, strict=True)):
            if not limits[0] <= value <= limits[1]:
                yield self.variables[i].name, self._out_of_range(i, value, limits)

    def _first_problem(self, values: Sequence[float]) -> str | None:
        for i, (value, (low, high)) in enumerate(zip(values, self._ranges, strict=True)):
            if not low <= value <= high:  # NaN is in no range
                return self._out_of_range(i, value, (low, high))
        return self._fraction(values)

    def _fraction(self, values: Sequence[float]) -> str | None:
        for i in self._whole:
            if values[i] != int(values[i]):
                return f"{self._role} {self.variables[i].name!r} must be a whole number, got {values[i]:g}"
        return None

    def _out_of_range(self, i: int, value: float, limits: tuple[float, float]) -> str:
        name = f"{self._role} {self.variables[i].name!r}"
        if not math.isfinite(value):
            return f"{name} is {value:g}"
        low, high = map(_bound, limits)
        return f"{name} must be within {f'[{low}, {high}] {self._units[i]}'.rstrip()}, got {value:.9g}"


class Catalogue:
    """The variables of one FMU, by name."""

    def __init__(self, fmu_name: str, variables: Iterable[ModelVariable]) -> None:
        self._fmu_name = fmu_name
        self._variables = {v.name: v for v in variables}

    def ports(self, role: str, names: Sequence[str], is_lenient: bool = False) -> Ports:
        """The variables of these names, in the role 'input', 'tunable parameter' or 'output'.

        An input or tunable parameter must be one; an output may be anything but a String. Raises WiringError.
        """
        return Ports(role.removeprefix("tunable "), [self._in_role(name, role) for name in names], is_lenient)

    def start_port(self, name: str, value: Value) -> Ports:
        """The variable of that name, if it takes a start value of value's type; its range is not looked at.

        Raises WiringError.
        """
        variable = self._known(name)
        takes_start = variable.causality == "input" or variable.initial in ("exact", "approx")
        if not takes_start or variable.variability == "constant" or variable.causality == "independent":
            kind = _with_article(kind_of(variable))
            initial = f", initial {variable.initial}" if variable.initial else ""
            raise WiringError(f"{name!r} of {self._fmu_name} takes no start value: it is {kind}{initial}.")
        its_type = _type_of(variable)
        is_fit = isinstance(value, str) if its_type in _NO_NUMBERS else isinstance(value, SupportsFloat)
        if not is_fit or (isinstance(value, bool) and its_type != "Boolean"):
            raise WiringError(f"{name!r} of {self._fmu_name} is a {its_type} and cannot start as {value!r}.")
        return Ports(kind_of(variable), [variable])

    def _in_role(self, name: str, role: str) -> ModelVariable:
        variable = self._known(name)
        kind = kind_of(variable)
        if role != "output" and kind != role:
            raise WiringError(f"{name!r} of {self._fmu_name} is {_with_article(kind)}, not {_with_article(role)}.")
        if not is_numeric(variable):
            raise WiringError(f"{name!r} of {self._fmu_name} is a {variable.type} and cannot be exchanged.")
        return variable

    def _known(self, name: str) -> ModelVariable:
        variable = self._variables.get(name)
        if variable is not None:
            return variable
        message = f"no variable {name!r} in {self._fmu_name}"
        for match in difflib.get_close_matches(name, self._variables, n=1):
            message += f"; did you mean {match!r} ({_with_article(kind_of(self._variables[match]))})?"
        raise WiringError(message)


def is_numeric(variable: ModelVariable) -> bool:
    """Its values can be exchanged at communication points."""
    return variable.type not in _NO_NUMBERS


def kind_of(variable: ModelVariable) -> str:
    """What a variable is, in words: 'input', 'tunable parameter', 'local variable', ..."""
    if variable.variability == "constant":
        return "constant"
    if variable.causality == "parameter":
        return f"{variable.variability} parameter"
    return {"calculatedParameter": "calculated parameter", "local": "local variable"}.get(
        variable.causality, str(variable.causality)
    )


def _with_article(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _type_of(variable: ModelVariable) -> str:
    return "Integer" if variable.type == "Enumeration" else str(variable.type)


def attribute(variable: ModelVariable, name: str) -> str | None:
    """The unit, min or max of a variable: its own, or its declared type's."""
    own = getattr(variable, name)
    return own if own is not None or variable.declaredType is None else getattr(variable.declaredType, name)


def _default_range(variable: ModelVariable) -> tuple[float, float]:
    """The finite numbers that a variable of its type can be."""
    return _DEFAULT_RANGE.get(_type_of(variable), _ANY_NUMBER)


def _range_of(variable: ModelVariable) -> tuple[float, float]:
    """The finite numbers that a variable may be."""
    low, high = _default_range(variable)
    declared_low, declared_high = attribute(variable, "min"), attribute(variable, "max")
    return (
        low if declared_low is None else max(low, float(declared_low)),
        high if declared_high is None else min(high, float(declared_high)),
    )


def _bound(bound: float) -> str:
    return f"{math.copysign(math.inf, bound):g}" if abs(bound) == _LARGEST else f"{bound:.10g}"
