"""Check that a model description is consistent: its names, numbers, aliases and structure.

FMPy has validated it against the schema before: types, legal combinations, unique names, required start values.
What cannot work or would do harm is an error; any other violation of the standard is a warning.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from math import prod
from typing import Any, Final
from xml.etree.ElementTree import Element

from fmpy.model_description import ModelDescription, ModelVariable

from ...errors import one_line
from ...findings import Finding, warning
from ..types import TYPES, is_real

MOST_ELEMENTS: Final = 1_000_000
"""Scalars that the arrays of an FMU may have together."""

_PLACE: Final = "modelDescription.xml"
_IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_FILE_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*")
_ONLY_A_REAL: Final = re.compile(r'The variable ".*" .* is of type \w+ and must have variability != "continuous"\.')


def description_findings(description: ModelDescription) -> Iterator[Finding]:
    """Yield problems with a model description."""
    yield from _identifiers(description)
    yield from _sizes(description.modelVariables)
    if description.fmiVersion == "2.0":
        yield from _aliases(description.modelVariables)
    for variable in description.modelVariables:
        yield from _numbers(variable)
    yield from _units(description.unitDefinitions or ())
    yield from _derivatives(description.modelVariables)
    yield from _outputs(description)
    yield from _experiment(description.defaultExperiment)


def index_findings(root: Element) -> Iterator[Finding]:
    """Yield wrong indices of an FMI 2.0 model description, of which FMPy takes 0 for the last variable's.

    Of FMI 3.0, sizes of arrays by variables that there are not.
    """
    variables = root.findall("ModelVariables/ScalarVariable")
    for kind in ("Outputs", "Derivatives", "InitialUnknowns"):
        seen: set[str] = set()
        for unknown in root.iterfind(f"ModelStructure/{kind}/Unknown"):
            index = unknown.get("index", "")
            if index in seen:
                yield warning(_PLACE, f"{kind} has the index {index} more than once")
            seen.add(index)
            yield from _unknown((index, *unknown.get("dependencies", "").split()), len(variables), kind)
    known = {variable.get("valueReference") for variable in root.iterfind("ModelVariables/*")}
    for dimension in root.iterfind("ModelVariables/*/Dimension"):
        if (reference := dimension.get("valueReference", "")) and reference not in known:
            yield Finding(_PLACE, f"a Dimension is that of the valueReference {reference}, which no variable has")
    rates = (real.get("derivative") for real in root.iterfind("ModelVariables/ScalarVariable/Real"))
    yield from _unknown((i for i in rates if i is not None), len(variables), "ModelVariables/*/Real/derivative")


def _unknown(indices: Iterable[str], n: int, where: str) -> Iterator[Finding]:
    for i in indices:
        if i.isdecimal() and not 1 <= int(i) <= n:  # what is no number the schema refuses
            yield Finding(_PLACE, f"{where} has the index {i}; there are variables 1 to {n}")


def _identifiers(description: ModelDescription) -> Iterator[Finding]:
    parts: tuple[Any, ...] = (description.coSimulation, description.modelExchange, description.scheduledExecution)
    for identifier in dict.fromkeys(str(part.modelIdentifier) for part in parts if part is not None):
        if not _IDENTIFIER.fullmatch(identifier):
            what = f"modelIdentifier {identifier!r} is no C identifier, of letters, digits and '_'"
            if _FILE_NAME.fullmatch(identifier):  # no more than the library's name is made of it here
                yield warning(_PLACE, f"{what} (FMI 2.0.4, section 4.3.1)")
            else:
                yield Finding(_PLACE, what)


def harmless_findings(problems: Sequence[str]) -> list[Finding] | None:
    """Return what FMPy's validation has found as warnings, where it does no harm; else None."""
    if not all(_ONLY_A_REAL.fullmatch(problem) for problem in problems):
        return None
    return [warning(_PLACE, f"{problem.rstrip('.')} (FMI 2.0.4, section 2.2.7)") for problem in problems]


def is_true(attribute: object) -> bool:
    """Return whether an attribute of a model description, as FMPy has it, is true."""
    return attribute in ("true", "1", True)


def clock_problem(description: ModelDescription) -> str | None:
    """Return why the clocks of an FMU cannot be served, or None: they tick in event mode, where it has one."""
    part = description.coSimulation
    clocks = [v.name for v in description.modelVariables if v.type == "Clock" and v.causality == "input"]
    if not clocks or (part is not None and not is_true(part.hasEventMode)):
        return None
    return f"it has input clocks, {one_line(clocks[0])!r} for one, and nothing here makes a clock tick"


def _units(units: Iterable[Any]) -> Iterator[Finding]:
    for unit in units:
        base = unit.baseUnit
        factor, offset = (1.0, 0.0) if base is None else (float(base.factor), float(base.offset))
        if not math.isfinite(factor) or factor == 0.0 or not math.isfinite(offset):
            what = f"factor {factor:g} and offset {offset:g}; a conversion needs finite ones, and no factor 0"
            yield Finding(_PLACE, f"unit {unit.name!r} has the {what}")


def _sizes(variables: Sequence[ModelVariable]) -> Iterator[Finding]:
    total = sum(prod(v.shape or ()) for v in variables)
    if total > MOST_ELEMENTS:
        yield Finding(_PLACE, f"its arrays have {total} elements; at most {MOST_ELEMENTS} are handled")
    for v in variables:
        shape = list(v.shape or ())
        if shape and min(shape) < 1:
            yield Finding(_PLACE, f"{_named(v)} has the dimensions {shape}; each must be at least 1")
        starts = v.start if shape and isinstance(v.start, str) and not TYPES[v.type].is_text else "one"
        n, n_starts = prod(shape), len(starts.split())
        if n_starts not in (1, n):
            yield Finding(_PLACE, f"{_named(v)} has {n_starts} start values; its dimensions {shape} need {n} or 1")


def _aliases(variables: Iterable[ModelVariable]) -> Iterator[Finding]:
    """Check FMI 2.0.4, section 2.2.7: at most one of a set of aliases is set from outside, and has a start value."""
    sets: dict[tuple[str, int], list[ModelVariable]] = {}
    for v in variables:
        access = TYPES[v.type].fmi2  # aliases are set and got by the same functions
        functions = access.functions if access is not None else str(v.type)
        sets.setdefault((functions, v.valueReference), []).append(v)
    for (_, reference), of_one in sets.items():
        if len(of_one) == 1:
            continue
        settable = [v for v in of_one if v.causality in ("input", "parameter")]
        if len(settable) > 1:
            names = " and ".join(repr(v.name) for v in settable[:2])
            yield Finding(_PLACE, f"{names} have the value reference {reference}; only one of such may be set")
        if len({v.start for v in of_one if v.start is not None and v.variability != "constant"}) > 1:
            first, *_, last = (v for v in of_one if v.start is not None)
            yield warning(
                _PLACE, f"the aliases {first.name!r} and {last.name!r} start as {first.start} and {last.start}"
            )
        if len({v.unit for v in of_one if v.unit is not None}) > 1:
            yield warning(_PLACE, f"the aliases {of_one[0].name!r} and {of_one[-1].name!r} have different units")


def _numbers(variable: ModelVariable) -> Iterator[Finding]:
    if TYPES[variable.type].python not in (float, int):
        return
    declared = variable.declaredType
    low, high, nominal = (
        _number(own if (own := getattr(variable, key)) is not None else getattr(declared, key, None))
        for key in ("min", "max", "nominal")
    )
    what = _named(variable)
    for word, value in (("min", low), ("max", high), ("nominal", nominal)):
        if value is not None and math.isnan(value):
            yield Finding(_PLACE, f"{what} has the {word} NaN; it must be a number")
    if nominal is not None and (nominal == 0.0 or math.isinf(nominal)):
        yield warning(_PLACE, f"{what} has the nominal {nominal:g}; it must be finite and not zero")
    low, high = -math.inf if low is None else low, math.inf if high is None else high
    if low > high:
        yield Finding(_PLACE, f"{what} has min {low:g} > max {high:g}")
    elif low == math.inf or high == -math.inf:
        yield Finding(_PLACE, f"{what} has min {low:g} and max {high:g}, between which there is no number")
    for value in _starts(variable):
        if not math.isfinite(value):
            # Infinite limits are a habit of some tools; a NaN is what nobody can compute with.
            yield Finding(
                _PLACE, f"{what} has the start value {value:g}; it must be a finite number", math.isnan(value)
            )
        elif not low <= value <= high:
            yield warning(_PLACE, f"{what} has the start value {value:g} outside its min {low:g} and max {high:g}")


def _derivatives(variables: Iterable[ModelVariable]) -> Iterator[Finding]:
    rates: dict[int, ModelVariable] = {}
    for v in variables:
        state: Any = v.derivative
        if state is None:
            continue
        if state is v:
            yield Finding(_PLACE, f"{_named(v)} is declared the derivative of itself")
        elif not is_real(state.type) or (state.shape or ()) != (v.shape or ()):
            yield Finding(_PLACE, f"{_named(v)} is declared the derivative of {state.name!r}, which is of another kind")
        elif (other := rates.setdefault(id(state), v)) is not v and not v.alias:
            yield warning(_PLACE, f"{state.name!r} has two derivatives: {other.name!r} and {v.name!r}")


def _outputs(description: ModelDescription) -> Iterator[Finding]:
    listed = {id(unknown.variable) for unknown in description.outputs}
    for v in description.modelVariables:
        if v.causality == "output" and not v.alias and id(v) not in listed:
            yield warning(_PLACE, f"the output {v.name!r} is not in ModelStructure")
    for unknown in description.outputs:
        if (v := unknown.variable) is not None and v.causality != "output":
            yield warning(_PLACE, f"ModelStructure lists {v.name!r} as an output, which it is not")


def _experiment(experiment: Any) -> Iterator[Finding]:
    if experiment is None:
        return
    values = {key: _number(getattr(experiment, key)) for key in ("startTime", "stopTime", "stepSize", "tolerance")}
    for key, value in values.items():
        if value is not None and not math.isfinite(value):
            yield Finding(
                _PLACE, f"DefaultExperiment has the {key} {value:g}; it must be a finite number", math.isnan(value)
            )
        elif value is not None and key in ("stepSize", "tolerance") and value <= 0.0:
            yield warning(_PLACE, f"DefaultExperiment has the {key} {value:g}; it must be positive")
    start, stop = values["startTime"] or 0.0, values["stopTime"]
    if stop is not None and stop < start:
        yield warning(_PLACE, f"DefaultExperiment stops at {stop:g} s, before its start at {start:g} s")


def _starts(variable: ModelVariable) -> Iterator[float]:
    for text in str(variable.start).split() if variable.start is not None else ():
        yield float(text)


def _number(text: str | None) -> float | None:
    return None if text is None else float(text)


def _named(variable: ModelVariable) -> str:
    return f"variable {variable.name!r}"
