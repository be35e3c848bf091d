"""Offline estimation: parameters of a plant FMU from logs of measurements."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from estimator import Parameter, ParameterSpace, Vector
from estimator.offline.evaluated import FitProgress
from estimator.offline.fit import OFFLINE, NoFitError, OfflineFit, fit
from estimator.offline.profile_likelihood import Profile, profile
from estimator.offline.robust_loss import Loss
from estimator.space import Scale

from ..errors import CosimError, WiringError
from ..fmi.component import Component, read_component
from ..fmi.ports import Catalogue
from ..fmi.table import is_table
from ..fmi.types import is_real
from ..scenarios.schema.estimation import MOST_ROLLOUTS
from .counted_twice import counted_twice
from .finer_step import FinerStep, finer_step
from .forgotten_inputs import forgotten_inputs
from .log_windows import Cut, LogColumns, LogWindow, unused_columns, windows_of
from .logs import LogError, read_log
from .noisy_start import NoisyStart, start_noise_of
from .rollout import RolloutResidual, Rollouts, SimulatedPlant, least_noise, noise_of
from .start_states import start_warnings
from .swapped_columns import swapped_columns
from .time_unit import check_time, passed_over

HOLDOUT = 0.25
"""Share of each log's rows, the last ones, that parameters are not fitted to."""


class EstimateError(CosimError):
    """Error for an estimation that is impossible as requested."""


class FailedError(CosimError):
    """Error for an estimation in which every roll-out failed."""


@dataclass(frozen=True)
class Sought:
    """A parameter to estimate, as the user asks for it; its unit is the FMU's."""

    name: str
    lower: float
    upper: float
    scale: Scale = "linear"


@dataclass(frozen=True)
class Request:
    """Request of an estimation: the parameters to estimate, the FMU and the logs."""

    fmu: Path
    logs: tuple[Path, ...]
    parameters: tuple[Sought, ...]
    measured: Mapping[str, str]
    """Column by output of the FMU."""
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    """Column by input of the FMU."""
    start: Mapping[str, str | float] = field(default_factory=dict[str, "str | float"])
    """Column or value by variable: a state at the start of each window, or a parameter that is known."""
    noise: Mapping[str, float] = field(default_factory=dict[str, float])
    """Standard deviation by output, in its unit; estimated from the log where absent."""
    time: str | None = None
    """Column of time stamps."""
    time_unit: str | None = None
    """Unit of the time stamps; None: the log's, or s."""
    windows: tuple[Cut, ...] = ()
    """Parts of each log to use [s]; none: all of it."""
    validation: tuple[Path, ...] = ()
    """Logs that are held out as a whole."""
    holdout: float | None = None
    """Share of each log that is held out; None: `HOLDOUT`, or 0 where there are logs for validation."""
    step: float | None = None
    """Communication step [s]; None: from row to row."""
    method: str = "target"
    evaluations: int = 60
    """Candidates that the search may simulate."""
    seed: int = 0
    jobs: int = 1
    """Roll-outs at a time."""
    timeout: float = 10.0
    """Time that each call of the FMU may take [s]."""
    environment: tuple[str, ...] = ()
    """Environment variables that the FMU's processes are given beside those which every FMU is given."""
    own: tuple[str, ...] = ()
    """Parameters that have a value of their own in each log; the others have one for all logs."""
    loss: str = "linear"
    """SciPy's name of the loss of a residual: "linear" is its square, under the others outliers count for less."""
    f_scale: float = 1.0
    """Residual, in standard deviations of the noise, from which on it counts for less."""

    def __post_init__(self) -> None:
        if self.method not in OFFLINE:
            raise EstimateError(f"no method '{self.method}' for a log; there are {', '.join(OFFLINE)}.")
        if not (self.measured and self.parameters and self.logs):
            raise EstimateError("a log, a --parameter and a --measured output are needed, or more.")
        if self.evaluations < 1:
            raise EstimateError(f"--evaluations must be 1 or more, got {self.evaluations}.")
        if self.seed < 0:
            raise EstimateError(f"--seed must be 0 or more, got {self.seed}.")
        if not 1 <= self.jobs <= MOST_ROLLOUTS:
            raise EstimateError(f"--jobs must be from 1 to {MOST_ROLLOUTS}, got {self.jobs}.")
        if self.step is not None and not 0.0 < self.step < np.inf:
            raise EstimateError(f"--step must be positive, got {self.step:g} s.")
        if not 0.0 < self.f_scale < np.inf or (self.loss == "linear" and self.f_scale != 1.0):
            raise EstimateError(
                f"--f-scale must be positive, and goes with a --loss that is not linear, got {self.f_scale:g}."
            )
        try:
            Loss(self.loss, self.f_scale)
        except ValueError as e:
            raise EstimateError(f"{e}.") from e
        if not 0.0 < self.timeout < np.inf:
            raise EstimateError(f"--timeout must be positive, got {self.timeout:g} s.")
        if self.holdout is not None and not 0.0 <= self.holdout < 1.0:
            raise EstimateError(f"--holdout must be from 0 to below 1, got {self.holdout:g}.")
        if other := next((name for name in self.own if name not in {p.name for p in self.parameters}), None):
            raise EstimateError(f"--own {other} must be a --parameter too.")
        if self.own and self.validation:
            raise EstimateError("--own has no value for a log of --validate; hold rows out instead.")
        if low_high := next((w for w in self.windows if not w[0] < w[1]), None):
            raise EstimateError(f"--window must be FROM:TO with FROM < TO, got {low_high[0]:g}:{low_high[1]:g}.")
        bad = next((name for name, s in self.noise.items() if not (0.0 < s < np.inf and name in self.measured)), None)
        if bad is not None:
            raise EstimateError(f"--noise {bad} must be positive, and of a measured output.")

    @property
    def of_one_log(self) -> dict[str, tuple[str, Path]]:
        """Variable and log of each parameter that has a value of its own in each log, by the parameter's name."""
        names = Counter(path.name for path in self.logs)
        labels = {path: path.name if names[path.name] == 1 else str(path) for path in self.logs}
        return {f"{name} in {labels[path]}": (name, path) for name in self.own for path in self.logs}

    @property
    def constants(self) -> dict[str, float]:
        """Start values that are numbers, the same in every window."""
        return {name: float(value) for name, value in self.start.items() if not isinstance(value, str)}

    @property
    def start_columns(self) -> dict[str, str]:
        """Column by variable that starts as its column does."""
        return {name: value for name, value in self.start.items() if isinstance(value, str)}


@dataclass(frozen=True)
class Estimation:
    """Result of an estimation: the estimates, and the plant's fit to the logs."""

    request: Request
    component: Component
    space: ParameterSpace
    nominal: Vector
    """Values (d,) before: the FMU's own, or the user's."""
    fit: OfflineFit
    windows: tuple[LogWindow, ...]
    noise: Vector
    """Standard deviation (c,) of each output's noise."""
    before: tuple[Vector | None, ...]
    """Outputs (n, c) with the nominal parameters, by window; None where the simulation fails."""
    after: tuple[Vector | None, ...]
    """Outputs (n, c) with the estimated parameters, by window."""
    warnings: tuple[str, ...]
    """Warnings about parts of the logs that were not used."""
    evaluations: tuple[tuple[Vector, float, str | None], ...]
    """Candidates in order: theta, sum of squares and, where it failed, the reason."""
    seconds: float
    """Wall time [s]."""
    finer: FinerStep | None = None
    """Change of the estimates by half the communication step; None where it cannot be told."""
    profiles: tuple[Profile, ...] = ()
    """Profile likelihood of each parameter; empty where none was asked for."""

    @property
    def is_identifiable(self) -> tuple[bool, ...]:
        """True where the data determine the parameter (d,): by its profile, if there is one."""
        return tuple(p.is_identifiable for p in self.profiles) or self.fit.is_identifiable

    def __repr__(self) -> str:
        """Return one line with the estimates: the series would fill pages."""
        values = ", ".join(f"{name} = {value:.5g} ± {self.std[name]:.2g}" for name, value in self.estimates.items())
        return f"<Estimation from {self.request.fmu.name}: {values}>"

    @property
    def estimates(self) -> dict[str, float]:
        """The estimated value of each parameter, in its unit."""
        return self.space.named(self.fit.theta)

    @property
    def std(self) -> dict[str, float]:
        """The standard deviation of each estimate; see `docs/estimate.md` for what it covers."""
        return self.space.named(self.fit.std)

    @property
    def failures(self) -> Mapping[str, int]:
        """Number of candidates that failed, by reason."""
        return Counter(reason for _, _, reason in self.evaluations if reason is not None)

    def rms(self, outputs: Sequence[Vector | None], is_held_out: bool) -> Vector:
        """Return the root mean square error (c,) over the rows fitted to or held out; NaN where there are none.

        Under a loss outliers count in it as they do in the fit.
        """
        loss, noise = self.fit.loss, self.noise
        errors = [
            loss.shrunk((y - w.measured) / noise)[slice(w.n_fit, None) if is_held_out else slice(w.n_fit)] * noise
            for y, w in zip(outputs, self.windows, strict=True)
            if y is not None
        ]
        columns = np.concatenate(errors).T if errors else np.empty((len(self.noise), 0))
        known = [e[np.isfinite(e)] for e in columns]
        return np.array([np.sqrt(np.mean(e * e)) if len(e) else np.nan for e in known])


class Understood(NamedTuple):
    """A request with its FMU and logs read and checked."""

    component: Component
    space: ParameterSpace
    nominal: Vector
    """Values (d,) before: the FMU's own, or the user's."""
    windows: list[LogWindow]
    noise: Vector
    """Standard deviation (c,) of each output's noise."""
    warnings: list[str]
    """Warnings about parts of the logs that were not used."""


def understand(request: Request) -> Understood:
    """Read the FMU's description and the logs of a request. Raises CosimError in one line for what is refused."""
    if is_table(request.fmu):
        raise EstimateError(f"{request.fmu} is a table, not an FMU: the FMU comes first, then its logs.")
    component = read_component(request.fmu)
    space, nominal = _space(request, component)
    windows, warnings = _windows(request, _signals(request, component), component)
    check_time(windows, component, request.step, request.time_unit is not None)
    warnings += passed_over(windows, request.step)
    warnings += start_warnings(component, request.start, [p.name for p in request.parameters], request.own, windows)
    warnings += [f"{what}: {bound:g} is used." for what, bound in out_of_bounds(request, component).items()]
    return Understood(component, space, nominal, windows, _noise(request, windows), warnings)


def estimate(request: Request, progress: FitProgress = lambda n, cost: None) -> Estimation:
    """Estimate parameters of a plant FMU from logs.

    Raises CosimError in one line for what is refused, FailedError where no roll-out succeeds.
    """
    began = perf_counter()
    component, space, nominal, windows, noise, warnings = understand(request)
    warnings += counted_twice(request.logs, request.windows)
    start_noise = start_noise_of(request.start_columns, request.measured, component, windows, noise)
    noisy_start = NoisyStart(_plant(request), component, windows, space, noise, start_noise, request.jobs)
    with Rollouts(_plant(request), component, windows, request.jobs) as rollouts:
        residual = RolloutResidual(rollouts, space, windows, noise)
        if residual.n_residuals <= len(space):
            raise EstimateError(
                f"{residual.n_residuals} measured values are too few for {len(space)} parameters; hold less of it out."
            )
        rng = np.random.default_rng(request.seed)
        try:
            loss = Loss(request.loss, request.f_scale)
            found = fit(
                residual, space, nominal, request.method, request.evaluations, rng, progress, residual.series, loss,
                noisy_start.effects,
            )  # fmt: skip
        except NoFitError as e:
            raise FailedError(f"every roll-out failed, the first so: {residual.evaluations[0][2]}.") from e
        named = [space.named(nominal), space.named(found.theta)]
        of_nominal, of_found = rollouts.simulate(named, is_whole=True)
    before, after = ([r.outputs for r in row] for row in (of_nominal, of_found))
    failed = [(w, r.reason) for w, r in zip(windows, of_found, strict=True) if r.reason is not None]
    warnings += [f"{w.name}: with the estimates the FMU fails in held-out rows: {reason}" for w, reason in failed]
    if noisy_start.failure:
        warnings.append(f"± lacks the noise of the start values, aside of which the FMU fails: {noisy_start.failure}")
    warnings += swapped_columns(request.measured, residual.cross_misfits, residual.n_residuals)
    return Estimation(
        request,
        component,
        space,
        nominal,
        found,
        tuple(windows),
        noise,
        tuple(before),
        tuple(after),
        tuple(warnings),
        tuple(residual.evaluations),
        perf_counter() - began,
        finer_step(_plant(request), component, windows, space, noise, found),
    )


def with_profiles(found: Estimation, progress: Callable[[int], None] = lambda n: None) -> Estimation:
    """Return the estimation with the profile likelihood of each parameter, by further roll-outs.

    progress: called with the number of parameters done.
    """
    request, profiles = found.request, list[Profile]()
    with Rollouts(_plant(request), found.component, found.windows, request.jobs) as rollouts:
        residual = RolloutResidual(rollouts, found.space, found.windows, found.noise)
        for j in range(len(found.space)):
            progress(j)
            profiles.append(profile(residual, found.space, found.fit, j))
    return replace(found, profiles=tuple(profiles))


def _plant(request: Request) -> SimulatedPlant:
    return SimulatedPlant(
        request.fmu,
        tuple(request.inputs),
        tuple(request.measured),
        request.constants,
        request.step,
        request.timeout,
        request.environment,
        request.of_one_log,
    )


def _space(request: Request, component: Component) -> tuple[ParameterSpace, Vector]:
    """Return the parameters with their units, and their values before. Raises CosimError."""
    catalogue = Catalogue(request.fmu.name, component.description.modelVariables)
    parameters: list[Parameter] = []
    nominal: list[float] = []
    for p in request.parameters:
        port = catalogue.start_port(p.name, p.lower)
        if not is_real(kind := port.variables[0].type):
            raise WiringError(
                f"'{p.name}' of {request.fmu.name} is of type {kind}; only real numbers can be estimated."
            )
        if problem := port.problem([p.lower]) or port.problem([p.upper]):
            raise EstimateError(f"bounds of {request.fmu.name}: {problem}.")
        unit = component.unit(p.name)
        names = [name for name, (of, _) in request.of_one_log.items() if of == p.name] or [p.name]
        try:
            unit_name = unit.name if unit else "1"
            parameters += [Parameter(name, p.lower, p.upper, unit_name, p.scale) for name in names]
        except ValueError as e:
            raise EstimateError(str(e).rstrip(".") + ".") from e
        if column := request.start_columns.get(p.name):
            raise EstimateError(f"'{p.name}' is to be estimated: --start may give it a value, not column '{column}'.")
        before = _before(request, component, p.name)
        nominal += [before if before is not None else (p.lower + p.upper) / 2.0] * len(names)
    try:
        space = ParameterSpace(tuple(parameters))
    except ValueError as e:
        raise EstimateError(str(e)) from e
    return space, np.clip(nominal, [p.lower for p in parameters], [p.upper for p in parameters])


def _before(request: Request, component: Component, name: str) -> float | None:
    """Return a parameter's value before, the user's or else the FMU's; None where there is none."""
    given = request.start.get(name, component.variables[name].start)
    return None if given is None else float(given)


def out_of_bounds(request: Request, component: Component) -> dict[str, float]:
    """Return the bound that is used in place of each value before that is beyond it, by what is so, in words."""
    found: dict[str, float] = {}
    for p in request.parameters:
        before = _before(request, component, p.name)
        if before is not None and not p.lower <= before <= p.upper:
            given = f"--start {p.name}={before:g}" if p.name in request.start else f"the FMU's {p.name} = {before:g}"
            found[f"{given} is outside of {p.lower:g} to {p.upper:g}"] = p.lower if before < p.lower else p.upper
    return found


def _signals(request: Request, component: Component) -> LogColumns:
    """Return the columns by role, with the FMU's variables checked. Raises CosimError."""
    catalogue = Catalogue(request.fmu.name, component.description.modelVariables)
    catalogue.ports("input", tuple(request.inputs))
    catalogue.ports("output", tuple(request.measured))
    inputs = {v.name for v in component.description.modelVariables if v.causality == "input"}
    if given := next((name for name in request.measured if name in inputs), None):
        raise EstimateError(f"--measured '{given}' is an input of {request.fmu.name}, which no parameter changes.")
    for name, value in request.start.items():
        port = catalogue.start_port(name, 0.0 if isinstance(value, str) else value)
        if not isinstance(value, str) and (problem := port.problem([value])):
            raise EstimateError(f"--start of {request.fmu.name}: {problem}.")
        if name in request.inputs:
            raise EstimateError(f"input '{name}' starts as its column does; leave out its --start.")
    return LogColumns(request.inputs, request.measured, request.start_columns, request.time, request.time_unit)


def _windows(request: Request, signals: LogColumns, component: Component) -> tuple[list[LogWindow], list[str]]:
    """Return the windows of all logs, those of validation logs held out, and warnings. Raises LogError."""
    holdout = request.holdout if request.holdout is not None else 0.0 if request.validation else HOLDOUT
    windows: list[LogWindow] = []
    warnings: list[str] = []
    for paths, cuts, share in ((request.logs, request.windows, holdout), (request.validation, (), 1.0)):
        for path in paths:
            log = read_log(path)
            more, new_warnings = windows_of(log, signals, component, cuts, share)
            if not windows:
                started = (*request.start, *(p.name for p in request.parameters))
                warnings += forgotten_inputs(component, request.inputs, started, unused_columns(log, signals))
            windows += more
            warnings += new_warnings
    if not any(w.n_fit for w in windows):
        raise LogError("no rows are left to fit to; give a smaller --holdout.")
    return windows, warnings


def _noise(request: Request, windows: Sequence[LogWindow]) -> Vector:
    """Return the standard deviation (c,) of each output's noise, the user's or the log's. Raises EstimateError."""
    estimated = dict(zip(request.measured, noise_of(windows).tolist(), strict=True))
    noise, least = estimated | dict(request.noise), least_noise(windows)
    for i, (name, std) in enumerate(noise.items()):
        if std <= 0.0:
            is_known = any(np.isfinite(w.measured[: w.n_fit, i]).any() for w in windows)
            why = "never changes in the log" if is_known else "has no value in the rows to fit to"
            raise EstimateError(f"measured {name} {why}: its noise cannot be told; give --noise {name}=.")
        if std < least[i]:
            raise EstimateError(
                f"--noise {name} must be {least[i]:.2g} or more, a millionth of the range of its values, got {std:g}."
            )
    return np.array(list(noise.values()))
