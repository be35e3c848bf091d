"""Loading of scenarios: named ones, those of TOML files, and those in SSP packages."""

from collections.abc import Mapping
from pathlib import Path

from ..errors import ScenarioError, SspError
from ..scenarios.scenario import Scenario, find_scenario, read_tables


def load_scenario(
    source: str | Path, overrides: Mapping[str, str] | None = None, system: str | Path | None = None
) -> Scenario:
    """Load a named scenario, that of a TOML file or that in an SSP package, with `key.path = value` overrides.

    system: an SSP package whose components, connections and start values take the place of the file's.
    Raises ScenarioError, one line with file, key and rule; SspError, ModelDescriptionError for a bad package.
    """
    path = Path(source)
    is_package = path.suffix.lower() == ".ssp" and path.is_file()
    if not is_package and system is None:
        return Scenario.load(source, overrides)
    from ..system.package_cache import discard, unpacked_package
    from .package import SystemStructure  # most scenarios come without a package
    from .scenario import check_settings, scenario_in, with_system

    file = scenario_in(path) if is_package else find_scenario(source)
    label = path if is_package else find_scenario(source)
    package = path if is_package else Path(str(system))
    try:
        if file is None:
            raise ScenarioError(f"{path} holds no scenario: it can be simulated, but nothing in it is re-tuned.")
        tables = with_system(read_tables(file, label), SystemStructure.from_ssp(package))
        if is_package:
            check_settings(tables, overrides or {}, path)
        return Scenario.from_tables(tables, overrides, file.parent, label)
    except (ScenarioError, SspError):
        if is_package and not overrides:  # else it may be they that are refused
            discard(unpacked_package(path))
        raise
