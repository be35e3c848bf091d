"""A scenario in an SSP package of ours: its tables, and the modules and FMUs that they name."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tomli_w

from ..errors import told_at
from ..objectives.model import model_fmu
from ..scenarios.scenario import Scenario
from ..scenarios.trust import GRANTS, python_references
from ..system.fmu_cache import component_path, find_fmu
from ..user_code import is_trusted, places_of
from .scenario import EXTRA, SCENARIO

_OWN_PACKAGES = ("cosim", "estimator", "fmu_models")


def scenario_files(scenario: Scenario, places: Mapping[str, str]) -> Iterator[tuple[str, bytes]]:
    """Yield path and content of each file of a scenario in the package, relative to its folder there.

    places: file of each component's FMU in the package. Raises ScenarioError for an FMU that is not there.
    """
    fmus = {key: (f"{key}/{ascii_name(fmu.stem)}.fmu", fmu) for key, fmu in _fmus(scenario).items()}
    tables = _tables(scenario, places, {key: place for key, (place, _) in fmus.items()})
    yield SCENARIO, tomli_w.dumps(tables).encode()
    yield from _modules(scenario)
    yield from ((place, fmu.read_bytes()) for place, fmu in fmus.values())


def ascii_name(name: str) -> str:
    """Return a name for a file of a package, in ASCII (SSP 1.0, section 3)."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name)


def _fmus(scenario: Scenario) -> dict[str, Path]:
    """Return the FMUs of `model` and of `rollout`, which is left out where it is the plant's own.

    That is the default, and the only one whose saved state a roll-out can begin in.
    """
    settings, found = scenario.estimation, dict[str, Path]()
    if settings.model is not None and (model := model_fmu(scenario)) is not None:
        found["model"] = model
    if settings.rollout.fmu is not None:
        with told_at("estimation.rollout.fmu"):
            rollout = find_fmu(settings.rollout.fmu, scenario.folder)
        if rollout != component_path(scenario.components[scenario.plant], scenario.folder):
            found["rollout"] = rollout
    return found


def _tables(scenario: Scenario, places: Mapping[str, str], fmus: Mapping[str, str]) -> dict[str, Any]:
    """Return the scenario as TOML tables, with the FMUs where they are in the package; fmus: those of `_fmus`."""
    tables = scenario.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    up = "../" * (EXTRA.count("/") + 1)
    for name, component in tables["components"].items():
        component["fmu"] = up + places[name]
    tables["scenario"] = {k: v for k, v in tables["scenario"].items() if k not in GRANTS}
    estimation = tables["estimation"]
    estimation |= estimation.pop("methods", {})
    estimation.get("rollout", {}).pop("fmu", None)
    if "model" in fmus:
        estimation["model"] = fmus["model"]
    if "rollout" in fmus:
        estimation["rollout"]["fmu"] = fmus["rollout"]
    return tables


def _modules(scenario: Scenario) -> Iterator[tuple[str, bytes]]:
    """Yield the sources of the user's modules that the scenario names, from its folder or the working directory."""
    references = [*python_references(scenario).values(), *(name for name in scenario.estimation.methods if ":" in name)]
    for name, reference in {r.partition(":")[0].partition(".")[0]: r for r in references}.items():
        trusted = is_trusted(reference, scenario.origin)
        places = places_of(reference, scenario.folder, scenario.origin) if trusted else [scenario.folder]
        for folder in map(Path, places) if name and name not in _OWN_PACKAGES else ():
            found = [folder / f"{name}.py", *sorted((folder / name).rglob("*.py"))]
            found = [path for path in found if path.is_file()]
            yield from ((path.relative_to(folder).as_posix(), path.read_bytes()) for path in found)
            if found:
                break
