"""Variables that may be set and got in an FMU: by name, role and limits of their values."""

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, SupportsFloat

from fmpy.model_description import ModelVariable

from ..errors import WiringError
from ..names import close_match
from .elements import of_handle
from .types import TYPES, FmiType, Value
from .value_buffers import ScalarVariable

_LARGEST: Final = sys.float_info.max
_ANY_NUMBER: Final = (-_LARGEST, _LARGEST)


class Ports:
    """Variables that are set or got together: their names, and the values they may have."""

    def __init__(self, role: str, variables: Sequence[ModelVariable], is_lenient: bool = False) -> None:
        """is_lenient: min and max are not checked by `problem`, but by `out_of_range`."""
        self.variables = [ScalarVariable(v.name, _type_of(v), v.valueReference) for v in variables]
        self._role = role
        self._units = [attribute(v, "unit") or "" for v in variables]
        is_read = role == "output"  # a parameter that is read back was checked when it was set, before any rounding
        self._declared = [
            _default_range(v) if is_read and v.causality == "parameter" else _range_of(v) for v in variables
        ]
        self._ranges = [_default_range(v) for v in variables] if is_lenient else self._declared
        self._whole = [i for i, v in enumerate(self.variables) if TYPES[v.type].is_whole]
        self._bounded = [(i, *limits) for i, limits in enumerate(self._ranges) if limits != _ANY_NUMBER]

    def problem(self, values: Sequence[float]) -> str | None:
        """Return the problem of the first value that is not finite, in [min, max] and of its type, or None."""
        if math.isfinite(sum(values)):  # all are finite then: the sum of others is an infinity or NaN
            for i, low, high in self._bounded:
                if not low <= values[i] <= high:
                    break
            else:
                return self._fraction(values) if self._whole else None
        return self._first_problem(values)

    def out_of_range(self, values: Sequence[float]) -> Iterator[tuple[str, str]]:
        """Yield name and problem of each value outside the declared [min, max]."""
        for i, (value, limits) in enumerate(zip(values, self._declared, strict=True)):
            if not limits[0] <= value <= limits[1]:
                yield self.variables[i].name, self._range_problem(i, value, limits)

    def _first_problem(self, values: Sequence[float]) -> str | None:
        for i, (value, (low, high)) in enumerate(zip(values, self._ranges, strict=True)):
            if not low <= value <= high:  # NaN is in no range
                return self._range_problem(i, value, (low, high))
        return self._fraction(values)

    def _fraction(self, values: Sequence[float]) -> str | None:
        for i in self._whole:
            if values[i] != int(values[i]):
                return f"{self._role} {self.variables[i].name!r} must be a whole number, got {values[i]:g}"
        return None

    def _range_problem(self, i: int, value: float, limits: tuple[float, float]) -> str:
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
        """Return the variables of these names, in the role 'input', 'tunable parameter' or 'output'.

        An input or tunable parameter must be one; an output may be anything but a String. Raises WiringError.
        """
        return Ports(role.removeprefix("tunable "), [self._in_role(name, role) for name in names], is_lenient)

    def start_port(self, name: str, value: Value) -> Ports:
        """Return the variable of that name, if it takes a start value of value's type; its range is not checked.

        Raises WiringError.
        """
        variable = self._known(name)
        takes_start = variable.causality == "input" or variable.initial in ("exact", "approx")
        if not takes_start or variable.variability == "constant" or variable.causality == "independent":
            kind = _with_article(kind_of(variable))
            initial = f", initial {variable.initial}" if variable.initial else ""
            raise WiringError(f"{name!r} of {self._fmu_name} takes no start value: it is {kind}{initial}.")
        its_type, why_not = _type_of(variable), ""
        if variable.causality == "structuralParameter":
            why_not = "it is a structural parameter, and sizes of arrays cannot be changed"
        elif TYPES[its_type].is_text and self._is_element(variable):
            why_not = "it is an element of an array of Strings, which is set as a whole"
        if why_not:
            raise WiringError(f"{name!r} of {self._fmu_name} takes no start value: {why_not}.")
        if not _is_fit(value, TYPES[its_type]):
            raise WiringError(f"{name!r} of {self._fmu_name} is a {its_type} and cannot start as {value!r}.")
        return Ports(kind_of(variable), [variable])

    def _is_element(self, variable: ModelVariable) -> bool:
        """Return whether a variable is one of several elements of an array."""
        reference = of_handle(variable.valueReference)[0]
        handles = (of_handle(v.valueReference) for v in self._variables.values())
        return any(place and whole == reference for whole, place in handles)

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
        if (match := close_match(name, self._variables)) is not None:
            message += f"; did you mean {match!r} ({_with_article(kind_of(self._variables[match]))})?"
        raise WiringError(message)


def is_numeric(variable: ModelVariable) -> bool:
    """Return whether a variable's values can be exchanged at communication points."""
    return TYPES[variable.type].is_numeric


def kind_of(variable: ModelVariable) -> str:
    """Return the kind of a variable in words: 'input', 'tunable parameter', 'local variable', ..."""
    if variable.variability == "constant":
        return "constant"
    if variable.causality == "parameter":
        return f"{variable.variability} parameter"
    words = {
        "calculatedParameter": "calculated parameter",
        "structuralParameter": "structural parameter",
        "local": "local variable",
    }
    return words.get(variable.causality, str(variable.causality))


def _with_article(kind: str) -> str:
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def _type_of(variable: ModelVariable) -> str:
    """Return a variable's type; an Enumeration's is the one by whose functions FMI 2.0 sets and gets it.

    Those of FMI 3.0 have become an Int64 in `elements.scalarized`.
    """
    access = TYPES[variable.type].fmi2
    return access.functions if access is not None else str(variable.type)


def _is_fit(value: Value, its_type: FmiType) -> bool:
    """Return whether a variable of a type can start as value; a Boolean is not a number here."""
    if not its_type.is_numeric:
        return its_type.python is str and isinstance(value, str)
    return isinstance(value, SupportsFloat) and (its_type.python is bool or not isinstance(value, bool))


def attribute(variable: ModelVariable, name: str) -> str | None:
    """Return the unit, min or max of a variable: its own, or its declared type's."""
    own = getattr(variable, name)
    return own if own is not None or variable.declaredType is None else getattr(variable.declaredType, name)


def _default_range(variable: ModelVariable) -> tuple[float, float]:
    """Return the smallest and the largest number that a variable of its type can be."""
    limits = TYPES[variable.type].limits
    return _ANY_NUMBER if limits is None else (float(limits[0]), float(limits[1]))


def _range_of(variable: ModelVariable) -> tuple[float, float]:
    """Return the smallest and the largest number that a variable may be."""
    low, high = _default_range(variable)
    declared_low, declared_high = attribute(variable, "min"), attribute(variable, "max")
    return (
        low if declared_low is None else max(low, float(declared_low)),
        high if declared_high is None else min(high, float(declared_high)),
    )


def _bound(bound: float) -> str:
    return f"{math.copysign(math.inf, bound):g}" if abs(bound) == _LARGEST else f"{bound:.10g}"
