"""Dry run of a scenario: its FMUs take two macro steps, and the model is compared with the plant's own derivatives."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimator import Vector

from ..errors import CosimError, ScenarioError, seconds
from ..findings import Finding, warning
from ..fmi.component import Component, component_of
from ..fmi.ports import is_numeric
from ..fmi.table import TableSlave, is_table
from ..objectives.choice import chosen
from ..objectives.model import opened_model
from ..sampling.derivative_filter import derivative_noise
from ..scenarios.scenario import Scenario
from ..slaves.slave import Slave, open_slave
from ..system.aliases import as_the_fmus_have_it
from ..system.fmu_cache import fmu_paths
from ..system.master import Master, Wiring
from ..system.parameters import true_parameters
from ..system.plant import Plant, plant_of
from ..system.tunables import TunableWriter
from ..system.tuning import check_first_values, first_parameters, tuning_rule
from ..system.wiring import wire
from ..user_code import USERS
from .check_model import plain

_STEPS: Final = 2
_WHERE: Final = "estimation.model"
_ROUNDING, _SLOPE = 1e-3, 0.1
"""Shares by which a model may differ from a declared derivative, and from a state's mean slope over a step."""
_SIGMA: Final = 3.0
"""Standard deviations of the declared noise below which no difference counts."""
_GROSS: Final = 0.5
"""Share by which a model that differs so at every point is wrong rather than simplified."""


@dataclass(frozen=True)
class _Step:
    """One macro step of the plant."""

    t: float
    """Its end [s]."""
    x: tuple[tuple[float, ...], tuple[float, ...]]
    """States (n,) at its start and end."""
    u: tuple[float, ...]
    """Inputs (p,) held over it."""
    theta: Vector
    """The plant's parameters (d,) in it."""
    xdot: Mapping[str, float]
    """Declared derivatives at its end, by state."""


def dry_run(scenario: Scenario) -> Iterator[Finding]:
    """Yield what goes wrong in two macro steps of the FMUs, and where the model differs from the plant's derivatives.

    Raises ScenarioError for a scenario of somebody else's, whose FMUs are not started.
    """
    if scenario.origin.stranger:
        raise ScenarioError(
            f"{scenario.origin.stranger}: --dry-run would run its FMUs, which only --trust allows: look at it first."
        )
    try:
        with ExitStack() as stack:
            paths = fmu_paths(scenario)
            slaves = {name: _opened(scenario, name, path, stack) for name, path in paths.items()}
            scenario = as_the_fmus_have_it(scenario, slaves)
            plant = plant_of(scenario, slaves[scenario.plant])
            steps = _steps(scenario, slaves, plant)
    except CosimError as e:
        yield Finding("scenario", f"in a dry run: {plain(e)}")
        return
    until = f"up to t = {seconds(steps[-1].t)} s"
    yield Finding("scenario", f"the FMUs were run for {_STEPS} macro steps, {until}", False, True)
    if chosen(scenario).kind == "derivative":
        component = component_of(paths[scenario.plant], slaves[scenario.plant].description)
        yield from _compared(scenario, plant, component, steps)


def _opened(scenario: Scenario, name: str, path: Path, stack: ExitStack) -> Slave | TableSlave:
    if is_table(path):
        return TableSlave(path, name)
    return stack.enter_context(open_slave(path, name, **scenario.scenario.slave_options))


def _steps(scenario: Scenario, slaves: Mapping[str, Slave | TableSlave], plant: Plant) -> list[_Step]:
    """Return the plant's first macro steps, with the controllers' first parameters. Raises CosimError."""
    settings, truth = scenario.scenario, true_parameters(scenario, slaves)
    wiring, groups = wire(scenario, slaves)
    rates = _rates(slaves[plant.name], plant)
    wiring[plant.name] = _reading(wiring[plant.name], [*plant.states, *rates.values()])
    master = Master(slaves, wiring, groups)
    master.initialize(settings.start_time, settings.stop_time)
    place = {name: i for i, name in enumerate(master.names)}
    written = check_first_values(scenario, tuning_rule(scenario), np.array(first_parameters(scenario, slaves)))
    disturbed = {f"{name}.{own}" for name, w in wiring.items() for own in w.disturbances}
    changed = [name for name in scenario.changes if name not in disturbed]
    tunables = TunableWriter([*changed, *scenario.written])
    estimated = [scenario.true_reference(p) for p in scenario.estimation.parameters]
    steps: list[_Step] = []
    for k in range(min(_STEPS, settings.n_steps)):
        t = settings.time(k)
        now = tunables.changed([*(truth[name](t) for name in changed), *written])
        master.disturb({name: [truth[f"{name}.{own}"](t) for own in w.disturbances] for name, w in wiring.items()})
        before = _values(master, plant, place)
        master.begin(t, settings.macro_step, now)
        master.finish(t, settings.macro_step, now)
        held = master.inputs.get(plant.name, {})
        steps.append(
            _Step(
                settings.time(k + 1),
                (before, _values(master, plant, place)),
                tuple(held.get(name, start) for name, start in plant.inputs.items()),
                np.array([truth[name](t) for name in estimated]),
                {state: master.values[place[f"{plant.name}.{rate}"]] for state, rate in rates.items()},
            )
        )
    return steps


def _rates(slave: Slave | TableSlave, plant: Plant) -> dict[str, str]:
    """Return the declared derivative of each state that has one."""
    known = {v.derivative.name: v.name for v in slave.description.modelVariables if v.derivative and is_numeric(v)}
    return {state: known[state] for state in plant.states if state in known}


def _reading(wiring: Wiring, names: list[str]) -> Wiring:
    return replace(wiring, outputs=(*wiring.outputs, *(n for n in names if n not in wiring.outputs)))


def _values(master: Master, plant: Plant, place: Mapping[str, int]) -> tuple[float, ...]:
    return tuple(master.values[place[f"{plant.name}.{name}"]] for name in plant.states)


def _compared(scenario: Scenario, plant: Plant, component: Component, steps: list[_Step]) -> Iterator[Finding]:
    """Yield the states whose derivative the model gives otherwise than the FMU, each where it differs most."""
    names, known = scenario.estimation.space.names, derivative_noise(scenario.sampling, scenario.scenario.macro_step)
    noise = dict(zip((plant.states[i] for i in plant.channels), known, strict=True))
    differences: dict[str, list[tuple[float, str]]] = {state: [] for state in plant.states}
    with opened_model(scenario, plant) as model:
        for step in steps:
            named = dict(zip(names, step.theta.tolist(), strict=True))
            try:
                found = [_modelled(model, x, step.u, named) for x in step.x]
            except USERS as e:
                text = f"has no value at t = {seconds(step.t)} s: {type(e).__name__}: {e}"
                yield Finding(_WHERE, plain(ScenarioError(text)))
                return
            for i, state in enumerate(plant.states):
                differences[state].append(
                    _difference(scenario, component, step, state, i, found, noise.get(state, 0.0))
                )
    for state in plant.states:
        shares = [share for share, _ in differences[state]]
        worst = max(differences[state], default=(0.0, ""))
        if worst[0] > 0.0:
            is_gross = min(shares) > _GROSS
            yield Finding(_WHERE, worst[1]) if is_gross else warning(_WHERE, worst[1])


def _modelled(model: Any, x: tuple[float, ...], u: tuple[float, ...], named: Mapping[str, float]) -> list[float]:
    values = np.asarray(model(x, u, **named), dtype=float)
    if values.shape != (len(x),) or not np.all(np.isfinite(values)):
        raise ValueError(f"it returns {values.tolist()}")
    return values.tolist()


def _difference(
    scenario: Scenario,
    component: Component,
    step: _Step,
    state: str,
    i: int,
    found: list[list[float]],
    sigma: float,
) -> tuple[float, str]:
    """Return by what share model and FMU differ, 0 where that is little, and the words for it."""
    if state in step.xdot:
        name, share = component.derivatives[state], _ROUNDING
        fmu, model = step.xdot[state], found[1][i]
    else:
        name, share = f"mean slope of {state}", _SLOPE
        fmu = (step.x[1][i] - step.x[0][i]) / scenario.scenario.macro_step
        model = 0.5 * (found[0][i] + found[1][i])
    size, difference = max(abs(model), abs(fmu)), abs(model - fmu)
    unit = component.unit(name) if name in component.variables else None
    text = f"{name}: model {model:.4g}, FMU {fmu:.4g} {unit.name if unit else ''}".rstrip()
    at = ", ".join(f"{n} = {v:g}" for n, v in scenario.estimation.space.named(step.theta).items())
    is_little = difference <= max(share * size, _SIGMA * sigma, 1e-12)
    return (0.0 if is_little else difference / size), f"{text}, at t = {seconds(step.t)} s with {at}"
