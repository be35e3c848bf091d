"""XML of the SSP formats, read without regard to prefixes and versions of their namespaces."""

import re
from collections.abc import Mapping
from xml.etree.ElementTree import Element

from ..errors import SspError, one_line
from ..fmi.preflight.xml import strict_root
from ..units import Unit, make_unit

NAMESPACES: Mapping[str, str] = {
    "ssd": "http://ssp-standard.org/SSP1/SystemStructureDescription",
    "ssc": "http://ssp-standard.org/SSP1/SystemStructureCommon",
    "ssv": "http://ssp-standard.org/SSP1/SystemStructureParameterValues",
    "ssm": "http://ssp-standard.org/SSP1/SystemStructureParameterMapping",
}
"""Namespaces of SSP 1.0, which 2.0 has kept, by their usual prefix."""

_NAMESPACE = re.compile(r"\{http://ssp-standard\.org/SSP\d/\w+\}")
_VERSION = re.compile(r"[12]\.\d+(-.*)?")


def parse(content: bytes, where: str, kind: str) -> Element:
    """Return the root of a file of SSP 1.x or 2.x, its elements named without a namespace; others keep theirs.

    where: for the messages; kind: what the root must be, such as `SystemStructureDescription`. Raises SspError.
    """
    try:
        root = strict_root(content)
    except ValueError as e:
        raise SspError(f"{where} is not readable XML: {one_line(str(e))}.") from e
    for element in root.iter():
        element.tag = _NAMESPACE.sub("", element.tag)
    return check(root, where, kind)


def check(root: Element, where: str, kind: str) -> Element:
    """Return the element, if it is of that kind and of a version that is understood. Raises SspError."""
    if root.tag != kind:
        raise SspError(f"{where} must be a {kind} of SSP 1.0 or 2.0, got the element '{one_line(root.tag)}'.")
    version = root.get("version", "")
    if not _VERSION.fullmatch(version):
        raise SspError(f"{where} is of SSP version '{one_line(version)}', not 1.0 or 2.0.")
    return root


def attribute(element: Element, name: str, where: str) -> str:
    """Return a required attribute. Raises SspError."""
    value = element.get(name)
    if not value:
        raise SspError(f"{where}: a {element.tag} has no {name}.")
    return value


def real(text: str) -> float:
    """Return a number of XML Schema, which has no underscores, as Python's may have. Raises ValueError."""
    if "_" in text:
        raise ValueError(f"not a number: {text!r}")
    return float(text)


def number(element: Element, name: str, where: str, default: float | None = None) -> float | None:
    """Return an attribute that is a number, or the default. Raises SspError."""
    text = element.get(name)
    if text is None:
        return default
    try:
        return real(text)
    except ValueError as e:
        raise SspError(f"{where}: {name} of a {element.tag} must be a number, got '{one_line(text)}'.") from e


def defined_in(root: Element, where: str) -> dict[str, Unit]:
    """Return the units that a file defines, by name. Raises SspError."""
    found: dict[str, Unit] = {}
    for element in root.findall("Units/Unit"):
        name, base = attribute(element, "name", where), element.find("BaseUnit")
        try:
            found[name] = make_unit(name, None if base is None else base.attrib)
        except ValueError as e:
            raise SspError(f"{where}: unit '{name}': {one_line(str(e))}.") from e
    return found
