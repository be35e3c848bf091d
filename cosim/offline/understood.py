"""Request of an offline estimation with its FMU and logs read and checked."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator import Parameter, ParameterSpace, Vector

from ..errors import WiringError
from ..fmi.component import Component, read_component
from ..fmi.ports import Catalogue
from ..fmi.table import is_table
from ..fmi.types import is_real
from .forgotten_inputs import forgotten_inputs
from .log_windows import LogColumns, LogWindow, unused_columns, windows_of
from .logs import LogError, read_log
from .request import HOLDOUT, EstimateError, Request
from .rollout import least_noise, noise_of
from .start_states import start_warnings
from .time_unit import check_time, passed_over


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
    if double := next((p.name for p in request.parameters if p.name in request.inputs), None):
        raise EstimateError(f"--parameter {double} is an --input, too: it is sought, or in a column.")
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
