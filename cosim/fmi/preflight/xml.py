"""Strict reading of XML: no document type, hence no entities, and a limited size."""

from typing import Final
from xml.etree.ElementTree import Element, ParseError, TreeBuilder, XMLParser, fromstring

LARGEST: Final = 256 << 20
"""Largest number of bytes; a description of a million variables has about this size."""


class _NoDoctype(TreeBuilder):
    """XML builder that refuses document types: FMI and SSP have none, and their entities can grow without bound."""

    def doctype(self, name: str, public_id: str | None, system_id: str | None) -> None:
        raise ValueError("it has a document type (DOCTYPE), which is refused")


def strict_root(content: bytes) -> Element:
    """Return the root of an XML file. Raises ValueError, in one line."""
    if len(content) > LARGEST:
        raise ValueError(f"it has {len(content) >> 20} MiB; at most {LARGEST >> 20} MiB are read")
    try:
        return fromstring(content, XMLParser(target=_NoDoctype()))
    except (ParseError, LookupError) as e:  # the last: an encoding that there is not
        raise ValueError(str(e)) from e
