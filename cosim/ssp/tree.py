"""Elements of a system structure: systems within systems, and components, which are FMUs."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import unquote
from xml.etree.ElementTree import Element

from ..errors import SspError, one_line
from ..fmi.component import Component, items_of, read_component
from ..fmi.types import TYPES
from ..names import did_you_mean
from ..ssv.xml import attribute
from ..units import Unit, conversion
from .arrays import FmuArray, arrays_of

_SSP_TYPES = {row.name: row.ssp for row in TYPES.values() if row.ssp is not None}  # SSP 2.0 has FMI 3.0's names too


@dataclass(frozen=True)
class Connector:
    """A variable of an element that connections can lead to or from."""

    kind: str
    """Its kind: input, output, parameter, calculatedParameter, inout, ..."""
    unit: Unit | None
    """Its unit: for a component's connector the FMU's, else as declared here."""


@dataclass(frozen=True)
class SystemElement:
    """An element of a system structure: a system or a component."""

    name: str
    """Names down from the top system, joined with dots; empty for the top itself."""
    element: Element
    """Its XML element."""
    connectors: Mapping[str, Connector]
    """Connectors by name."""
    component: Component | None
    """The FMU; None for a system."""
    children: Mapping[str, "SystemElement"]
    """Elements of a system, by their own names."""
    arrays: Mapping[str, FmuArray]
    """Connectors that are arrays, by name; their elements are connectors too."""

    def components(self) -> Iterator[tuple[str, Component]]:
        """Yield every component below, or this one, with its hierarchical name."""
        if self.component is not None:
            yield self.name, self.component
        for child in self.children.values():
            yield from child.components()


MOST_ELEMENTS: Final = 1000
"""Systems and components of a package."""
DEEPEST: Final = 100
"""Systems within systems."""


class TreeReader:
    """Reader of the elements of one package; each FMU is read once."""

    def __init__(self, folder: Path, units: Mapping[str, Unit], where: str) -> None:
        self._folder, self._units, self._where = folder, units, where
        self._components: dict[Path, Component] = {}
        self._n_elements = 0
        self._names: set[str] = set()

    def system(self, element: Element, name: str = "", depth: int = 1) -> SystemElement:
        """Read a system and all that is in it. Raises SspError, ModelDescriptionError."""
        children: dict[str, SystemElement] = {}
        if depth > DEEPEST:
            raise SspError(f"{self._where}: systems are nested more than {DEEPEST} deep.")
        for child in element.findall("Elements/*"):
            self._n_elements += 1
            if self._n_elements > MOST_ELEMENTS:
                raise SspError(f"{self._where}: it has more than {MOST_ELEMENTS} systems and components.")
            own = attribute(child, "name", self._where)
            full = f"{name}.{own}" if name else own
            if full in self._names:
                raise SspError(f"{self._where}: two elements have the name '{full}'.")
            self._names.add(full)
            if child.tag == "System":
                children[own] = self.system(child, full, depth + 1)
            elif child.tag == "Component":
                children[own] = self._component(child, full)
            else:
                raise SspError(f"{self._where}: '{full}' is a {one_line(child.tag)}, which is not supported.")
        connectors, arrays = self._connectors(element, name, None)
        return SystemElement(name, element, connectors, None, children, arrays)

    def _component(self, element: Element, name: str) -> SystemElement:
        kind = element.get("type", "application/x-fmu-sharedlibrary")
        if kind != "application/x-fmu-sharedlibrary":
            raise SspError(f"{self._where}: component '{name}' is of type {one_line(kind)}; only FMUs are supported.")
        fmu = resource(self._folder, attribute(element, "source", self._where), f"{self._where}: component '{name}'")
        component = self._components.get(fmu) or read_component(fmu)
        self._components[fmu] = component
        connectors, arrays = self._connectors(element, name, component)
        return SystemElement(name, element, connectors, component, {}, arrays)

    def _connectors(
        self, element: Element, name: str, component: Component | None
    ) -> tuple[dict[str, Connector], dict[str, FmuArray]]:
        """Return an element's connectors, those of arrays by their elements, and its arrays."""
        found: dict[str, Connector] = {}
        arrays: dict[str, FmuArray] = {}
        for connector in element.findall("Connectors/Connector"):
            own = attribute(connector, "name", self._where)
            place = f"{self._where}: connector '{name}.{own}'" if name else f"{self._where}: connector '{own}'"
            if connector.find("Dimension") is None:
                found[own] = self._connector(connector, own, place, component)
                continue
            if component is None:
                raise SspError(f"{place} is an array of a system; only those of FMUs are supported.")
            arrays[own] = _array(connector, own, place, component)
            found |= {part: self._connector(connector, part, place, component) for part in arrays[own].elements}
        return found, arrays

    def _connector(self, element: Element, name: str, place: str, component: Component | None) -> Connector:
        typed = next((e for e in element if e.tag in _SSP_TYPES), None)
        unit_name = typed.get("unit") if typed is not None else None
        unit = self._units.get(unit_name, Unit(unit_name)) if unit_name else None
        if component is not None:
            if name not in component.variables:
                hint = did_you_mean(name, component.variables) or "."
                raise SspError(f"{place}: no variable '{name}' in {component.fmu.name}{hint}")
            variable = component.variables[name]
            kind, is_enumeration = str(variable.type), items_of(variable) is not None
            kinds = {_SSP_TYPES.get(kind), "Enumeration" if is_enumeration else None}  # an Int64 in FMI 3.0's functions
            if typed is not None and _SSP_TYPES[typed.tag] not in kinds:
                raise SspError(f"{place} is declared {typed.tag}, but in {component.fmu.name} it is {kind}.")
            unit = self._checked(unit, component.unit(name), place)
        return Connector(attribute(element, "kind", self._where), unit)

    def _checked(self, declared: Unit | None, own: Unit | None, place: str) -> Unit | None:
        """Return the FMU's unit, in which its numbers are; the declared one must be of the same dimension.

        Of one that the FMU only names, the definition here counts.
        """
        if declared is not None and own is not None and own.exponents is None and own.name == declared.name:
            return declared
        try:
            conversion(declared, own)
        except ValueError as e:
            raise SspError(f"{place}: {e}.") from e
        return own or declared


def _array(connector: Element, name: str, place: str, component: Component) -> FmuArray:
    """Return the array of a connector, which must have the FMU's sizes. Raises SspError."""
    array = next((a for a in arrays_of(component).values() if a.name == name), None)
    if array is None:
        raise SspError(f"{place}: '{name}' is no array of {component.fmu.name}.")
    sizes = [d.get("size") for d in connector.findall("Dimension")]
    if len(sizes) != len(array.sizes) or any(s not in (None, str(n)) for s, n in zip(sizes, array.sizes, strict=True)):
        raise SspError(f"{place}: in {component.fmu.name} its sizes are {' x '.join(map(str, array.sizes))}.")
    return array


def resource(folder: Path, source: str, place: str) -> Path:
    """Return the file that a relative URI of a package names. Raises SspError where it leads out or to no file."""
    path = unquote(source.partition("#")[0]).removeprefix("./")
    if not path or path.startswith("/") or ".." in path.split("/") or "\\" in path or ":" in path:
        raise SspError(f"{place}: '{one_line(source)}' is not a path within the package.")
    if not (folder / path).is_file():
        raise SspError(f"{place}: no file '{one_line(path)}' in the package.")
    return folder / path
