"""Scenarios on the system of an SSP package.

Components, connections and start values are the package's. The rest, of which SSP knows nothing, is a TOML file's:
changes of the plant, tracking, sampling and estimation.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ..errors import SspError
from ..system.package_cache import unpacked_package
from ..units import conversion
from .package import SystemStructure

EXTRA = "extra/org.fmu-retune"
"""Folder of the scenario in a package of ours: `extra/` is for data that the standard does not define (section 3)."""
SCENARIO = "scenario.toml"


def scenario_in(package: Path) -> Path | None:
    """Return the scenario file that a package has, if any. Raises SspError, ModelDescriptionError."""
    file = unpacked_package(package) / EXTRA / SCENARIO
    return file if file.is_file() else None


def with_system(tree: Mapping[str, Any], system: SystemStructure) -> dict[str, Any]:
    """Return a scenario's tables with the components and connections of a system.

    A start value of the tables stays where it is of a parameter that the scenario changes; all others are the
    package's. A component's tolerance, which SSP does not know, is the tables'. Raises SspError for what a scenario
    cannot express: nested systems, converted connections.
    """
    for name in system.components:
        if "." in name:
            raise SspError(f"{system.name}: component '{name}' of a nested system cannot be in a scenario.")
    for source, target, transform in system.connections:
        units = [system.components[end.element].unit(end.connector) for end in (source, target)]
        if transform != conversion(*units):
            raise SspError(f"{system.name}: '{target}' takes a transformed value; a scenario converts units only.")
    changes = cast(dict[str, Any], tree.get("changes", {}))
    components = {
        name: {
            "fmu": str(component.fmu),
            "start": {k: v for k, v in system.start.get(name, {}).items() if f"{name}.{k}" not in changes}
            | {k: v for k, v in _table(tree, "components", name, "start").items() if f"{name}.{k}" in changes},
        }
        | {k: v for k, v in _table(tree, "components", name).items() if k == "tolerance"}
        for name, component in system.components.items()
    }
    connections = {str(c.target): str(c.source) for c in system.connections}
    return {**tree, "components": components, "connections": connections}


def _table(tree: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """Return a table within the tables; the schema reports whatever is wrong there."""
    found: Any = tree
    for key in keys:
        found = cast(dict[str, Any], found).get(key, {}) if isinstance(found, dict) else {}
    return cast(dict[str, Any], found) if isinstance(found, dict) else {}
