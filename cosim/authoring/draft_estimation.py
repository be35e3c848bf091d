"""Sampling and estimation in a draft scenario: see `draft`."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from ..errors import one_line
from ..fmi.archive import capabilities
from ..fmi.component import Component, ModelVariable
from ..fmi.feedthrough import declared
from ..fmi.ports import attribute
from ..fmi.types import is_real
from ..scenarios.formula import identifier
from ..units import BASE_UNITS
from .guess import CONTROLLER, PLANT, alike, best, echoes, have_one_unit, stem
from .toml_lines import quoted, said

_LIMITS: Final = {"lim", "limit", "max", "min", "sat", "saturation"}
_NOISE: Final = 1e-3  # of the nominal value
_GUESS: Final = "GUESS of the noise: a run measures it"
_SAVED: Final = 20  # samples of a roll-out that begins in the plant's saved state
_REPLAYED: Final = 100  # of one that begins where earlier, wrong parameters have led: its end must say enough
_RATES: Final = ("d{}", "d_{}", "der_{}", "der{}", "d{}_dt", "d{}dt", "{}_dot", "{}dot", "{}_der")
_WIDE: Final = 10.0  # a guessed bound is this many times the start value


def parameter_pairs(components: Mapping[str, Component]) -> list[tuple[ModelVariable, ModelVariable]]:
    """Return the controller's tunable parameters, each with the plant's parameter that it stands for."""
    if CONTROLLER not in components:
        return []
    plant, controller = components[PLANT], components[CONTROLLER]
    there = [(plant, v) for v in plant.having("parameter") if _is_real(v)]
    own = [v for v in controller.having("parameter", "tunable") if _is_real(v) and not is_gravity(controller, v)]
    by_name = {v.name: its for v in own if (its := best(v.name, controller, there)) is not None}
    taken = {its.name for its in by_name.values()}
    left = [v for v in own if v.name not in by_name], [v for _, v in there if v.name not in taken]
    pairs = by_name | _of_one_value(controller, plant, *left)
    return [(v, pairs[v.name]) for v in own if v.name in pairs]


def _of_one_value(
    controller: Component, plant: Component, own: Iterable[ModelVariable], there: Iterable[ModelVariable]
) -> dict[str, ModelVariable]:
    """Return plant parameters that start at the value of one of the controller's, and share a word of its name.

    Limits are none: an actuator's are in both as well, and do not change.
    """

    def belong(v: ModelVariable, other: ModelVariable) -> bool:
        words, others = set(stem(v.name)), set(stem(other.name))
        if v.start is None or other.start is None or not words & others or (words | others) & _LIMITS:
            return False
        is_one_value = float(v.start) == float(other.start) != 0.0
        return is_one_value and have_one_unit(controller, v.name, plant, other.name) is not False

    found = {v.name: [other for other in there if belong(v, other)] for v in own}
    claims = Counter(other.name for others in found.values() for other in others)
    return {name: others[0] for name, others in found.items() if len(others) == 1 == claims[others[0].name]}


def _is_real(v: ModelVariable) -> bool:
    return is_real(v.type)


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
        nominal = float(attribute(plant.variables[rate], "nominal") or 1.0)
        text = f"{quoted(f'{PLANT}.{rate}')} = {{ noise = {_NOISE * abs(nominal):g} }}"
        is_used = rate in telling or not telling
        note = f"[{unit_name(plant, rate)}] " + (_GUESS if is_used else "depends on states only")
        lines.append(said(text if is_used else f"# {text}", note))
    return lines if rates else _filtered(plant)


def named_rates(plant: Component) -> dict[str, str]:
    """Return the outputs named as another's derivative, by that one; none where derivatives are declared."""
    if plant.derivatives:
        return {}
    outputs = {v.name for v in plant.having("output") if _is_real(v)}
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
        text = f"{quoted(f'{PLANT}.{rate}')} = {{ noise = {_NOISE:g}, of = {quoted(f'{PLANT}.{state}')} }}"
        lines.append(said(text, f"[{unit_name(plant, rate)}] GUESS by its name, and {_GUESS}"))
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
        nominal = float(attribute(v, "nominal") or 1.0)
        text = f"{quoted(f'{PLANT}.{v.name}')} = {{ noise = {_NOISE * abs(nominal):g} }}"
        if _is_real(v) and v.name not in echoed:
            lines.append(said(text, f"[{unit_name(plant, v.name)}] {_GUESS}"))
    return lines


def model_states(plant: Component) -> list[str]:
    """Return the states x of the model: the declared ones; if no derivative is an output, measured or likely ones."""
    echoed = echoes(plant)
    outputs = [v.name for v in plant.having("output") if _is_real(v) and v.name not in echoed]
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
        nominal = float(attribute(plant.variables[state], "nominal") or 1.0)
        text = f"{quoted(f'{PLANT}.{state}')} = {{ noise = {_NOISE * abs(nominal):g} }}"
        note = _GUESS if is_declared else "GUESS of the noise, and that it is a state"
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


def estimation(
    plant: Component,
    model: str | None,
    pairs: list[tuple[ModelVariable, ModelVariable]],
    gained: ModelVariable | None,
) -> list[str]:
    """Return the lines for objective, trigger and budget; gained: the parameter that gains depend on."""
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
        *_model(plant, model, [own.name for own, _ in pairs] if gained is None else [last_name(gained)]),
        said('trigger = { kind = "innovation" }', 'or { kind = "tracking", threshold = ... }: of the tracking error'),
        said("budget = 30", "evaluations an episode")
        if _has_rates(plant) or named_rates(plant)
        else said("budget = 100", "evaluations an episode, which shall see several of the filter's samples"),
        said("window = 10", "samples: more average more noise, fewer follow faster"),
    ]


def _model(plant: Component, model: str | None, parameters: list[str]) -> list[str]:
    if model is not None:
        return [f"model = {quoted(model)}"]
    states, inputs = model_states(plant), [v.name for v in plant.having("input")]
    arguments = ", ".join(["x", "u", *map(identifier, parameters)])
    return [
        "# The plant's equations, a function in a Python file beside this one, plant_model.py:",
        f"#   def derivative({arguments}):",
        *(f"#       # x[{i}]: {_labelled(plant, name)}" for i, name in enumerate(states)),
        *(f"#       # u[{i}]: {_labelled(plant, name)}" for i, name in enumerate(inputs)),
        f"#       return ({', '.join(f'der_{identifier(name)}' for name in states)},)",
        said('model = "plant_model:derivative"', "FILL"),
    ]


def _labelled(component: Component, name: str) -> str:
    return f"{one_line(name)} [{unit_name(component, name)}]"


def parameters(
    components: Mapping[str, Component], pairs: list[tuple[ModelVariable, ModelVariable]], is_fmu: bool
) -> Iterator[list[str]]:
    """Yield a table for each parameter shared by plant and controller, and comments on the controller's other ones.

    is_fmu: whether the model is an FMU, whose parameters have the plant's names.
    """
    controller = components.get(CONTROLLER)
    if controller is not None:
        yield from (_parameter(controller, own, its, is_fmu) for own, its in pairs)
    if not pairs:
        yield [
            "[[estimation.parameters]]",
            said('name = "FILL"', "FILL the model's argument"),
            said("lower = 0.1", "FILL"),
            said("upper = 10.0", "FILL"),
            said('unit = "1"', "FILL"),
            said('writes = "controller.FILL"', "FILL a tunable parameter of the controller"),
        ]
    shared = {v.name for v, _ in pairs}
    others = [v.name for v in controller.having("parameter", "tunable")] if controller else []
    if names := ", ".join(one_line(name) for name in others if name not in shared):
        about = "# Formulas can give those that follow from estimated ones: docs/scenario.md, Controllers with gains."
        yield [f"# Tunable in the controller too, but not estimated: {names}", about]


def _parameter(controller: Component, own: ModelVariable, its: ModelVariable, is_fmu: bool) -> list[str]:
    low, high, notes = bounds(own, its)
    unit = attribute(own, "unit") or attribute(its, "unit")
    name = its.name if is_fmu else identifier(own.name)
    lines = [
        said("[[estimation.parameters]]", f"[{unit or '1'}] {one_line(own.description or '')}".rstrip()),
        f"name = {quoted(name)}",
        said(f"lower = {low!r}", notes[0]),
        said(f"upper = {high!r}", notes[1]),
        *unit_and_scale(unit, low, high),
        f"writes = {quoted(f'{CONTROLLER}.{own.name}')}",
    ]
    if its.name != name:
        lines.append(
            said(
                f"true = {quoted(f'{PLANT}.{its.name}')}",
                f"GUESS: {alike(own.name, its.name) or 'a word of the name, and the start value'}",
            )
        )
    return lines


def is_gravity(component: Component, v: ModelVariable) -> bool:
    return v.start is not None and 9.7 < abs(float(v.start)) < 9.9 and unit_name(component, v.name) in ("m/s2", "m/s^2")


def bounds(own: ModelVariable, its: ModelVariable) -> tuple[float, float, tuple[str, str]]:
    """Return lower and upper bound, each with its source: the limits of both FMUs, or a guess from the start value."""
    lows = [float(x) for v in (own, its) if (x := attribute(v, "min")) is not None and math.isfinite(float(x))]
    highs = [float(x) for v in (own, its) if (x := attribute(v, "max")) is not None and math.isfinite(float(x))]
    start = float(own.start or its.start or 0.0)
    wide = sorted(float(f"{x:.6g}") for x in (start / _WIDE, start * _WIDE)) if start else [-1.0, 1.0]
    low = max(lows) if lows else wide[0]
    high = min(highs) if highs else wide[1]
    if low >= high:  # a guess that a declared bound has overtaken
        low, high = (low, low + abs(low) + 1.0) if lows else (high - abs(high) - 1.0, high)
    notes = (
        "of the FMUs" if lows else "GUESS: none is declared",
        "of the FMUs" if highs else "GUESS: none is declared",
    )
    return low, high, notes


def unit_and_scale(unit: str | None, low: float, high: float) -> list[str]:
    """Return the lines for a parameter's unit and scale; low, high: its bounds."""
    return [
        f"unit = {quoted(unit or '1')}",
        f'scale = "{"log" if low > 0.0 and high >= 10.0 * low else "linear"}"',
    ]


def described(component: Component, v: ModelVariable) -> str:
    return f"[{unit_name(component, v.name)}] {one_line(v.description or '')}".rstrip()


def unit_name(component: Component, name: str) -> str:
    unit = component.unit(name)
    return unit.name if unit else "1"


def last_name(v: ModelVariable) -> str:
    """Return the last part of a structured name, as an argument of a function: `J` of `inertia.J`."""
    return identifier(re.split(r"\.(?![^\[(]*[\])])", v.name)[-1])
