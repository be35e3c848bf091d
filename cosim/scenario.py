"""A scenario: which FMUs are joined how, what happens to the plant, what is sampled and estimated. TOML in."""

import tomllib
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from estimator import METHODS, Parameter, ParameterSpace

from .errors import ScenarioError
from .formula import compile_formula
from .names import did_you_mean

Value = float | int | bool | str


def _is_reference(name: str) -> str:
    component, _, variable = name.partition(".")
    if not component or not variable:
        raise ValueError(f"'{name}' must be COMPONENT.VARIABLE")
    return name


Reference = Annotated[str, AfterValidator(_is_reference)]
"""A variable of a component, such as `plant.der(phi_dot)`."""


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Settings(_Frozen):
    """The co-simulation itself."""

    name: str = Field(min_length=1, pattern=r"^[A-Za-z0-9_-]+$")
    """Used for run folders."""
    description: str = ""
    """One line for the report."""
    start_time: float = 0.0
    """[s]"""
    stop_time: float = Field(gt=0.0)
    """[s]"""
    macro_step: float = Field(gt=0.0)
    """Distance of communication points [s]."""
    coupling: Literal["sequential", "parallel"] = "sequential"
    """Sequential: controllers step first, the others use their outputs at once. Parallel: all step together."""
    isolation: Literal["process", "none"] = "process"
    """Each FMU in a process of its own, or all in this one."""
    timeout: float = Field(default=10.0, gt=0.0)
    """Longest time that one call of an FMU may take [s]."""

    @model_validator(mode="after")
    def _spans_whole_steps(self) -> Self:
        steps = (self.stop_time - self.start_time) / self.macro_step
        if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * max(1.0, steps):
            raise ValueError(
                f"stop_time - start_time must be a whole multiple of macro_step, "
                f"got {self.stop_time - self.start_time:g} s and {self.macro_step:g} s"
            )
        return self

    @property
    def n_steps(self) -> int:
        """Number of macro steps."""
        return round((self.stop_time - self.start_time) / self.macro_step)

    def time(self, k: int) -> float:
        """Communication point k [s]: a product, so that rounding does not add up."""
        return self.start_time + k * self.macro_step


class Component(_Frozen):
    """One FMU."""

    fmu: str = Field(min_length=1)
    """Name of a built-in FMU, or a path to a file, relative to the scenario's."""
    start: dict[str, Value] = {}
    """Start values set before initialisation."""


class Noise(_Frozen):
    """Gaussian measurement noise of one sampled variable."""

    noise: float = Field(default=0.0, ge=0.0)
    """Standard deviation, in the variable's unit."""


class Sampling(_Frozen):
    """What the estimator gets to see."""

    derivatives: dict[Reference, Noise] = Field(min_length=1)
    """Derivatives that are compared with the model's, all of one component: the plant."""
    states: dict[Reference, Noise] = {}
    """Noise on states, where they are not measured exactly."""

    @field_validator("derivatives")
    @classmethod
    def _one_plant(cls, value: dict[str, Noise]) -> dict[str, Noise]:
        if len({name.partition(".")[0] for name in value}) > 1:
            raise ValueError("all sampled derivatives must be of one component")
        silent = next((name for name, n in value.items() if n.noise == 0.0), None)
        if silent:
            raise ValueError(f"'{silent}' must have noise > 0: it weighs the residual")
        return value


class Tracking(_Frozen):
    """Trigger on the tracking error."""

    kind: Literal["tracking"]
    """tracking"""
    threshold: float = Field(gt=0.0)
    """tau_e, in the norm of the tracked outputs."""


class Innovation(_Frozen):
    """Trigger on the residual of the newest sample."""

    kind: Literal["innovation"]
    """innovation"""
    false_alarm: float = Field(default=1e-6, gt=0.0, lt=1.0)
    """Probability of firing on one sample where nothing has changed."""


TriggerSettings = Annotated[Tracking | Innovation, Field(discriminator="kind")]


class Loop(_Frozen):
    """How the controller is re-tuned. An estimator's own table may replace any of these."""

    trigger: TriggerSettings
    """When an episode begins."""
    budget: int = Field(default=30, ge=1)
    """N, evaluations an episode."""
    evaluations_per_step: int = Field(default=1, ge=1)
    """Evaluations a macro step."""
    commit: Literal["incumbent", "candidate"] = "incumbent"
    """What is written into the controller: the best so far, or each candidate."""
    window: int = Field(default=10, ge=1)
    """Most samples that a residual is taken over."""


class EstimatedParameter(_Frozen):
    """A parameter to estimate, and where it goes."""

    name: str = Field(min_length=1)
    """The model's keyword argument and, unless `true` says otherwise, the plant's variable."""
    lower: float
    """Lower bound, in `unit`."""
    upper: float
    """Upper bound."""
    unit: str = "1"
    """FMI unit string; must be the controller variable's."""
    scale: Literal["linear", "log"] = "linear"
    """Scale on which it is searched."""
    writes: Reference
    """The controller's tunable parameter."""
    true: Reference | None = None
    """The plant's parameter that it stands for, for the report only."""

    @model_validator(mode="after")
    def _is_sound(self) -> Self:
        self.to_parameter()
        return self

    def to_parameter(self) -> Parameter:
        """As the estimator knows it. Raises ValueError for reversed bounds."""
        return Parameter(self.name, self.lower, self.upper, self.unit, self.scale)


class Estimation(Loop):
    """What is estimated, by which model, and how."""

    model: str = Field(pattern=r"^[\w.]+:\w+$")
    """`module:function`, called as f(x, u, **parameters) for the plant's state derivatives."""
    parameters: tuple[EstimatedParameter, ...] = Field(min_length=1)
    """In the order of theta."""
    instants: tuple[float, ...] = ()
    """Times [s] at which the report compares estimated and true parameters."""
    target: dict[str, Any] = {}
    """Settings of the estimator `target`, and replacements of the above for it."""
    paper: dict[str, Any] = {}
    """The same for `paper`."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters as the estimators know them."""
        return ParameterSpace(tuple(p.to_parameter() for p in self.parameters))

    def loop(self, method: str) -> Loop:
        """The loop's settings for one estimator."""
        common = {name: getattr(self, name) for name in Loop.model_fields}
        own = {k: v for k, v in self._own(method).items() if k in Loop.model_fields}
        return Loop.model_validate(common | own)

    def settings(self, method: str) -> dict[str, Any]:
        """The estimator's own settings."""
        return {k: v for k, v in self._own(method).items() if k not in Loop.model_fields}

    def _own(self, method: str) -> dict[str, Any]:
        # Algorithm 1 commits each candidate, one a time step, and looks at the newest sample alone.
        paper = {"commit": "candidate", "evaluations_per_step": 1, "window": 1}
        return (paper | self.paper) if method == "paper" else dict(getattr(self, method))

    @model_validator(mode="after")
    def _methods_know_their_settings(self) -> Self:
        _ = self.space
        for method, entry in METHODS.items():
            known = {*Loop.model_fields, *entry.setting_names}
            for key in self._own(method):
                if key not in known:
                    raise ValueError(f"{method} has no setting '{key}'{did_you_mean(key, known)}")
            self.loop(method)
            entry.settings(**self.settings(method))
        return self


class Limits(_Frozen):
    """When a run is given up."""

    divergence: float = Field(default=100.0, gt=0.0)
    """A tracked error above this ends the run as diverged, in the tracked output's unit."""


Change = float | str | tuple[tuple[float, float | str], ...]
"""A value, a formula in t, or rows [time, value or formula]: each holds from its time on."""


class Scenario(_Frozen):
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
    folder: Path = Field(default=Path(), exclude=True)
    """Where relative paths of FMUs begin."""

    @classmethod
    def load(cls, source: str | Path, overrides: Mapping[str, str] | None = None) -> "Scenario":
        """The named scenario, or that of a TOML file, with `key.path = value` overrides.

        Raises ScenarioError, one line with file, key and rule.
        """
        path = _find(source)
        try:
            tree = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as e:
            reason = e.strerror if isinstance(e, OSError) else e
            raise ScenarioError(f"{path}: not a readable TOML file: {reason}.") from e
        for key, value in (overrides or {}).items():
            _override(tree, key, value)
        try:
            return cls.model_validate(tree | {"folder": path.parent})
        except ValidationError as e:
            raise ScenarioError(f"{path}: {_first_error(e)}") from e

    @property
    def plant(self) -> str:
        """Instance name of the component whose derivatives are sampled."""
        return next(iter(self.sampling.derivatives)).partition(".")[0]

    def change_functions(self) -> dict[str, Callable[[float], float]]:
        """Each changed parameter as a function of t [s]."""
        return _change_functions(self.definitions, self.changes)

    def true_reference(self, parameter: EstimatedParameter) -> str:
        """The plant's variable that an estimated parameter stands for."""
        return parameter.true or f"{self.plant}.{parameter.name}"

    @model_validator(mode="after")
    def _names_fit(self) -> Self:
        references = [*self.connections, *self.connections.values(), *self.changes, *self.tracking]
        references += [*self.tracking.values(), *self.sampling.derivatives, *self.sampling.states]
        references += [p.writes for p in self.estimation.parameters]
        for reference in references:
            component = reference.partition(".")[0]
            if component not in self.components:
                raise ValueError(f"'{reference}': no component '{component}'{did_you_mean(component, self.components)}")
        self.change_functions()
        return self


def named_scenarios() -> tuple[str, ...]:
    """Names of the scenarios that come with the package."""
    folder = resources.files("cosim") / "scenarios"
    return tuple(sorted(p.name.removesuffix(".toml") for p in folder.iterdir() if p.name.endswith(".toml")))


def _find(source: str | Path) -> Path:
    path = Path(source)
    if str(source) in named_scenarios():
        return Path(str(resources.files("cosim") / "scenarios" / f"{source}.toml"))
    if path.is_file():
        return path
    names = ", ".join(named_scenarios())
    hint = get_close_matches(str(source), named_scenarios(), n=1)
    raise ScenarioError(
        f"no scenario '{source}': neither a file nor one of {names}" + (f"; did you mean '{hint[0]}'?" if hint else ".")
    )


def _override(tree: dict[str, Any], key: str, text: str) -> None:
    """Put a value, written as in TOML or else a bare string, at a dotted key of the tree."""
    try:
        value = tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        value = text
    *path, last = key.split(".")
    for name in path:
        below: Any = tree.setdefault(name, {})
        if not isinstance(below, dict):
            raise ScenarioError(f"--set {key}: '{name}' is not a table.")
        tree = cast(dict[str, Any], below)
    tree[last] = value


def _first_error(error: ValidationError) -> str:
    """Key and rule of the first error, in one line."""
    first = error.errors()[0]
    key = ".".join(
        str(part) for part in first["loc"] if part not in ("tracking", "innovation") or len(first["loc"]) == 1
    )
    more = f" (and {error.error_count() - 1} more)" if error.error_count() > 1 else ""
    if first["type"] == "extra_forbidden":
        parent, name = first["loc"][:-1], str(first["loc"][-1])
        return f"{key}: unknown key{did_you_mean(name, _known_keys(parent))}{more}"
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    value = first["input"]
    got = f", got {value!r}" if isinstance(value, Value) and repr(value) not in message else ""
    return f"{key + ': ' if key else ''}{message[:1].lower()}{message[1:]}{got}{more}."


def _known_keys(path: tuple[int | str, ...]) -> set[str]:
    """Keys of the table at this place of a scenario."""
    tables: dict[tuple[str, ...], type[BaseModel]] = {
        (): Scenario, ("scenario",): Settings, ("sampling",): Sampling, ("estimation",): Estimation,
        ("limits",): Limits, ("components",): Component, ("estimation", "parameters"): EstimatedParameter,
        ("estimation", "trigger", "tracking"): Tracking, ("estimation", "trigger", "innovation"): Innovation,
        ("sampling", "derivatives"): Noise, ("sampling", "states"): Noise,
    }  # fmt: skip
    names = tuple(str(part) for part in path)
    model = tables.get(names) or tables.get(names[:-1])
    return set(model.model_fields) - {"folder"} if model else set()


def _change_functions(
    definitions: Mapping[str, float | str], changes: Mapping[str, Change]
) -> dict[str, Callable[[float], float]]:
    defined: dict[str, Callable[[float], float]] = {}
    for name, text in definitions.items():
        defined[name] = compile_formula(str(text), defined)
    return {name: _change_function(name, change, defined) for name, change in changes.items()}


def _change_function(
    name: str, change: Change, defined: Mapping[str, Callable[[float], float]]
) -> Callable[[float], float]:
    if not isinstance(change, tuple):
        return compile_formula(str(change), defined)
    times = [row[0] for row in change]
    if not times or any(b <= a for a, b in pairwise(times)):
        raise ValueError(f"{name}: the times of a change must rise, got {times}")
    pieces = [compile_formula(str(row[1]), defined) for row in change]

    def value(t: float) -> float:
        # Half a nanosecond late counts as in time: t is a rounded product.
        reached = [piece for since, piece in zip(times, pieces, strict=True) if t >= since - 5e-10]
        return (reached[-1] if reached else pieces[0])(t)

    return value
