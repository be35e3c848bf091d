"""Sampling and estimation in a draft scenario: see `draft`."""

import math
from collections.abc import Container, Mapping
from typing import Final

from ..errors import one_line
from ..fmi.archive import capabilities
from ..fmi.component import Component, ModelVariable
from ..fmi.feedthrough import declared
from ..fmi.ports import attribute
from ..fmi.types import is_real
from ..scenarios.formula import identifier
from ..units import BASE_UNITS
from .draft_parameters import unit_name
from .guess import PLANT, echoes
from .toml_lines import quoted, said

_NOISE: Final = 1e-3  # of the nominal value, else of the start value, else of 1
_LEAST: Final = 1e-12  # smallest noise that is guessed: a start of less is zero, but for rounding
_SAVED: Final = 20  # samples of a roll-out that begins in the plant's saved state
_REPLAYED: Final = 100  # of one that begins where earlier, wrong parameters have led: its end must say enough
_RATES: Final = ("d{}", "d_{}", "der_{}", "der{}", "d{}_dt", "d{}dt", "{}_dot", "{}dot", "{}_der")


def sampling(plant: Component, model: str | None) -> list[str]:
    """Return the lines for derivatives that depend on parameters or inputs; kinematic ones do not inform a parameter.

    If the plant has no derivatives among its outputs, a filter is proposed; roll-outs, where it hides its states.
    """
    if is_rolled_out(plant, model):
        return [*_outputs(plant), *_hint(plant)]
    if named := named_rates(plant):
        return _by_name(plant, named)
    outputs = {v.name for v in plant.having("output")}
    rates = {rate: state for state, rate in plant.derivatives.items() if rate in outputs}
    telling = {rate for rate, depends in _dependencies(plant).items() if rate in rates and depends}
    lines = ["[sampling.derivatives]  # what is measured, with the standard deviation of its noise"]
    for rate in rates:
        noise, guess = _noise(plant.variables[rate])
        text = f"{quoted(f'{PLANT}.{rate}')} = {{ noise = {noise} }}"
        is_used = rate in telling or not telling
        note = f"[{unit_name(plant, rate)}] " + (f"{guess}: a run measures it" if is_used else "depends on states only")
        lines.append(said(text if is_used else f"# {text}", note))
    return lines if rates else _filtered(plant)


def _noise(v: ModelVariable) -> tuple[str, str]:
    """Return a guess at the standard deviation of a variable's noise, in proportion to its size, and its reason."""
    for value, what in ((attribute(v, "nominal"), "nominal value"), (v.start, "start value")):
        noise = _NOISE * abs(float(value or 0.0))
        if noise >= _LEAST and math.isfinite(noise):
            return f"{noise:.3g}", f"GUESS of the noise, a thousandth of the {what}"
    return f"{_NOISE:g}", "GUESS of the noise, as nothing tells the size"


def named_rates(plant: Component) -> dict[str, str]:
    """Return the outputs named as another's derivative, by that one; none where derivatives are declared."""
    if plant.derivatives:
        return {}
    outputs = {v.name for v in plant.having("output") if is_real(v.type)}
    named = {name: next((rate for form in _RATES if (rate := form.format(name)) in outputs), None) for name in outputs}
    return {v.name: rate for v in plant.having("output") if (rate := named.get(v.name))}


def _hint(plant: Component) -> list[str]:
    """Return a comment on outputs that a model would be compared with, where there are any."""
    named = named_rates(plant)
    pairs = ", ".join(f"{one_line(rate)} of {one_line(state)}" for state, rate in named.items())
    if not named:
        return []
    return [
        f"# By their names these outputs are derivatives: {pairs}. With the plant's equations in Python,",
        "# retune new ... --model plant_model:derivative compares them, and simulates nothing.",
    ]


def _by_name(plant: Component, named: Mapping[str, str]) -> list[str]:
    """Return the lines for derivatives known by their names, and for the states."""
    lines = ["[sampling.derivatives]  # what is measured, with the standard deviation of its noise"]
    for state, rate in named.items():
        noise, guess = _noise(plant.variables[rate])
        text = f"{quoted(f'{PLANT}.{rate}')} = {{ noise = {noise}, of = {quoted(f'{PLANT}.{state}')} }}"
        lines.append(said(text, f"[{unit_name(plant, rate)}] GUESS by its name, and {guess}: a run measures it"))
    lines += ["", "[sampling.states]       # the model's x, in this order"]
    return lines + [
        said(f"{quoted(f'{PLANT}.{name}')} = {{}}", "GUESS that it is a state") for name in model_states(plant)
    ]


def is_rolled_out(plant: Component, model: str | None) -> bool:
    """Return whether candidates must be simulated: there is no model, and outputs without a start hide the states."""
    if model is not None or _has_rates(plant):
        return False
    return not all(is_settable(plant.variables[name]) for name in model_states(plant))


def is_settable(v: ModelVariable) -> bool:
    """Return whether a state or output takes a start value, and declares one."""
    return v.initial in ("exact", "approx") and v.start is not None


def _saves_its_state(plant: Component) -> bool:
    """Return whether its states can be given to another instance, in another process."""
    interface = capabilities(plant.description)
    return bool(interface.canGetAndSetFMUstate and interface.canSerializeFMUstate)


def _outputs(plant: Component) -> list[str]:
    """Return the lines for outputs that roll-outs are compared with: an echo of an input tells nothing."""
    lines = ["[sampling.outputs]      # what is measured, with the standard deviation of its noise"]
    echoed = echoes(plant)
    for v in plant.having("output"):
        if is_real(v.type) and v.name not in echoed:
            noise, guess = _noise(v)
            text = f"{quoted(f'{PLANT}.{v.name}')} = {{ noise = {noise} }}"
            lines.append(said(text, f"[{unit_name(plant, v.name)}] {guess}: a run measures it"))
    return lines


def model_states(plant: Component) -> list[str]:
    """Return the states x of the model: the declared ones; if no derivative is an output, measured or likely ones."""
    echoed = echoes(plant)
    outputs = [v.name for v in plant.having("output") if is_real(v.type) and v.name not in echoed]
    if not plant.derivatives:
        rates = set(named_rates(plant).values())
        return [name for name in outputs if name not in rates]
    has_rates, measured = _has_rates(plant), set(outputs)
    return [state for state in plant.derivatives if has_rates or state in measured] or outputs


def _has_rates(plant: Component) -> bool:
    """Return whether derivatives are among the outputs, and can be measured."""
    outputs = {v.name for v in plant.having("output")}
    return any(rate in outputs for rate in plant.derivatives.values())


def _filtered(plant: Component) -> list[str]:
    """Return the lines for derivatives filtered from the outputs that may be states."""
    states = model_states(plant)
    lines = ["[sampling.derivatives]  # no output is declared as one: the filter below makes them from sampled states"]
    rates = _rates_of(plant, states)
    is_any = any(rate is None for rate in rates.values())
    for state, rate in rates.items():
        text = f"{quoted(f'{PLANT}.der({state})')} = {{ of = {quoted(f'{PLANT}.{state}')} }}"
        if rate is None or not is_any:
            lines.append(said(text, "GUESS that a parameter or an input enters it"))
        else:
            lines.append(said(f"# {text}", f"GUESS: it is {one_line(rate)}, which says nothing of a parameter"))
    is_declared = bool(plant.derivatives)
    lines += [
        "",
        "[sampling.states]       # the model's x, in the FMU's order, with the standard deviation of the noise",
    ]
    for state in states:
        noise, guess = _noise(plant.variables[state])
        text = f"{quoted(f'{PLANT}.{state}')} = {{ noise = {noise} }}"
        note = f"{guess}: a run measures it" if is_declared else f"{guess}, and that it is a state"
        lines.append(said(text, f"[{unit_name(plant, state)}] {note}"))
    return [
        *lines,
        "",
        "[sampling.filter]",
        'kind = "savitzky-golay"',
        said("points = 11", "GUESS: more smooth more, and are later by half a macro step each"),
        said("# every = 5", "points: a sample sooner, at the price of noise that samples share"),
        said("order = 3", "of the polynomial: 2 smooths more, and is biased where the plant is not linear"),
        "",
        "# Instead of derivatives, filter and model: [sampling.outputs] with what is measured, and in [estimation]",
        '# objective = "rollout": the plant\'s FMU is simulated at each candidate.',
    ]


def _rates_of(plant: Component, states: list[str]) -> dict[str, str | None]:
    """Return each state's likely derivative by kinematics: the first other one in its unit per second, or None."""
    units = {state: unit for state in states if (unit := plant.unit(state)) is not None and unit.exponents is not None}
    first: dict[tuple[float, tuple[int, ...]], str] = {}
    for state, unit in units.items():
        first.setdefault((unit.factor, unit.exponents or ()), state)
    rates: dict[str, str | None] = dict.fromkeys(states)
    for state, unit in units.items():
        per_second = [n - (base == "s") for base, n in zip(BASE_UNITS, unit.exponents or (), strict=True)]
        rates[state] = first.get((unit.factor, tuple(per_second)))
    return rates


def _dependencies(plant: Component) -> dict[str, bool]:
    """Return whether each output depends on inputs or parameters; True where its FMU does not declare it."""
    structure, enters = plant.description, {v.name for c in ("input", "parameter") for v in plant.having(c)}
    lists = [declared(plant, u) for u in (structure.outputs, structure.derivatives, structure.initialUnknowns)]
    found: dict[str, bool] = {}
    for v in plant.having("output"):
        known = [on for part in lists if (on := part[v.name]) is not None]
        found[v.name] = not known or any(enters & set(on) for on in known)
    return found


def estimation(plant: Component, model: str | None, arguments: list[str], loose: Container[str]) -> list[str]:
    """Return the lines for objective, trigger and budget.

    arguments: the names of the estimates; loose: inputs that are not connected, `plant.variable`.
    """
    if is_rolled_out(plant, model):
        return [
            "[estimation]",
            said('objective = "rollout"', "candidates are simulated: the plant's outputs hide its states"),
            'trigger = { kind = "innovation" }',
            said("budget = 30", "roll-outs an episode"),
            said(f"window = {_SAVED if _saves_its_state(plant) else _REPLAYED}", "samples: the length of a roll-out"),
            said("evaluations_per_step = 3", "roll-outs at the same time"),
        ]
    return [
        "[estimation]",
        *_model(plant, model, arguments, loose),
        said('trigger = { kind = "innovation" }', 'or { kind = "tracking", threshold = ... }: of the tracking error'),
        said("budget = 30", "evaluations an episode")
        if _has_rates(plant) or named_rates(plant)
        else said("budget = 100", "evaluations an episode, which shall see several of the filter's samples"),
        said("window = 10", "samples: more average more noise, fewer follow faster"),
    ]


def _model(plant: Component, model: str | None, arguments: list[str], loose: Container[str]) -> list[str]:
    """Return the line that names the model, after the signature of a function, with x and u in their order."""
    if model is not None and model.lower().endswith(".fmu"):
        return [f"model = {quoted(model)}"]
    states, inputs = model_states(plant), [v.name for v in plant.having("input")]
    until = [", until [changes] names it" if f"{PLANT}.{its}" in loose else "" for its in inputs]
    name = (model or "derivative").rpartition(":")[2].rpartition(".")[2]
    where = "the function" if model else "a function in a Python file beside this one, plant_model.py"
    return [
        f"# The plant's equations, {where}:",
        f"#   def {name}({', '.join(['x', 'u', *arguments])}):",
        *(f"#       # x[{i}]: {_labelled(plant, name)}" for i, name in enumerate(states)),
        *(f"#       # u[{i}]: {_labelled(plant, name)}{until[i]}" for i, name in enumerate(inputs)),
        f"#       return ({', '.join(f'der_{identifier(name)}' for name in states)},)",
        f"model = {quoted(model)}" if model else said('model = "plant_model:derivative"', "FILL"),
    ]


def _labelled(component: Component, name: str) -> str:
    return f"{one_line(name)} [{unit_name(component, name)}]"
