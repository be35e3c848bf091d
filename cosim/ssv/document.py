"""Reading and writing of parameter values: System Structure Parameter Values, SSP 1.0, section 6."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from ..errors import SspError, one_line
from ..files import readable
from ..fmi.elements import element_names
from ..fmi.preflight.description import MOST_ELEMENTS
from ..fmi.types import TYPES, Value
from ..units import Unit
from .xml import NAMESPACES, attribute, defined_in, parse, real


class ParameterValue(NamedTuple):
    """A parameter and its value."""

    name: str
    """Name in the component, or `component.variable` in a set for a system."""
    value: Value
    """Value in its unit."""
    unit: str | None = None
    """Name of the unit; without one, the unit that the component declares."""


class ArrayValue(NamedTuple):
    """An array, a parameter of SSP 2.0, and its values."""

    name: str
    values: tuple[Value, ...]
    """Values of its elements, the last index fastest."""
    sizes: tuple[int, ...]
    """Sizes of its dimensions."""
    unit: str | None = None


@dataclass(frozen=True)
class ParameterSet:
    """The content of an SSV file."""

    name: str
    """Name of the set, for people."""
    values: tuple[ParameterValue, ...]
    """Parameters in the file's order; the value of an Enumeration is its item's name."""
    units: Mapping[str, Unit]
    """Units that the file defines, by name."""
    where: str
    """The file, for messages."""


def to_ssv(name: str, parameters: Sequence[ParameterValue], defined: Mapping[str, Unit] | None = None) -> str:
    """Return an SSV document of these parameters, with the definitions of those units that are known by name."""
    return document(ssv_element(name, parameters, defined or {}, {"ssv", "ssc"}))


def ssv_element(
    name: str,
    parameters: Sequence[ParameterValue | ArrayValue],
    defined: Mapping[str, Unit],
    prefixes: Iterable[str],
) -> Element:
    """Return a `ssv:ParameterSet` that declares these prefixes. Raises ValueError for a number that is not finite.

    Prefixes and version are literal: libcosim and ecos look for these very names. The version is 2.0 where there are
    arrays.
    """
    defined = {key: unit for key, unit in defined.items() if unit.exponents is not None}
    declared = {f"xmlns:{prefix}": NAMESPACES[prefix] for prefix in sorted(prefixes, reverse=True)}
    arrays = [p for p in parameters if isinstance(p, ArrayValue)]
    root = Element("ssv:ParameterSet", {**declared, "version": "2.0" if arrays else "1.0", "name": name})
    values = SubElement(root, "ssv:Parameters")
    for parameter in parameters:
        element = SubElement(values, "ssv:Parameter", {"name": parameter.name})
        written = [_written(value) for value in _values(parameter)]
        kind, text = written[0][0], " ".join(text for _, text in written)
        has_unit = kind == "Real" and parameter.unit in defined  # a unit must be defined in the same file
        SubElement(element, f"ssv:{kind}", {"value": text} | ({"unit": str(parameter.unit)} if has_unit else {}))
        for size in parameter.sizes if isinstance(parameter, ArrayValue) else ():
            SubElement(element, "ssc:Dimension", {"size": str(size)})
    used = {p.unit for p in parameters if isinstance(_values(p)[0], float)}
    add_units(root, "ssv", [unit for key, unit in defined.items() if key in used])
    return root


def _values(parameter: ParameterValue | ArrayValue) -> Sequence[Value]:
    return parameter.values if isinstance(parameter, ArrayValue) else (parameter.value,)


def add_units(root: Element, prefix: str, defined: Iterable[Unit]) -> None:
    """Append the definitions of these units, which all have one."""
    units = sorted(defined, key=lambda u: u.name)
    table = SubElement(root, f"{prefix}:Units") if units else root
    for unit in units:
        definition = {name: str(n) for name, n in unit.base.items()}
        definition |= {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
        definition |= {"offset": repr(unit.offset)} if unit.offset != 0.0 else {}
        SubElement(SubElement(table, "ssc:Unit", {"name": unit.name}), "ssc:BaseUnit", definition)


def document(root: Element) -> str:
    """Return the text of an XML file, indented."""
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def read_ssv(path: Path) -> ParameterSet:
    """Read the parameters of an SSV file, version 1.0 or 2.0. Raises SspError."""
    try:
        content = readable(path).read_bytes()
    except OSError as e:
        raise SspError(f"{path} cannot be read: {e.strerror or e}.") from e
    return parameter_set(parse(content, str(path), "ParameterSet"), str(path))


def parameter_set(root: Element, where: str, outer: Mapping[str, Unit] | None = None) -> ParameterSet:
    """Read a ParameterSet element; outer: units of the file that it stands in. Raises SspError."""
    elements = root.findall("Parameters/Parameter")
    values = tuple(value for element in elements for value in _parameters(element, where))
    names = Counter(value.name for value in values)
    if repeated := next((name for name, n in names.items() if n > 1), None):
        raise SspError(f"{where}: two parameters have the name '{repeated}'.")
    return ParameterSet(root.get("name", ""), values, {**(outer or {}), **defined_in(root, where)}, where)


def _boolean(text: str) -> bool:
    return {"true": True, "1": True, "false": False, "0": False}[text]


def _whole(text: str) -> int:
    """Return a whole number. Raises ValueError where it is none, OverflowError where no double can hold it."""
    if math.isinf(real(text)):
        raise OverflowError(text)
    return int(text)


_READ_AS: Mapping[Any, Callable[[str], Value]] = {float: real, int: _whole, bool: _boolean, str: str}
_READERS = {row.name: _READ_AS[row.python] for row in TYPES.values() if row.python in _READ_AS}
_NUMBERS = {row.name for row in TYPES.values() if row.python in (float, int, bool)}
"""Types of arrays: the texts of others may have spaces."""
_READERS["Enumeration"] = str  # SSP writes the item's name


def _parameters(element: Element, where: str) -> list[ParameterValue]:
    """Return a parameter, an array's elements one by one."""
    dimensions = element.findall("Dimension")
    if not dimensions:
        return [_parameter(element, where)]
    name = attribute(element, "name", where)
    typed = next((e for e in element if e.tag in _NUMBERS), None)
    if typed is None:
        raise SspError(f"{where}: parameter '{name}' is an array of no numbers, which is not supported.")
    texts = typed.get("value", "").split()
    sizes = [d.get("size", "") for d in dimensions]
    known = [int(size) if size.isdecimal() else len(texts) if sizes == [""] else 0 for size in sizes]
    if prod(known) != len(texts) or not 0 < len(texts) <= MOST_ELEMENTS:
        given = " x ".join(map(one_line, sizes))
        raise SspError(
            f"{where}: parameter '{name}' has {len(texts)} values for the dimensions {given or 'not given'}."
        )
    parts = [Element("Parameter", {"name": own}) for own in element_names(name, known)]
    for part, text in zip(parts, texts, strict=True):
        part.append(Element(typed.tag, {**typed.attrib, "value": text}))
    return [_parameter(part, where) for part in parts]


def _parameter(element: Element, where: str) -> ParameterValue:
    name = attribute(element, "name", where)
    typed = next((e for e in element if e.tag in _READERS), None)
    if typed is None:
        kind = element[0].tag if len(element) else "nothing"
        raise SspError(f"{where}: parameter '{name}' must be a number, Boolean, String or Enumeration, got {kind}.")
    text = typed.get("value", "")
    try:
        value = _READERS[typed.tag](text)
    except OverflowError as e:
        raise SspError(f"{where}: parameter '{name}' must be a number that a double can hold, got a larger one.") from e
    except (ValueError, KeyError) as e:
        raise SspError(f"{where}: parameter '{name}' is no {typed.tag}: '{one_line(text)}'.") from e
    return ParameterValue(name, value, typed.get("unit"))


def _written(value: Value) -> tuple[str, str]:
    """Return type and text of a value."""
    if isinstance(value, bool):
        return "Boolean", str(value).lower()
    if isinstance(value, int):
        return "Integer", str(value)
    if isinstance(value, str):
        return "String", value
    if not math.isfinite(value):
        raise ValueError(f"a parameter's value must be finite, got {value}.")
    return "Real", repr(float(value))
