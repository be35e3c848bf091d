"""Parameter values for other tools: System Structure Parameter Values, SSP 1.0."""

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree import ElementTree

_VALUES = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
_COMMON = "http://ssp-standard.org/SSP1/SystemStructureCommon"


class ParameterValue(NamedTuple):
    """A real parameter and its value."""

    name: str
    """As the component knows it."""
    value: float
    """In the unit that the component declares."""


def to_ssv(name: str, parameters: Sequence[ParameterValue]) -> str:
    """An SSV document of these parameters. SSP 1.0 standard, section 6: prefixes and version are literal."""
    root = ElementTree.Element(
        "ssv:ParameterSet", {"xmlns:ssv": _VALUES, "xmlns:ssc": _COMMON, "version": "1.0", "name": name}
    )
    values = ElementTree.SubElement(root, "ssv:Parameters")
    for parameter in parameters:
        element = ElementTree.SubElement(values, "ssv:Parameter", {"name": parameter.name})
        ElementTree.SubElement(element, "ssv:Real", {"value": repr(parameter.value)})
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
