"""Systems of FMUs as SSP packages describe them: System Structure and Parameterization, versions 1.0 and 2.0."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self, TypeVar
from xml.etree.ElementTree import Element

from ..errors import CosimError, SspError
from ..fmi.component import Component
from ..fmi.types import Value
from ..ssv.xml import attribute, defined_in, number, parse
from ..system.package_cache import discard, unpacked_package
from .connections import Connection, connect
from .parameters import start_values
from .tree import TreeReader

STRUCTURE = "SystemStructure.ssd"
"""The file of a package with its components and connections."""


@dataclass(frozen=True)
class SystemStructure:
    """FMUs, their connections and start values. Systems within it are dissolved: `inner.plant` is a component."""

    name: str
    """Name in the package."""
    folder: Path
    """The unpacked package."""
    components: Mapping[str, Component]
    """The FMUs by instance name."""
    connections: tuple[Connection, ...]
    """Connected inputs and their sources, with conversions of units."""
    start: Mapping[str, Mapping[str, Value]]
    """Start values by component and variable, in the variable's unit."""
    start_time: float = 0.0
    """Start time of the default experiment [s]."""
    stop_time: float | None = None
    """Stop time of the default experiment [s]; None where the package has none."""
    step_size: float | None = None
    """Distance of communication points [s]: the package's, else the smallest of the FMUs' default experiments."""
    ignored: tuple[str, ...] = ()
    """Parameters that no component has; the standard wants them ignored."""

    @classmethod
    def from_ssp(cls, path: str | Path) -> Self:
        """Read the system of an SSP package, which is unpacked into the user's cache.

        Raises SspError, ModelDescriptionError: one line with the file, the place in it and the rule.
        """
        return _read(cls, Path(path))


_T = TypeVar("_T", bound=SystemStructure)


def _read(kind: type[_T], path: Path) -> _T:
    folder = unpacked_package(path)
    try:
        return _read_from(kind, path, folder)
    except CosimError:
        discard(folder)
        raise


def _read_from(kind: type[_T], path: Path, folder: Path) -> _T:
    file, where = folder / STRUCTURE, f"{path}: {STRUCTURE}"
    if not file.is_file():
        raise SspError(f"{path} has no {STRUCTURE}.")
    root = parse(file.read_bytes(), where, "SystemStructureDescription")
    element = root.find("System")
    if element is None:
        raise SspError(f"{where} has no System.")
    units = defined_in(root, where)
    top = TreeReader(folder, units, where).system(element)
    wiring = connect(top, where)
    start, ignored = start_values(top, wiring, folder, units, where)
    components = dict(top.components())
    if not components:
        raise SspError(f"{where} has no components.")
    name = attribute(root, "name", where)
    return kind(name, folder, components, wiring.connections, start, *_experiment(root, components, where), ignored)


def _experiment(
    root: Element, components: Mapping[str, Component], where: str
) -> tuple[float, float | None, float | None]:
    """Return start time, stop time and step size [s]."""
    element = root.find("DefaultExperiment")
    if element is None:
        element = Element("DefaultExperiment")
    steps = [float(e.stepSize) for c in components.values() if (e := c.description.defaultExperiment) and e.stepSize]
    step = min(steps, default=None)
    for annotated in element.iter():
        if annotated.tag.endswith("}FixedStepAlgorithm"):  # libcosim's annotation: SSP itself says nothing of steps
            step = number(annotated, "baseStepSize", where, step)
    return number(element, "startTime", where, 0.0) or 0.0, number(element, "stopTime", where), step
