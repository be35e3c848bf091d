"""Times and steps of a system's simulation, from the package, from `--set` and from SSV files."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from ..errors import SspError
from ..names import did_you_mean
from ..scenarios.overrides import override
from ..scenarios.schema.simulation import SimulationSettings
from ..scenarios.schema.table import StartValue, Table
from ..scenarios.validation import first_error
from .package import SystemStructure
from .start_values import StartValues, read_start_values


def settings_of(system: SystemStructure, given: Mapping[str, Any]) -> SimulationSettings:
    """Return times and steps: those given, else those of the package.

    Raises SspError where neither says how long and in what steps, and for values that do not fit together.
    """
    name = "".join(c if c.isascii() and (c.isalnum() or c in "-_") else "_" for c in system.name)
    package = {"stop_time": system.stop_time, "macro_step": system.step_size}
    known = {key: value for key, value in package.items() if value is not None}
    try:
        settings = SimulationSettings.model_validate(
            {"name": name, "start_time": system.start_time, "coupling": "parallel", **known, **given}
        )
    except ValidationError as e:
        missing = next((str(i["loc"][0]) for i in e.errors() if i["type"] == "missing"), None)
        if missing:
            raise SspError(f"{system.name} does not say its {missing}; give --set scenario.{missing}=...") from e
        raise SspError(f"{system.name}: scenario.{first_error(e, SimulationSettings)}") from e
    try:
        settings.check_size(len(system.components))
    except ValueError as e:
        raise SspError(f"{system.name}: {e}.") from e
    if settings.coupling != "parallel":
        raise SspError(f"{system.name}: without an estimator coupling is 'parallel', got '{settings.coupling}'.")
    return settings


class _Start(Table):
    start: dict[str, StartValue] = {}


class _Overrides(Table):
    """The keys of a system that `--set` takes."""

    scenario: dict[str, Any] = {}
    components: dict[str, _Start] = {}


def overridden(
    system: SystemStructure, overrides: Mapping[str, str], start_values: Sequence[StartValues] = ()
) -> tuple[SystemStructure, SimulationSettings]:
    """Return a system with other start values, and its settings with `scenario.KEY = value`.

    Start values are those of SSV files, then of `components.NAME.start.VARIABLE = value`. Raises SspError,
    ScenarioError.
    """
    tree: dict[str, Any] = {}
    for key, text in overrides.items():
        override(tree, key, text)
    try:
        given = _Overrides.model_validate(tree)
    except ValidationError as e:
        raise SspError(f"{system.name}: {first_error(e, _Overrides)}") from e
    unknown = next((name for name in given.components if name not in system.components), None)
    if unknown is not None:
        hint = did_you_mean(unknown, system.components) or "."
        raise SspError(f"{system.name}: no component '{unknown}'{hint}")
    bound = read_start_values(start_values, system.components)
    own = {name: given.components[name].start if name in given.components else {} for name in system.components}
    start = {name: {**system.start.get(name, {}), **bound.get(name, {}), **own[name]} for name in system.components}
    return replace(system, start=start), settings_of(system, given.scenario)
