"""Dry run of a scenario: its FMUs take some macro steps, and the model is compared with the plant's own derivatives."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice, takewhile
from pathlib import Path
from time import monotonic
from typing import Final

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
from ..text_table import counted
from ..user_code import USERS
from .check_model import plain
from .model_comparison import Difference, Step, differences

_STEPS: Final = 100
"""Macro steps that are taken."""
_FEWEST: Final = 2
"""Macro steps that are taken at least: where an FMU fails later, the others of the run are compared."""
_LONGEST: Final = 10.0
"""Time on the clock after which no further step is taken [s]."""
_WHERE: Final = "estimation.model"


def dry_run(scenario: Scenario) -> Iterator[Finding]:
    """Yield what goes wrong in the first macro steps, and where the model differs from the plant's derivatives.

    Raises ScenarioError for a scenario of somebody else's, whose FMUs are not started.
    """
    if scenario.origin.stranger:
        raise ScenarioError(
            f"{scenario.origin.stranger}: --dry-run would run its FMUs, which only --trust allows: look at it first."
        )
    begun = monotonic()
    try:
        with ExitStack() as stack:
            paths = fmu_paths(scenario)
            slaves = {name: _opened(scenario, name, path, stack) for name, path in paths.items()}
            scenario = as_the_fmus_have_it(scenario, slaves)
            plant = plant_of(scenario, slaves[scenario.plant])
            taken = _steps(scenario, slaves, plant)
            steps = list(islice(taken, _FEWEST))
            try:
                steps += takewhile(lambda _: monotonic() - begun < _LONGEST, taken)
            except CosimError as e:
                yield warning("scenario", f"in a dry run: {plain(e)}")
    except CosimError as e:
        yield Finding("scenario", f"in a dry run: {plain(e)}")
        return
    until = f"up to t = {seconds(steps[-1].t)} s"
    yield Finding("scenario", f"the FMUs were run for {counted(len(steps), 'macro step')}, {until}", False, True)
    if chosen(scenario).kind == "derivative":
        component = component_of(paths[scenario.plant], slaves[scenario.plant].description)
        yield from _compared(scenario, plant, component, steps)


def _opened(scenario: Scenario, name: str, path: Path, stack: ExitStack) -> Slave | TableSlave:
    if is_table(path):
        return TableSlave(path, name)
    return stack.enter_context(open_slave(path, name, **scenario.scenario.slave_options))


def _steps(scenario: Scenario, slaves: Mapping[str, Slave | TableSlave], plant: Plant) -> Iterator[Step]:
    """Yield the plant's first macro steps, with the controllers' first parameters. Raises CosimError."""
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
    for k in range(min(_STEPS, settings.n_steps)):
        t = settings.time(k)
        now = tunables.changed([*(truth[name](t) for name in changed), *written])
        master.disturb({name: [truth[f"{name}.{own}"](t) for own in w.disturbances] for name, w in wiring.items()})
        before = _values(master, plant, place)
        master.begin(t, settings.macro_step, now)
        master.finish(t, settings.macro_step, now)
        held = master.inputs.get(plant.name, {})
        yield Step(
            settings.time(k + 1),
            (before, _values(master, plant, place)),
            tuple(held.get(name, start) for name, start in plant.inputs.items()),
            np.array([truth[name](t) for name in estimated]),
            {state: master.values[place[f"{plant.name}.{rate}"]] for state, rate in rates.items()},
        )


def _rates(slave: Slave | TableSlave, plant: Plant) -> dict[str, str]:
    """Return the declared derivative of each state that has one."""
    known = {v.derivative.name: v.name for v in slave.description.modelVariables if v.derivative and is_numeric(v)}
    return {state: known[state] for state in plant.states if state in known}


def _reading(wiring: Wiring, names: list[str]) -> Wiring:
    return replace(wiring, outputs=(*wiring.outputs, *(n for n in names if n not in wiring.outputs)))


def _values(master: Master, plant: Plant, place: Mapping[str, int]) -> tuple[float, ...]:
    return tuple(master.values[place[f"{plant.name}.{name}"]] for name in plant.states)


def _compared(scenario: Scenario, plant: Plant, component: Component, steps: list[Step]) -> Iterator[Finding]:
    """Yield the states whose derivative the model gives otherwise than the FMU, each where it differs most."""
    space, h = scenario.estimation.space, scenario.scenario.macro_step
    known = derivative_noise(scenario.sampling, h)
    noise = dict(zip((plant.states[i] for i in plant.channels), known, strict=True))
    with opened_model(scenario, plant) as model:

        def modelled(x: Sequence[float], u: Sequence[float], theta: Vector) -> Sequence[float]:
            named = dict(zip(space.names, theta.tolist(), strict=True))
            try:
                values = np.asarray(model(x, u, **named), dtype=float)
            except USERS as e:
                raise ValueError(f"{type(e).__name__}: {e}") from e
            if values.shape != (len(x),) or not np.all(np.isfinite(values)):
                raise ValueError(f"it returns {values.tolist()}")
            return values.tolist()

        try:
            for d in differences(modelled, plant.states, steps, h, noise):
                text = _told(scenario, component, d)
                yield Finding(_WHERE, text) if d.is_mistake else warning(_WHERE, text)
        except ValueError as e:
            yield Finding(_WHERE, plain(ScenarioError(f"has no value {e}")))


def _told(scenario: Scenario, component: Component, d: Difference) -> str:
    name = f"mean slope of {d.state}" if d.is_mean else component.derivatives[d.state]
    unit = component.unit(name) if name in component.variables else None
    at = ", ".join(f"{n} = {v:g}" for n, v in scenario.estimation.space.named(d.step.theta).items())
    text = f"{name}: model {d.model:.4g}, FMU {d.fmu:.4g} {unit.name if unit else ''}".rstrip()
    return f"{text}, at t = {seconds(d.step.t)} s with {at}; {d.why}"
