"""Arrays of FMI 3.0 in SSP 2.0: connectors and parameters with dimensions; 1.0 has scalars only.

Whole arrays are connected. SSP 2.0 can restrict a connection to one element too (`startIndices`), and its schema does
not say where the indices begin: that is neither written nor read.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from ..errors import SspError
from ..fmi.archive import read_any
from ..fmi.component import Component
from ..fmi.elements import element_names
from ..fmi.types import TYPES, Value
from ..ssv.document import ArrayValue, ParameterValue
from ..variable_name import VariableName


class FmuArray(NamedTuple):
    """An array of an FMU."""

    name: str
    sizes: tuple[int, ...]
    """Sizes of its dimensions."""
    elements: tuple[str, ...]
    """Names of its elements, the last index fastest."""


def arrays_of(component: Component) -> dict[str, FmuArray]:
    """Return the arrays of an FMU by the names of their elements; none where it is of FMI 2.0."""
    if component.description.fmiVersion == "2.0":
        return {}
    shaped = [(v.name, tuple(v.shape)) for v in read_any(component.fmu).modelVariables if v.shape]
    arrays = [FmuArray(name, shape, tuple(element_names(name, shape))) for name, shape in shaped]
    return {element: array for array in arrays for element in array.elements}


def whole(
    connections: Mapping[VariableName, VariableName], arrays: Mapping[str, Mapping[str, FmuArray]]
) -> dict[VariableName, VariableName]:
    """Return connections, input = output, with those between the elements of two arrays as one of these.

    Raises SspError where an element is connected by itself.
    """
    found: dict[VariableName, VariableName] = {}
    for target, source in connections.items():
        to, of = (arrays[end.component].get(end.variable) for end in (target, source))
        if to is None and of is None:
            found[target] = source
            continue
        if to is None or of is None or to.sizes != of.sizes or not _are_joined(target, to, source, of, connections):
            element = target if to is not None else source
            raise SspError(
                f"'{element}' is an element of an array, and connected by itself: SSP packages join whole ones."
            )
        found[VariableName(f"{target.component}.{to.name}")] = VariableName(f"{source.component}.{of.name}")
    return found


def _are_joined(
    target: VariableName,
    to: FmuArray,
    source: VariableName,
    of: FmuArray,
    connections: Mapping[VariableName, VariableName],
) -> bool:
    a, b = (
        [VariableName(f"{end.component}.{e}") for e in array.elements] for end, array in ((target, to), (source, of))
    )
    return all(connections.get(one) == other for one, other in zip(a, b, strict=True))


def with_arrays(
    values: Sequence[ParameterValue], component: Component, arrays: Mapping[str, FmuArray]
) -> Iterator[ParameterValue | ArrayValue]:
    """Yield values, those of an array's elements as one; elements that are not given start as the FMU has them."""
    given = {p.name: p for p in values}
    told: set[str] = set()
    for p in values:
        array = arrays.get(p.name)
        if array is None:
            yield p
        elif array.name not in told:
            told.add(array.name)
            starts = ((n, component.variables[n]) for n in array.elements)
            typed = tuple(_typed(given[n].value if n in given else v.start, str(v.type)) for n, v in starts)
            yield ArrayValue(array.name, typed, array.sizes, p.unit)


def _typed(value: object, type_name: str) -> Value:
    """Return a value, as it is given or written in a model description, in the Python type of its FMI type."""
    match TYPES[type_name].python:
        case of if of is bool:
            return value in (True, 1, "true", "1")
        case of if of is int:
            return int(str(value or 0)) if not isinstance(value, float) else int(value)
        case of if of is float:
            return float(str(value or 0.0))
        case _:
            return str(value or "")
