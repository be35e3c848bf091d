"""The plant's states, inputs and sampled channels, in the order of the estimator's model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ..errors import WiringError, told_at
from ..fmi.archive import FmuFile
from ..fmi.component import outputs_of
from ..fmi.table import TableSlave
from ..names import did_you_mean
from ..scenarios.scenario import Scenario
from ..scenarios.schema.sampling import Derivative
from ..slaves.slave import Slave
from ..variable_name import VariableName

Described = Slave | FmuFile | TableSlave


@dataclass(frozen=True)
class Plant:
    """The component whose derivatives or outputs are sampled."""

    name: str
    """Instance name."""
    states: tuple[str, ...]
    """Its states, in the order of the model description: the model's x. Empty where there is no model and they are
    not all outputs. Those of an FMU that declares none are the scenario's, in its order."""
    inputs: Mapping[str, float]
    """Its inputs with their start values, in the order of the model description: the model's u. Those that the
    scenario changes are left out: nobody measures them."""
    channels: tuple[int, ...]
    """Places in x of the states whose derivatives are sampled."""
    rates: Mapping[str, str] = field(default_factory=dict[str, str])
    """State of each derivative, by the derivative's name: those that the FMU declares, and the scenario's `of`."""
    disturbances: Mapping[str, float] = field(default_factory=dict[str, float])
    """The inputs that the scenario changes, with their start values."""


def plant_of(scenario: Scenario, slave: Described) -> Plant:
    """Return the plant's states, inputs and sampled channels. Raises WiringError where a derivative has no state.

    States are those that the FMU declares; with a filter, which needs none declared, those of them that are outputs,
    and those that the scenario lists. Without one the scenario's list is all where the FMU declares none.
    """
    variables = slave.description.modelVariables
    declared = derivatives_of(slave)
    sampling = scenario.sampling
    state_of = declared | {name.variable: d.of.variable for name, d in sampling.derivatives.items() if d.of}
    outputs, is_state = set(numeric_outputs(slave)), set(declared.values())
    own = {f"{slave.name}.{name}" for name in outputs}
    if sampling.filter is not None:
        is_state = (is_state & outputs) | {name.variable for name in sampling.states}
    elif not sampling.derivatives and not is_state <= outputs:
        is_state = set()  # no model takes them, so they need not be measured
    states = tuple(v.name for v in variables if v.name in is_state)
    if sampling.filter is None and not declared:
        states = tuple(name.variable for name in sampling.states if name in own)
    known = {f"{slave.name}.{name}" for name in states}
    for reference in sampling.states:
        if reference not in known:
            problem = f"'{reference}' is no state of {slave.name}{did_you_mean(reference, states) or '.'}"
            raise WiringError(f'sampling.states."{reference}": {problem}')
    channels: list[int] = []
    for reference, d in sampling.derivatives.items():
        with told_at(f'sampling.derivatives."{reference}"'):
            channels.append(_channel(reference, d, states, declared))
    given: Mapping[str, Any] = scenario.components[slave.name].start
    start = {v.name: float(given.get(v.name, v.start) or 0.0) for v in variables if v.causality == "input"}
    disturbances = {name: value for name, value in start.items() if f"{slave.name}.{name}" in scenario.changes}
    inputs = {name: value for name, value in start.items() if name not in disturbances}
    rates = declared if sampling.filter else state_of
    return Plant(slave.name, states, inputs, tuple(channels), rates, disturbances)


def _channel(
    reference: VariableName, derivative: Derivative, states: tuple[str, ...], declared: Mapping[str, str]
) -> int:
    """Return the place in x of the state that a sampled derivative is of. Raises WiringError where there is none."""
    name, of = reference.variable, derivative.of and derivative.of.variable
    if of is None and name not in declared:
        hint = did_you_mean(name, declared) or f'; say of which state it is: of = "{reference.component}.STATE".'
        raise WiringError(f"'{reference}' is not declared as a state's derivative{hint}")
    if of is not None and declared.get(name, of) != of:
        raise WiringError(f"'{reference}' is declared as the derivative of '{declared[name]}', not of '{of}'.")
    state = of or declared[name]
    if state not in states:
        hint = did_you_mean(state, states) or "; name the states in sampling.states."
        raise WiringError(f"'{state}', of which '{reference}' is the derivative, is no state{hint}")
    return states.index(state)


def derivatives_of(slave: Described) -> dict[str, str]:
    """Return the state of each declared derivative, by the derivative's name."""
    return {v.name: v.derivative.name for v in slave.description.modelVariables if v.derivative is not None}


def disturbances_of(scenario: Scenario, slaves: Mapping[str, Described]) -> tuple[VariableName, ...]:
    """Return those of the scenario's changes that are inputs, in its order. Raises WiringError for a connected one."""
    inputs = {
        name: {v.name for v in slave.description.modelVariables if v.causality == "input"}
        for name, slave in slaves.items()
    }
    found = tuple(r for r in scenario.changes if r.variable in inputs[r.component])
    for reference in found:
        if reference in scenario.connections:
            raise WiringError(f'changes."{reference}": {connected_as_well(scenario, reference)}.')
    return found


def connected_as_well(scenario: Scenario, reference: VariableName) -> str:
    """Return a message on an input that is both changed and connected."""
    return f"'{reference}' is connected to '{scenario.connections[reference]}': an input is either changed or connected"


def numeric_outputs(slave: Described) -> tuple[str, ...]:
    """Return the names of the outputs that are numbers."""
    return tuple(v.name for v in outputs_of(slave.description))
