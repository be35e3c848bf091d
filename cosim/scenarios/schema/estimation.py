"""Tables of a scenario file on the estimation: parameters, objective, loop and estimators."""

from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Final, Literal, Self, cast, get_type_hints

from pydantic import Discriminator, Field, Strict, Tag, TypeAdapter, ValidationError, model_validator

from estimator import METHODS, Method, Parameter, ParameterSpace
from estimator.methods import FORMER_METHODS, method_named
from estimator.triggers import TriggerSettings

from ...former_names import tell_new_name
from ...names import did_you_mean
from ...variable_name import VariableName
from ..formula import compile_expression, identifier
from .table import FUNCTION, MOST, Reference, Table
from .toml_types import check_types

MOST_ROLLOUTS: Final = 256
"""Largest number of roll-outs at a time: each has a process of its own."""
NAME, FORMULAS = "[name]", "[formulas]"
"""Pydantic's places of the two forms of `writes`, which are no keys."""


def _form(given: object) -> str:
    return FORMULAS if isinstance(given, Mapping) else NAME


Writes = Annotated[
    Annotated[Reference, Tag(NAME)] | Annotated[dict[Reference, str], Tag(FORMULAS)], Discriminator(_form)
]
"""The controller's parameter that an estimate is written to, or formulas for several."""


class LoopSettings(Table):
    """Settings of the re-tuning loop. An estimator's own table may replace any of them."""

    trigger: TriggerSettings = Field(discriminator="kind")
    """The condition that begins an episode."""
    budget: int = Field(default=30, ge=1, le=MOST)
    """Number of evaluations in an episode, at most: one that has found what there is to find ends earlier."""
    evaluations_per_step: int = Field(default=1, ge=1, le=MOST)
    """Number of evaluations in a macro step."""
    commit: Literal["incumbent", "candidate"] = "incumbent"
    """Parameters written into the controller: the best so far, or each candidate."""
    window: int = Field(default=10, ge=1, le=MOST)
    """Largest number of newest samples that a candidate is evaluated on."""


class EstimatedParameter(Table):
    """A parameter to estimate, and the controller's parameters that depend on it."""

    name: str = Field(min_length=1)
    """The model's keyword argument and, unless `true` says otherwise, the plant's variable."""
    lower: float
    """Lower bound, in `unit`."""
    upper: float
    """Upper bound."""
    unit: str = "1"
    """FMI unit string; must be that of the controller's parameter, where it is written as it is, else the plant's."""
    scale: Literal["linear", "log"] = "linear"
    """Scale of the search."""
    writes: Writes = {}
    """The controller's tunable parameter that the estimate is written to; or formulas for several, in all estimated
    parameters by name (`inertia_J` for `inertia.J`): `{ "controller.PI.k" = "20*J", "controller.PI.Ti" = "J/d" }`. In
    place of a formula `module:function`, called as f(**parameters) for a number or, where it is named for several, as
    many in their order. May be left out where the formulas of others use the estimate."""
    start: float | None = None
    """Value that the controller begins with, where `writes` has formulas or is left out; otherwise it is the start
    value of the controller's parameter."""
    true: Reference | None = None
    """The plant's parameter that the estimate is compared with in the report; not used in the estimation."""

    @model_validator(mode="after")
    def _is_sound(self) -> Self:
        parameter = self.to_parameter()
        if self.is_written_as_it_is:
            if self.start is not None:
                raise ValueError(f"'{self.name}' starts as '{self.writes}' does: leave out start")
        elif self.start is None:
            if not self.writes:
                text = "needs writes, a parameter of the controller; or start, where formulas of others use it"
                raise ValueError(f"'{self.name}' {text}")
            raise ValueError(
                f"'{self.name}', written by formulas, needs start, the value that the controller begins with"
            )
        elif not parameter.contains(self.start):
            raise ValueError(f"'{self.name}' starts at {self.start:g}, outside [{self.lower:g}, {self.upper:g}]")
        return self

    @property
    def is_written_as_it_is(self) -> bool:
        """True where one of the controller's parameters is the estimate itself."""
        return not isinstance(self.writes, dict)

    @property
    def written(self) -> dict[VariableName, str]:
        """Formula of each of the controller's parameters in `writes`, or function of the user's; else its own name."""
        return {self.writes: self.name} if isinstance(self.writes, VariableName) else cast(Any, self.writes)

    def to_parameter(self) -> Parameter:
        """Return it as a parameter of the estimator. Raises ValueError for reversed bounds."""
        return Parameter(self.name, self.lower, self.upper, self.unit, self.scale)


class LinearModel(Table):
    """A model written as rows psi(theta) = targets, linear in coefficients psi."""

    rows: str = Field(pattern=r"^[\w.]+:\w+$")
    """`module:function`, called as f(x, u, xdot) for rows (r, p) and targets (r,). xdot holds the derivatives of
    `sampling.derivatives`, in that order, and no others; with `sampling.filter` all three are the filter's."""
    coefficients: str = Field(pattern=r"^[\w.]+:\w+$")
    """`module:function`, called as f(**parameters) for the coefficients (p,)."""


class RolloutSettings(Table):
    """Simulation of candidates, where the objective is `rollout`; `budget` then counts roll-outs."""

    fmu: str | None = Field(default=None, min_length=1)
    """The FMU to simulate, the plant's by default: a built-in one by name, or a path relative to the scenario's."""
    start: Literal["auto", "state", "measured", "replay"] = "auto"
    """Beginning of a roll-out: in the plant's saved FMU state, in measured states, or by simulation from the start."""
    jobs: int = Field(default=2, ge=1, le=MOST_ROLLOUTS)
    """Number of processes; the results do not depend on it."""


class TrueParametersSettings(Table):
    """Settings of the baseline `true`, which writes the plant's true parameters."""

    delay: int = Field(default=0, ge=0)
    """Number of macro steps by which they are written late: what the best estimate from so many samples could reach."""


class EstimationSettings(LoopSettings):
    """Settings of the estimation: parameters, objective, model, and the loop."""

    objective: str = Field(default="auto", pattern=r"^(auto|derivative|rollout|[\w.]+:\w+)$")
    """Comparison that a candidate is scored by: `derivative` compares sampled derivatives with the model's, `rollout`
    measured outputs with simulated ones; `module:function` is called as f(theta, samples) for residuals in standard
    deviations."""
    model: str | None = Field(default=None, pattern=r"^([\w.]+:\w+|.+\.fmu|[A-Za-z]\w*)$")
    """`module:function`, called as f(x, u, **parameters) for the plant's state derivatives; or a model-exchange FMU:
    a path relative to the scenario's, or the name of a built-in plant. Needed for derivatives only."""
    vectorised: bool = False
    """True where the model, a function, takes k points in a call, as those of SciPy's solvers do: x (n, k), u (p, k)
    and each parameter (k,) as NumPy arrays, for n derivatives of k numbers each. At the start it is compared with one
    call after the other."""
    rollout: RolloutSettings = RolloutSettings()
    """Simulation of candidates, with the objective `rollout`."""
    parameters: tuple[EstimatedParameter, ...] = Field(min_length=1)
    """The parameters to estimate, in the order of theta."""
    instants: tuple[Annotated[float, Strict()], ...] = ()
    """Times [s] at which the report compares estimated and true parameters."""
    linear: LinearModel | None = None
    """The model's linear form, for recursive least squares."""
    true: TrueParametersSettings = TrueParametersSettings()
    """The baseline `true`."""
    methods: dict[str, dict[str, Any]] = {}
    """Settings of single estimators, and their replacements of the above: `[estimation.NAME]` in a file."""

    @classmethod
    def known_keys(cls) -> set[str]:
        """Return the keys that it may have: `methods` is written as tables named for the estimators."""
        return (super().known_keys() | set(METHODS)) - {"methods"}

    @property
    def space(self) -> ParameterSpace:
        """Space of the parameters, for the estimators."""
        return ParameterSpace(tuple(p.to_parameter() for p in self.parameters))

    def loop(self, name: str, method: Method | None = None, by_sample: bool = True) -> LoopSettings:
        """Return the loop's settings for one estimator; method: its description, if it is not one of the package.

        by_sample: false where candidates are judged on whole episodes.
        """
        common = {name: getattr(self, name) for name in LoopSettings.model_fields}
        usual = dict((method or method_named(name)).sample_defaults) if by_sample else {}
        own = {k: v for k, v in (usual | self._own(name, method)).items() if k in LoopSettings.model_fields}
        return LoopSettings.model_validate(common | own)

    def settings(self, name: str, method: Method | None = None) -> Any:
        """Return the estimator's own settings, an instance of its settings' class."""
        given = {k: v for k, v in self._own(name, method).items() if k not in LoopSettings.model_fields}
        return _adapter((method or method_named(name)).settings).validate_python(given)

    def _own(self, name: str, method: Method | None = None) -> dict[str, Any]:
        """Return the settings of one estimator: those of the one it is like, its own defaults, then the scenario's."""
        method = method or method_named(name)
        known = {*LoopSettings.model_fields, *method.setting_names}
        inherited = self._own(method.like) if method.like else {}
        return {k: v for k, v in inherited.items() if k in known} | dict(method.defaults) | self.methods.get(name, {})

    @model_validator(mode="before")
    @classmethod
    def _gather_methods(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        given = cast(dict[str, Any], table)
        named = {k: v for k, v in given.items() if k in METHODS or ":" in k or is_former_method(k)}
        for name, settings in named.items():
            if not isinstance(settings, dict):
                raise ValueError(f"estimation.{name} must be a table, got {settings!r}")
        rest = {k: v for k, v in given.items() if k not in named}
        return rest | {"methods": {**rest.get("methods", {}), **named}} if named else rest

    @model_validator(mode="after")
    def _formulas_have_their_names(self) -> Self:
        written: set[VariableName] = set()
        names = [identifier(p.name) for p in self.parameters]
        for parameter in self.parameters:
            for reference, text in parameter.written.items():
                if reference in written:
                    raise ValueError(f"estimation.parameters: '{reference}' is written twice; once is enough")
                written.add(reference)
                if parameter.is_written_as_it_is or FUNCTION.fullmatch(text):
                    continue
                try:
                    compile_expression(text, names)
                except ValueError as e:
                    raise ValueError(f'estimation.parameters: writes "{reference}": {e}') from e
        if not written:
            raise ValueError("estimation.parameters: nothing is written: give one of them writes")
        return self

    @property
    def takes_arrays(self) -> bool:
        """True where the model is a function, 'module:function', and vectorised: an FMU in its place is not."""
        return self.vectorised and ":" in (self.model or "") and not str(self.model).endswith(".fmu")

    @model_validator(mode="after")
    def _methods_know_their_settings(self) -> Self:
        _ = self.space
        for name in (*METHODS, *FORMER_METHODS):
            self.check_method(name)
        return self

    def check_method(self, name: str, method: Method | None = None) -> None:
        """Check an estimator's settings. Raises ValueError where they do not fit it."""
        known = {*LoopSettings.model_fields, *(method or method_named(name)).setting_names}
        for key in self.methods.get(name, {}):
            if key not in known:
                raise ValueError(f"estimation.{name} has no setting '{key}'{did_you_mean(key, known)}")
        try:
            check_types(get_type_hints((method or method_named(name)).settings), self.methods.get(name, {}))
        except ValueError as e:
            raise ValueError(f"estimation.{name}.{e}") from e
        try:
            self.loop(name, method)
            self.settings(name, method)
        except ValidationError as e:
            first = e.errors()[0]
            place = ".".join(str(part) for part in first["loc"])
            message = first["msg"].removeprefix("Value error, ")
            got = "" if "got" in message else f", got {first['input']!r}"
            message = f"{message[:1].lower()}{message[1:]}{got}"
            raise ValueError(f"estimation.{name}{'.' + place if place else ''}: {message}") from e


def is_former_method(name: str) -> bool:
    """Return whether this is a former name of an estimator, now another with settings; if so, print the new one."""
    if name not in FORMER_METHODS:
        return False
    now = FORMER_METHODS[name]
    settings = ", ".join(f"estimation.{now.like}.{key} = {value}" for key, value in now.defaults.items())
    tell_new_name(f"estimator '{name}'", f"'{now.like}' with {settings}")
    return True


@cache
def _adapter(kind: type[Any]) -> TypeAdapter[Any]:
    """Return the checker of a class of settings; to make it takes longer than to load a scenario."""
    return TypeAdapter(kind)
