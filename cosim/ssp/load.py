"""Loading of scenarios: named ones, those of TOML files, and those in SSP packages."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

from ..errors import ScenarioError, SspError
from ..scenarios.overrides import override
from ..scenarios.scenario import Scenario, find_scenario, read_tables
from ..user_code import OWN, CodeOrigin


def load_scenario(
    source: str | Path,
    overrides: Mapping[str, str] | None = None,
    system: str | Path | None = None,
    trust: bool = False,
) -> Scenario:
    """Load a named scenario, that of a TOML file or that in an SSP package, with `key.path = value` overrides.

    system: an SSP package whose components, connections and start values take the place of the file's.
    trust: run the Python code that an SSP package's own scenario names, as if it were the user's.
    Raises ScenarioError, one line with file, key and rule; SspError, ModelDescriptionError for a bad package.
    """
    path = Path(source)
    is_package = path.suffix.lower() == ".ssp" and path.is_file()
    if not is_package and system is None:
        return Scenario.load(source, overrides)
    from ..system.package_cache import discard, unpacked_package
    from .package import SystemStructure  # most scenarios come without a package
    from .scenario import scenario_in, with_system

    file = scenario_in(path) if is_package else find_scenario(source)
    label = path if is_package else find_scenario(source)
    package = path if is_package else Path(str(system))
    try:
        if file is None:
            raise ScenarioError(f"{path} holds no scenario: it can be simulated, but nothing in it is re-tuned.")
        tables = with_system(read_tables(file, label), SystemStructure.from_ssp(package))
        origin = CodeOrigin(str(path), _own(overrides or {})) if is_package and not trust else OWN
        return Scenario.from_tables(tables, overrides, file.parent, label, origin)
    except (ScenarioError, SspError):
        if is_package and not overrides:  # else it may be they that are refused
            discard(unpacked_package(path))
        raise


def _own(overrides: Mapping[str, str]) -> frozenset[str]:
    """Return the keys that the user has given, as `table.key`, and all texts, which may be references."""
    tree: dict[str, Any] = {}
    for key, value in overrides.items():
        override(tree, key, value)
    own: set[str] = set()
    pending: list[tuple[str, Any]] = [("", tree)]
    while pending:
        key, value = pending.pop()
        own.add(value if isinstance(value, str) else key)
        own.add(key)
        if isinstance(value, dict):
            below = cast(dict[str, Any], value)
            pending += [(f"{key}.{name}".lstrip("."), inner) for name, inner in below.items()]
    return frozenset(own)
