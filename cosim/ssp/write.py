"""A scenario's system as an SSP package for FMPy, OMSimulator, libcosim, ecos and others.

It is of version 1.0, or of 2.0 where arrays are connected or set.

Prefixes are literal, every connector is typed, and the top system has no connectors of its own: libcosim and ecos look
for the former, libcosim refuses the latter. Unconnected inputs are left out: FMPy would join them to something.
"""

import io
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import version
from itertools import chain, count
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

from ..errors import SspError, WiringError
from ..fmi.archive import FmuFile, InterfaceName, component_interface
from ..fmi.component import Component, ModelVariable, read_component
from ..fmi.ports import is_numeric
from ..fmi.types import TYPES, Value, is_real
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..ssv.document import ParameterValue, add_units, document, ssv_element
from ..ssv.xml import NAMESPACES
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import fmu_paths
from ..system.parameters import value_of_change
from ..units import Unit, conversion
from .arrays import FmuArray, arrays_of, whole, with_arrays
from .package import STRUCTURE
from .scenario import EXTRA
from .write_scenario import ascii_name, scenario_files

START_VALUES = "initialValues"
"""Name of every component's parameter set: ecos sets those of the name that it is given."""

_IMPLEMENTATIONS: dict[InterfaceName, str] = {"co-simulation": "CoSimulation", "model-exchange": "ModelExchange"}
_EPOCH = (1980, 1, 1, 0, 0, 0)


def to_ssp(scenario: Scenario) -> bytes:
    """Write a package of structure, FMUs, parameters and, for `retune run`, the scenario. Same input, same bytes.

    Parameters are the scenario's start values, those of its changes at the start, and those that it will estimate.
    Raises ScenarioError, ModelDescriptionError, WiringError; SspError where units do not agree, and for elements
    of arrays that are connected by themselves.
    """
    for name, c in scenario.components.items():
        if c.table:
            raise SspError(f"component '{name}' is a table, which SSP cannot express: use an FMU that plays it.")
    components = {name: read_component(path) for name, path in fmu_paths(scenario).items()}
    files_of = {name: FmuFile(name, component.description) for name, component in components.items()}
    given, scenario = scenario, as_the_fmus_have_it(scenario, files_of)
    arrays = {name: arrays_of(component) for name, component in components.items()}
    if not _takes_arrays(scenario, components, arrays):
        components = {name: _without(arrays[name], component) for name, component in components.items()}
        arrays = {name: dict[str, FmuArray]() for name in arrays}
    places, parameters = _places(components), _parameter_files(components)
    _check_connections(scenario, components)
    files: dict[str, bytes] = {
        STRUCTURE: document(_structure(scenario, components, places, parameters, arrays)).encode()
    }
    for name, component in components.items():
        files[places[name]] = component.fmu.read_bytes()
        if values := [*with_arrays(_parameters(scenario, name, component), component, arrays[name])]:
            used = {p.unit for p in values}
            units = {key: unit for key, unit in component.units.items() if key in used}
            element = ssv_element(START_VALUES, values, units, {"ssv", "ssc"})
            files[parameters[name]] = document(element).encode()
    for path, content in scenario_files(given, places):
        files[f"{EXTRA}/{path}"] = content
    return _zipped(files)


def _takes_arrays(
    scenario: Scenario, components: Mapping[str, Component], arrays: Mapping[str, Mapping[str, FmuArray]]
) -> bool:
    """Return whether an array is connected or set, for which the package must be of SSP 2.0."""
    ends = [end for pair in scenario.connections.items() for end in pair]
    if any(end.variable in arrays[end.component] for end in ends):
        return True
    return any(p.name in arrays[name] for name, c in components.items() for p in _parameters(scenario, name, c))


def _without(arrays: Mapping[str, FmuArray], component: Component) -> Component:
    """Return a component whose arrays are no variables of it: SSP 1.0 has none."""
    return replace(component, variables={k: v for k, v in component.variables.items() if k not in arrays})


def _places(components: Mapping[str, Component]) -> dict[str, str]:
    """Return each FMU's place in the package: under its own name, unless another has that too; ASCII (section 3)."""
    places: dict[str, str] = {}
    taken: dict[str, Path] = {}
    for name, component in components.items():
        for stem in (component.fmu.stem, f"{component.fmu.stem}_{name}"):
            place = f"resources/{ascii_name(stem)}.fmu"
            if taken.setdefault(place, component.fmu) == component.fmu:
                places[name] = place
                break
        else:
            raise SspError(f"two FMUs would be {place} in the package; rename one.")
    return places


def _parameter_files(components: Iterable[str]) -> dict[str, str]:
    """Return the file of each component's parameters in the package, in ASCII: numbered where two would have one."""
    found: dict[str, str] = {}
    for name in components:
        stems = chain([ascii_name(name)], (f"{ascii_name(name)}_{k}" for k in count(2)))
        found[name] = next(
            f for stem in stems if (f := f"resources/{stem}.ssv").lower() not in map(str.lower, found.values())
        )
    return found


def _structure(
    scenario: Scenario,
    components: Mapping[str, Component],
    places: Mapping[str, str],
    parameters: Mapping[str, str],
    arrays: Mapping[str, Mapping[str, FmuArray]],
) -> Element:
    """parameters: file of each component's, in the package."""
    settings = scenario.scenario
    declared = {f"xmlns:{prefix}": NAMESPACES[prefix] for prefix in ("ssd", "ssc", "ssv")}
    ssp_version = "2.0" if any(arrays.values()) else "1.0"
    about = {"generationTool": f"fmu-retune {version('fmu-retune')}"}
    about |= {"description": settings.description} if settings.description else {}
    root = Element(
        "ssd:SystemStructureDescription", {**declared, "version": ssp_version, "name": settings.name, **about}
    )
    system = SubElement(root, "ssd:System", {"name": settings.name})
    elements = SubElement(system, "ssd:Elements")
    units: dict[str, Unit] = {}
    for name, component in components.items():
        implementation = _IMPLEMENTATIONS[component_interface(component.description)]
        kind = {"type": "application/x-fmu-sharedlibrary", "implementation": implementation}
        element = SubElement(elements, "ssd:Component", {"name": name, "source": places[name], **kind})
        connectors = [v for v in component.variables.values() if _is_connector(scenario, name, v)]
        if connectors:
            table = SubElement(element, "ssd:Connectors")
            for v in connectors:
                array = arrays[name].get(v.name)
                if array is None or array.elements[0] == v.name:
                    units |= _add_connector(table, v, component, array)
        if _parameters(scenario, name, component):
            bindings = SubElement(element, "ssd:ParameterBindings")
            SubElement(bindings, "ssd:ParameterBinding", {"source": parameters[name]})
    if scenario.connections:
        table = SubElement(system, "ssd:Connections")
        for target, source in whole(scenario.connections, arrays).items():
            (start, start_connector), (end, end_connector) = source.parts, target.parts
            ends = {"startElement": start, "startConnector": start_connector}
            SubElement(table, "ssd:Connection", {**ends, "endElement": end, "endConnector": end_connector})
    add_units(root, "ssd", units.values())
    _add_experiment(root, settings.start_time, settings.stop_time, settings.macro_step)
    return root


def _is_connector(scenario: Scenario, component: str, v: ModelVariable) -> bool:
    if v.causality == "input":
        return f"{component}.{v.name}" in scenario.connections
    return is_numeric(v) and (v.causality == "output" or f"{component}.{v.name}" in scenario.connections.values())


def _add_connector(table: Element, v: ModelVariable, component: Component, array: FmuArray | None) -> dict[str, Unit]:
    """Append a typed connector, of the whole array where v is an element of one; return its unit, if it is defined."""
    kind = "input" if v.causality == "input" else "output"
    connector = SubElement(table, "ssd:Connector", {"name": array.name if array else v.name, "kind": kind})
    connector.attrib |= {"description": v.description} if v.description else {}
    unit = component.unit(v.name) if is_real(v.type) else None
    is_defined = unit is not None and unit.exponents is not None
    kind = "Integer" if v.type == "Enumeration" else TYPES[v.type].ssp  # libcosim knows no Enumeration
    SubElement(connector, f"ssc:{kind}", {"unit": unit.name} if unit is not None and is_defined else {})
    for size in array.sizes if array else ():
        SubElement(connector, "ssc:Dimension", {"size": str(size)})
    return {unit.name: unit} if unit is not None and is_defined else {}


def _add_experiment(root: Element, start: float, stop: float, step: float) -> None:
    """Append the default experiment, with libcosim's annotation of the step: SSP itself has none."""
    experiment = SubElement(root, "ssd:DefaultExperiment", {"startTime": repr(start), "stopTime": repr(stop)})
    annotations = SubElement(experiment, "ssd:Annotations")
    # libcosim takes every attribute of Algorithm, a namespace too, for an algorithm.
    namespace = {"xmlns:osp": "http://opensimulationplatform.com/SSP/OSPAnnotations"}
    annotation = SubElement(annotations, "ssc:Annotation", {**namespace, "type": "com.opensimulationplatform"})
    SubElement(SubElement(annotation, "osp:Algorithm"), "osp:FixedStepAlgorithm", {"baseStepSize": repr(step)})


def _parameters(scenario: Scenario, name: str, component: Component) -> list[ParameterValue]:
    """Return a component's start values. Raises WiringError."""
    values: dict[str, Value] = dict(scenario.components[name].start)
    for reference, change in scenario.change_functions().items():
        owner, variable = reference.parts
        if owner == name:
            values[variable] = value_of_change(reference, change, scenario.scenario.start_time)
    for reference in scenario.written:
        owner, variable = reference.parts
        start = _variable(component, name, variable).start if owner == name else None
        if start is not None:
            values.setdefault(variable, float(start))
    return [_parameter(component, name, variable, value) for variable, value in values.items()]


def _parameter(component: Component, name: str, variable: str, value: Value) -> ParameterValue:
    v = _variable(component, name, variable)
    kind: Any = TYPES[v.type].python
    if isinstance(value, str) != (kind is str):
        raise WiringError(f"'{name}.{variable}' is a {v.type} and cannot start as {value!r}.")
    unit = component.unit(variable)
    return ParameterValue(variable, kind(value), unit.name if unit is not None else None)


def _variable(component: Component, name: str, variable: str) -> ModelVariable:
    if variable not in component.variables:
        hint = did_you_mean(variable, component.variables) or "."
        raise WiringError(f"no variable '{variable}' in {name}{hint}")
    return component.variables[variable]


def _check_connections(scenario: Scenario, components: Mapping[str, Component]) -> None:
    """Check that variables exist (else WiringError) and units can be converted (else SspError)."""
    for target, source in scenario.connections.items():
        units: list[Unit | None] = []
        for reference in (source, target):
            name, variable = reference.parts
            _variable(components[name], name, variable)
            units.append(components[name].unit(variable))
        try:
            conversion(*units)
        except ValueError as e:
            raise SspError(f"connection {source} -> {target}: {e}.") from e


def _zipped(files: Mapping[str, bytes]) -> bytes:
    """Return a ZIP archive as in section 3 of the standard: deflated, ASCII names; without the time of day."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            entry = zipfile.ZipInfo(name, _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content)
    return buffer.getvalue()
