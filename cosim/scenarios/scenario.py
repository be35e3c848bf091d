"""A scenario: which FMUs are joined how, what happens to the plant, what is sampled and estimated. TOML in."""

import re
import tomllib
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Self, cast

from pydantic import BaseModel, Field, ValidationError, model_validator

from estimator import METHODS

from ..errors import ScenarioError, one_line
from ..names import did_you_mean, named_scenarios
from .changes import Change, change_functions
from .sampling_schema import Derivative, Noise, ObservationSettings, Sampling, SavitzkyGolay, SensorFault, StateVariable
from .schema import (
    Always,
    Component,
    EstimatedParameter,
    Estimation,
    GuardSettings,
    Innovation,
    Limits,
    LinearModel,
    Reference,
    RolloutSettings,
    Settings,
    Table,
    Tracking,
    Value,
)


class Scenario(Table):
    """A complete description of a run but for estimator and seed."""

    scenario: Settings
    """Name, times, coupling."""
    components: dict[str, Component] = Field(min_length=1)
    """FMUs by instance name."""
    connections: dict[Reference, Reference] = {}
    """Input = output."""
    definitions: dict[str, float | str] = {}
    """Named functions of t for the formulas, each may use those before it."""
    changes: dict[Reference, Change] = {}
    """Tunable parameters of the plant over time, unknown to the estimator."""
    tracking: dict[Reference, Reference] = Field(min_length=1)
    """Tracked output = its reference."""
    sampling: Sampling
    """What the estimator sees."""
    estimation: Estimation
    """What it does with it."""
    limits: Limits = Limits()
    """When the run is given up."""
    observations: ObservationSettings = ObservationSettings()
    """Which samples the estimator does not get."""
    guard: GuardSettings = GuardSettings()
    """What may be written into the controller, and what is taken back."""
    folder: Path = Field(default=Path(), exclude=True)
    """Where relative paths of FMUs begin."""

    @classmethod
    def load(
        cls, source: str | Path, overrides: Mapping[str, str] | None = None, system: str | Path | None = None
    ) -> "Scenario":
        """The named scenario, that of a TOML file or that in an SSP package, with `key.path = value` overrides.

        system: an SSP package whose components, connections and start values take the place of the file's.
        Raises ScenarioError, one line with file, key and rule; SspError, ModelDescriptionError for a bad package.
        """
        path = label = _find(source)
        if path.suffix.lower() == ".ssp":
            from ..ssp.scenario import scenario_in  # here and below: most scenarios come without a package

            system, found = path, scenario_in(path)
            if found is None:
                raise ScenarioError(f"{path} holds no scenario: it can be simulated, but nothing in it is re-tuned.")
            path = found
        try:
            tree = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as e:  # bytes or numbers that are too long, tables too deep
            reason = e.strerror if isinstance(e, OSError) else e
            raise ScenarioError(f"{label}: not a readable TOML file: {reason}.") from e
        if system is not None:
            from ..ssp.package import System
            from ..ssp.scenario import with_system

            tree = with_system(tree, System.from_ssp(system))
        for key, value in (overrides or {}).items():
            override(tree, key, value)
        if "folder" in tree:
            raise ScenarioError(f"{label}: folder: unknown key.")
        try:
            return cls.model_validate(tree | {"folder": path.parent})
        except ValidationError as e:
            raise ScenarioError(f"{label}: {one_line(first_error(e))}") from e

    @property
    def plant(self) -> str:
        """Instance name of the component whose derivatives or outputs are sampled."""
        return next(iter((*self.sampling.derivatives, *self.sampling.outputs))).partition(".")[0]

    def change_functions(self) -> dict[str, Callable[[float], float]]:
        """Each changed parameter as a function of t [s]."""
        return change_functions(self.definitions, self.changes)

    def true_reference(self, parameter: EstimatedParameter) -> str:
        """The plant's variable that an estimated parameter stands for."""
        return parameter.true or f"{self.plant}.{parameter.name}"

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        named = {
            "connections": [*self.connections, *self.connections.values()],
            "changes": self.changes,
            "tracking": [*self.tracking, *self.tracking.values()],
            "sampling": [*self.sampling.derivatives, *self.sampling.outputs, *self.sampling.states],
            "sampling.faults": [f.sensor for f in self.sampling.faults if f.sensor is not None],
            "estimation.parameters": [p.writes for p in self.estimation.parameters],
        }
        for table, references in named.items():
            for reference in references:
                component = reference.partition(".")[0]
                if component not in self.components:
                    hint = did_you_mean(component, self.components)
                    raise ValueError(f"{table}: '{reference}': no component '{component}'{hint}")
        self.change_functions()
        return self


def _find(source: str | Path) -> Path:
    path = Path(source)
    if str(source) in named_scenarios():
        return Path(str(resources.files("cosim") / "scenarios" / f"{source}.toml"))
    try:
        if path.is_file():
            return path
    except OSError:  # no file can have this name
        path = Path()
    names = named_scenarios()
    hint = did_you_mean(str(source), names)
    raise ScenarioError(
        f"no scenario '{one_line(str(source))}': neither a file nor one of {', '.join(names)}{hint or '.'}"
    )


def override(tree: dict[str, Any], key: str, text: str) -> None:
    """Put `key = text` into the tree; both are written as in TOML, but a bare text is a string too."""
    path = _key_path(key)
    for name in path[:-1]:
        below: Any = tree.setdefault(name, {})
        if not isinstance(below, dict):
            raise ScenarioError(f"--set {key}={text}: '{name}' is not a table.")
        tree = cast(dict[str, Any], below)
    tree[path[-1]] = _value(text)


def _key_path(key: str) -> list[str]:
    """The names of a dotted TOML key. Raises ScenarioError."""
    path: list[str] = []
    try:
        rest: Any = tomllib.loads(f"{key} = 0")
    except tomllib.TOMLDecodeError:
        rest = {}
    while isinstance(rest, dict) and len(cast(dict[str, Any], rest)) == 1:
        name, rest = next(iter(cast(dict[str, Any], rest).items()))
        path.append(name)
    if rest != 0 or not path or len(key.splitlines()) != 1:
        raise ScenarioError(f"--set: '{one_line(key)}' is not a TOML key, such as scenario.stop_time.")
    return path


def _value(text: str) -> Any:
    try:
        tree = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return text
    return tree["value"] if len(tree) == 1 else text


def first_error(error: ValidationError) -> str:
    """Key and rule of the first error, in one line."""
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    text = error_texts(error)[0]
    end = "" if text.endswith("?") else "."
    return f"{text}{more}{end}"


def error_texts(error: ValidationError) -> list[str]:
    """Key and rule of each error, in one line."""
    return [_told(details) for details in error.errors()]


def _told(first: Mapping[str, Any]) -> str:
    key = ".".join(str(part) for part in first["loc"] if part != "[key]")
    kinds = r"\.(trigger|filter)\.(tracking|innovation|always|savitzky-golay|state-variable)"
    key = re.sub(kinds, r".\1", key)  # pydantic names the kind
    if first["type"] == "extra_forbidden":
        parent, name = first["loc"][:-1], str(first["loc"][-1])
        return f"{key}: unknown key{did_you_mean(name, _known_keys(parent))}"
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    value = first["input"]
    got = f", got {value!r}" if isinstance(value, Value) and "got" not in message else ""
    if key and message.startswith(f"{key}."):  # the place is told already, and more closely
        key = ""
    return f"{key + ': ' if key else ''}{message[:1].lower()}{message[1:]}{got}"


def _known_keys(path: tuple[int | str, ...]) -> set[str]:
    """Keys of the table at this place of a scenario."""
    tables: dict[tuple[str, ...], type[BaseModel]] = {
        (): Scenario, ("scenario",): Settings, ("sampling",): Sampling, ("estimation",): Estimation,
        ("limits",): Limits, ("components",): Component, ("estimation", "parameters"): EstimatedParameter,
        ("observations",): ObservationSettings, ("guard",): GuardSettings,
        ("estimation", "trigger", "tracking"): Tracking, ("estimation", "trigger", "innovation"): Innovation,
        ("estimation", "trigger", "always"): Always, ("estimation", "linear"): LinearModel,
        ("estimation", "rollout"): RolloutSettings,
        ("sampling", "derivatives"): Derivative, ("sampling", "states"): Noise, ("sampling", "outputs"): Noise,
        ("sampling", "faults"): SensorFault,
        ("sampling", "filter", "savitzky-golay"): SavitzkyGolay,
        ("sampling", "filter", "state-variable"): StateVariable,
    }  # fmt: skip
    names = tuple(str(part) for part in path)
    model = tables.get(names) or tables.get(names[:-1])
    names_of_methods = set(METHODS) if model is Estimation else set()
    return (set(model.model_fields) | names_of_methods) - {"folder", "methods"} if model else set()
