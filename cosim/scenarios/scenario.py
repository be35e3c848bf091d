"""Scenarios, read from TOML: FMUs and connections, changes of the plant, sampling and estimation."""

import tomllib
from collections.abc import Callable, Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from estimator.diagnosis.settings import DiagnosisSettings

from ..errors import ScenarioError, one_line
from ..names import did_you_mean
from ..user_code import OWN, CodeOrigin
from ..variable_name import VariableName
from .changes import Change, change_functions
from .named import named_scenarios
from .overrides import override
from .schema.estimation import EstimatedParameter, EstimationSettings
from .schema.guard import GuardSettings
from .schema.record import RecordSettings
from .schema.sampling import ObservationSettings, Sampling, StateVariable
from .schema.simulation import ComponentSettings, RunLimits, SimulationSettings
from .schema.table import Reference, Table
from .validation import first_error


class Scenario(Table):
    """Everything that defines a run except the estimator and the seed."""

    scenario: SimulationSettings
    """Name, times and coupling."""
    components: dict[str, ComponentSettings] = Field(min_length=1)
    """FMUs by instance name."""
    connections: dict[Reference, Reference] = {}
    """Each connected input, and the output it takes: `"controller.phi" = "plant.phi"`; units are converted."""
    definitions: dict[str, float | str] = {}
    """Named functions of t [s] for the formulas of `changes`; each may use those before it; at most 100."""
    changes: dict[Reference, Change] = {}
    """Changes of the plant, unknown to the estimator: its tunable parameters, or inputs that are not connected
    (disturbances), as a value, a formula in t, or rows `[time, value]`."""
    tracking: dict[Reference, Reference] = Field(min_length=1)
    """Each tracked output, and its reference: `"plant.phi" = "reference.phi_ref"`."""
    sampling: Sampling
    """Measured variables of the plant, with their noise."""
    estimation: EstimationSettings
    """Estimated parameters, the objective and the loop."""
    limits: RunLimits = RunLimits()
    """Limits at which the run is stopped."""
    observations: ObservationSettings = ObservationSettings()
    """Checks that keep bad samples from the estimator."""
    diagnosis: DiagnosisSettings = DiagnosisSettings()
    """Rules for what is taken for changed parameters."""
    guard: GuardSettings = GuardSettings()
    """Limits on what is written into the controller, and rules for reverting it."""
    record: RecordSettings = RecordSettings()
    """Variables that a run folder holds, and in which form."""
    folder: Path = Field(default=Path(), exclude=True)
    """Folder that relative paths of FMUs begin at."""
    origin: CodeOrigin = Field(default=OWN, exclude=True)
    """Owner of the Python code that it names."""

    @classmethod
    def known_keys(cls) -> set[str]:
        """Return the keys that a file may have."""
        return super().known_keys() - {"folder", "origin"}

    @classmethod
    def load(cls, source: str | Path, overrides: Mapping[str, str] | None = None) -> "Scenario":
        """Load a named scenario, or that of a TOML file, with `key.path = value` overrides.

        Raises ScenarioError, one line with file, key and rule. For SSP packages see `cosim.load_scenario`.
        """
        path = find_scenario(source)
        if path.suffix.lower() == ".ssp":
            raise ScenarioError(f"{path} is an SSP package: load it with cosim.load_scenario.")
        return cls.from_tables(read_tables(path), overrides, path.parent, path)

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[str, Any],
        overrides: Mapping[str, str] | None,
        folder: Path,
        label: Path,
        origin: CodeOrigin = OWN,
    ) -> "Scenario":
        """Make the scenario of a file's tables; folder: where its paths begin; label: names it in messages.

        Raises ScenarioError.
        """
        try:
            str(folder.absolute()).encode()
        except UnicodeEncodeError as e:
            text = "the name of its folder is not UTF-8 here, which FMUs need: rename it, or try LC_ALL=C.UTF-8"
            raise ScenarioError(f"{label}: {text}.") from e
        tree = dict(tables)
        for key, value in (overrides or {}).items():
            override(tree, key, value)
        if inner := next((key for key in ("folder", "origin") if key in tree), None):
            raise ScenarioError(f"{label}: {inner}: unknown key.")
        try:
            return cls.model_validate(tree | {"folder": folder, "origin": origin})
        except ValidationError as e:
            raise ScenarioError(f"{label}: {one_line(first_error(e, cls))}") from e

    @property
    def plant(self) -> str:
        """Instance name of the component whose derivatives or outputs are sampled."""
        return next(iter((*self.sampling.derivatives, *self.sampling.outputs))).component

    def change_functions(self) -> dict[VariableName, Callable[[float], float]]:
        """Return each changed parameter or input as a function of t [s]."""
        return change_functions(self.definitions, self.changes)

    def true_reference(self, parameter: EstimatedParameter) -> VariableName:
        """Return the plant's variable that an estimated parameter stands for."""
        return parameter.true or VariableName(f"{self.plant}.{parameter.name}")

    @property
    def formulas(self) -> dict[VariableName, str]:
        """Formula, or `module:function`, of each parameter of the controllers that has one."""
        parameters = self.estimation.parameters
        return {name: text for p in parameters if not p.is_written_as_it_is for name, text in p.written.items()}

    @property
    def written(self) -> dict[VariableName, str]:
        """Formulas, with the names of the estimates that are written as they are."""
        return {name: text for p in self.estimation.parameters for name, text in p.written.items()}

    def held_column(self, parameter: EstimatedParameter) -> str:
        """Return the recorded column of an estimate: the controller's parameter, where it is written as it is."""
        writes = parameter.writes
        return writes if isinstance(writes, VariableName) else f"estimated.{parameter.name}"

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        named: dict[str, Iterable[VariableName]] = {
            "connections": [*self.connections, *self.connections.values()],
            "changes": self.changes,
            "tracking": [*self.tracking, *self.tracking.values()],
            "sampling": [*self.sampling.derivatives, *self.sampling.outputs, *self.sampling.states],
            "sampling.faults": [f.sensor for f in self.sampling.faults if f.sensor is not None],
            "estimation.parameters": [*self.written, *(p.true for p in self.estimation.parameters if p.true)],
        }
        for table, references in named.items():
            for reference in references:
                if reference.component not in self.components:
                    hint = did_you_mean(reference.component, self.components)
                    raise ValueError(f"{table}: '{reference}': no component '{reference.component}'{hint}")
        for reference, other in self.tracking.items():
            if reference == other:
                raise ValueError(f"tracking: '{reference}' is tracked against itself")
        self.scenario.check_size(sum(c.fmu is not None for c in self.components.values()))
        self.change_functions()
        if isinstance(self.sampling.filter, StateVariable):
            self.sampling.filter.n_steps(self.scenario.macro_step)
        return self


def read_tables(path: Path, label: Path | None = None) -> dict[str, Any]:
    """Read the tables of a TOML file; label: names it in messages. Raises ScenarioError."""
    if path.suffix.lower() == ".fmu":
        about = f"retune info {path} lists what it has, retune new --plant {path} -o FILE.toml writes a scenario for it"
        raise ScenarioError(f"{path} is an FMU, not a scenario: {about}.")
    if path.suffix.lower() == ".csv":
        raise ScenarioError(f"{path} is a table, not a scenario: retune new --plant FMU --reference {path} takes one.")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as e:  # bytes or numbers that are too long, tables too deep
        reason = e.strerror if isinstance(e, OSError) else "it is not UTF-8" if isinstance(e, UnicodeError) else e
        raise ScenarioError(f"{label or path}: not a readable TOML file: {reason}.") from e


def find_scenario(source: str | Path) -> Path:
    """Return the file of a named scenario, or of a path. Raises ScenarioError."""
    path = Path(source)
    if str(source) in named_scenarios():
        return Path(str(resources.files("cosim") / "scenarios" / f"{source}.toml"))
    try:
        if path.is_file():
            return path
        if str(source) and path.is_dir():
            about = f"a run's goes on with retune resume {path}, and again with retune replay {path} --estimator NAME"
            raise ScenarioError(f"{path} is a folder, not a scenario: {about}.")
    except OSError:  # no file can have this name
        path = Path()
    names = named_scenarios()
    file = next((other for other in Path().glob("*.toml") if other.stem == str(source)), None)
    hint = f"; did you mean '{file}'?" if file else did_you_mean(str(source), names)
    raise ScenarioError(
        f"no scenario '{one_line(str(source))}': neither a file nor one of {', '.join(names)}{hint or '.'}"
    )
