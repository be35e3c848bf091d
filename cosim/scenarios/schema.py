"""The tables of a scenario file, each validated when built."""

from typing import Annotated, Any, Literal, Self, cast

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from estimator import METHODS, Method, Parameter, ParameterSpace

from ..names import did_you_mean

MOST = 1_000_000_000
"""Of whatever is counted, or waited for [s]: more is a slip, and what a machine cannot hold."""
Value = float | int | bool | str


def _is_reference(name: str) -> str:
    component, _, variable = name.partition(".")
    if not component or not variable:
        raise ValueError(f"'{name}' must be COMPONENT.VARIABLE")
    return name


Reference = Annotated[str, AfterValidator(_is_reference)]
"""A variable of a component, such as `plant.der(phi_dot)`."""


class Table(BaseModel):
    """A table of a scenario file: frozen, unknown keys refused, numbers finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Settings(Table):
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
    timeout: float = Field(default=10.0, gt=0.0, le=MOST)
    """Longest time that one call of an FMU may take [s]."""
    checkpoint: int = Field(default=500, ge=0, le=MOST)
    """Communication points from one checkpoint of a run folder to the next, for `retune resume`; 0: none."""
    memory_limit: float = Field(default=0.0, ge=0.0)
    """Memory that the process of one FMU may hold [MB]; 0: half of the machine's. Linux only."""
    out_of_range: Literal["fault", "warning"] = "fault"
    """What an input or output outside its declared min and max is; one that is not finite is a fault."""

    @model_validator(mode="after")
    def _spans_whole_steps(self) -> Self:
        steps = (self.stop_time - self.start_time) / self.macro_step
        if not 1.0 - 1e-6 <= steps < 1e9 or abs(steps - round(steps)) > 1e-6 * max(1.0, steps):
            raise ValueError(
                f"stop_time - start_time must be a whole multiple of macro_step, "
                f"got {self.stop_time - self.start_time:g} s and {self.macro_step:g} s"
            )
        return self

    @property
    def slave_options(self) -> dict[str, Any]:
        """Keywords of open_slave."""
        return self.model_dump(include={"isolation", "timeout", "memory_limit", "out_of_range"})

    @property
    def n_steps(self) -> int:
        """Number of macro steps."""
        return round((self.stop_time - self.start_time) / self.macro_step)

    def time(self, k: int) -> float:
        """Communication point k [s]: a product, so that rounding does not add up."""
        return self.start_time + k * self.macro_step


class Component(Table):
    """One FMU, or a table that is played."""

    fmu: str | None = Field(default=None, min_length=1)
    """Name of a built-in FMU, or a path to a file, relative to the scenario's."""
    fmi: Literal[2, 3] = 2
    """FMI version of a built-in FMU; a file says its own."""
    table: str | None = Field(default=None, pattern=r"(?i)\.csv$")
    """Instead of it: path of a CSV file, see `cosim.fmi.table`."""
    start: dict[str, Value] = {}
    """Start values set before initialisation."""

    @model_validator(mode="after")
    def _is_one_of_them(self) -> Self:
        if (self.fmu is None) == (self.table is None):
            raise ValueError("must have either 'fmu' or 'table'")
        if self.table and self.start:
            raise ValueError("a table takes no start values")
        return self


class Tracking(Table):
    """Trigger on the tracking error."""

    kind: Literal["tracking"]
    """tracking"""
    threshold: float = Field(gt=0.0)
    """tau_e, in the norm of the tracked outputs."""


class Innovation(Table):
    """Trigger on the residual of the newest sample."""

    kind: Literal["innovation"]
    """innovation"""
    false_alarm: float = Field(default=1e-6, gt=0.0, lt=1.0)
    """Probability of firing on one sample where nothing has changed."""


class Always(Table):
    """One episode from the first sample to the end, for recursive estimators."""

    kind: Literal["always"]
    """always"""


TriggerSettings = Annotated[Tracking | Innovation | Always, Field(discriminator="kind")]


class Loop(Table):
    """How the controller is re-tuned. An estimator's own table may replace any of these."""

    trigger: TriggerSettings
    """When an episode begins."""
    budget: int = Field(default=30, ge=1, le=MOST)
    """N, evaluations an episode."""
    evaluations_per_step: int = Field(default=1, ge=1, le=MOST)
    """Evaluations a macro step."""
    commit: Literal["incumbent", "candidate"] = "incumbent"
    """What is written into the controller: the best so far, or each candidate."""
    window: int = Field(default=10, ge=1, le=MOST)
    """Most samples that a residual is taken over."""


class EstimatedParameter(Table):
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


class LinearModel(Table):
    """A model written as rows psi(theta) = targets, linear in coefficients psi."""

    rows: str = Field(pattern=r"^[\w.]+:\w+$")
    """`module:function`, called as f(x, u, xdot) for rows (r, p) and targets (r,)."""
    coefficients: str = Field(pattern=r"^[\w.]+:\w+$")
    """`module:function`, called as f(**parameters) for the coefficients (p,)."""


class RolloutSettings(Table):
    """How candidates are simulated, where the objective is `rollout`. Budgets are the loop's, in roll-outs."""

    fmu: str | None = Field(default=None, min_length=1)
    """What is simulated: by default the plant's FMU; else a built-in one, or a path relative to the scenario's."""
    start: Literal["auto", "state", "measured", "replay"] = "auto"
    """How a roll-out begins: in the plant's saved FMU state, in measured states, or simulated from the start."""
    jobs: int = Field(default=2, ge=1, le=256)
    """Processes; the results do not depend on it."""


class Estimation(Loop):
    """What is estimated, by which model, and how."""

    objective: str = Field(default="auto", pattern=r"^(auto|derivative|rollout|[\w.]+:\w+)$")
    """What a candidate is judged by: sampled derivatives against the model's, outputs measured against simulated, or
    `module:function`, called as f(theta, samples) for residuals in standard deviations. See `objectives`."""
    model: str | None = Field(default=None, pattern=r"^([\w.]+:\w+|.+\.fmu|[A-Za-z]\w*)$")
    """`module:function`, called as f(x, u, **parameters) for the plant's state derivatives; or a model-exchange FMU:
    a path relative to the scenario's, or the name of a built-in plant. Needed for derivatives only."""
    rollout: RolloutSettings = RolloutSettings()
    """How candidates are simulated."""
    parameters: tuple[EstimatedParameter, ...] = Field(min_length=1)
    """In the order of theta."""
    instants: tuple[float, ...] = ()
    """Times [s] at which the report compares estimated and true parameters."""
    linear: LinearModel | None = None
    """The model's linear form, for recursive least squares."""
    methods: dict[str, dict[str, Any]] = {}
    """Settings of single estimators, and replacements of the above for them: in a file, `[estimation.NAME]`."""

    @property
    def space(self) -> ParameterSpace:
        """The parameters as the estimators know them."""
        return ParameterSpace(tuple(p.to_parameter() for p in self.parameters))

    def loop(self, name: str, method: Method | None = None) -> Loop:
        """The loop's settings for one estimator; method: what it is, where it is none of `METHODS`."""
        common = {name: getattr(self, name) for name in Loop.model_fields}
        own = {k: v for k, v in self._own(name, method).items() if k in Loop.model_fields}
        return Loop.model_validate(common | own)

    def settings(self, name: str, method: Method | None = None) -> Any:
        """The estimator's own settings, an instance of its settings' class."""
        given = {k: v for k, v in self._own(name, method).items() if k not in Loop.model_fields}
        return TypeAdapter((method or METHODS[name]).settings).validate_python(given)

    def _own(self, name: str, method: Method | None = None) -> dict[str, Any]:
        """What is set for one estimator: by the one that it is like, by itself, by the scenario."""
        method = method or METHODS[name]
        known = {*Loop.model_fields, *method.setting_names}
        inherited = self._own(method.like) if method.like else {}
        return {k: v for k, v in inherited.items() if k in known} | dict(method.defaults) | self.methods.get(name, {})

    @model_validator(mode="before")
    @classmethod
    def _gather_methods(cls, table: Any) -> Any:
        if not isinstance(table, dict):
            return table
        given = cast(dict[str, Any], table)
        named = {k: v for k, v in given.items() if k in METHODS or ":" in k}
        for name, settings in named.items():
            if not isinstance(settings, dict):
                raise ValueError(f"estimation.{name} must be a table, got {settings!r}")
        rest = {k: v for k, v in given.items() if k not in named}
        return rest | {"methods": {**rest.get("methods", {}), **named}} if named else rest

    @model_validator(mode="after")
    def _methods_know_their_settings(self) -> Self:
        _ = self.space
        for name in METHODS:
            self.check_method(name)
        return self

    def check_method(self, name: str, method: Method | None = None) -> None:
        """Raises ValueError where an estimator's settings do not fit it."""
        known = {*Loop.model_fields, *(method or METHODS[name]).setting_names}
        for key in self.methods.get(name, {}):
            if key not in known:
                raise ValueError(f"estimation.{name} has no setting '{key}'{did_you_mean(key, known)}")
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


class Limits(Table):
    """When a run is given up."""

    divergence: float = Field(default=100.0, gt=0.0)
    """A tracked error above this ends the run as diverged, in the tracked output's unit."""


class GuardSettings(Table):
    """What may be written into the controller, and what is taken back. Shares are of the scaled bounds."""

    enabled: bool = True
    """Whether writes are guarded."""
    rate: float = Field(default=0.5, gt=0.0, le=1.0)
    """Most that a parameter may move in a macro step, as a share."""
    material: float = Field(default=0.05, ge=0.0, le=1.0)
    """Smaller changes since the last one looked into are neither predicted nor put on probation, as a share."""
    unseen: float = Field(default=0.35, gt=0.0, le=1.0)
    """A direction of which the standard deviation exceeds this share is not seen by the data, and not written."""
    foresight: bool = True
    """Whether the closed loop is rolled ahead before a material write."""
    horizon: int = Field(default=50, ge=1, le=MOST)
    """Macro steps that it is rolled ahead."""
    n_std: float = Field(default=2.0, ge=0.0)
    """Standard deviations by which the estimate is widened for it, along the worst direction."""
    growth: float = Field(default=1.5, ge=1.0)
    """Predicted peaks of the tracking error may exceed that without the write, and errors the predicted, by this."""
    tolerance: float | None = Field(default=None, gt=0.0)
    """A tracking error below it is never a reason to revert, in the norm of the tracked outputs; none: a hundredth of
    limits.divergence."""
    probation: int = Field(default=100, ge=1, le=MOST)
    """Macro steps for which the tracking error is watched after a write."""
    reverts: int = Field(default=3, ge=1, le=MOST)
    """Reverts after which re-tuning stops, with the parameters of the start."""
