"""Outputs of the plant that those of the reference are for, guessed as connections are: see `guess`."""

from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher

from ..fmi.component import Component, ModelVariable
from ..variable_name import VariableName
from .draft_estimation import named_rates
from .guess import (
    CONTROLLER,
    ORDER,
    PLANT,
    REFERENCE,
    Guess,
    alike,
    echoes,
    guess_connections,
    have_one_unit,
    is_desired,
    is_likely,
    stem,
)


def guess_tracking(components: Mapping[str, Component]) -> list[Guess]:
    """Return the plant's output that each output of the reference is for, by name and unit; none without a reference.

    Derivatives and echoes of inputs are left out, and what the plant itself takes of the reference, as the weather, but
    for set points; where no name fits, the only output in the unit is taken.
    """
    plant, found = components[PLANT], []
    others = {*plant.derivatives.values(), *named_rates(plant).values(), *echoes(plant)}
    outputs = [v for v in plant.having("output") if v.name not in others]
    connections = guess_connections(components)
    compared = _compared(components, connections)
    weather = {g.source for g in connections if VariableName(g.target).component == PLANT}
    for r in components[REFERENCE].having("output") if REFERENCE in components else ():
        if f"{REFERENCE}.{r.name}" in weather and not is_desired(r.name):
            continue
        guess = compared.get(r.name) or _tracked(components[REFERENCE], r, plant, outputs)
        found += [] if guess is None or guess.target in {g.target for g in found} else [guess]
    return found


def _compared(components: Mapping[str, Component], connections: Iterable[Guess]) -> dict[str, Guess]:
    """Return the plant's outputs that the controller takes as an output of the reference, T_meas as T_set, by that one.

    Outputs in two units are left out.
    """
    sources = {g.target: VariableName(g.source).parts for g in connections if g.source}
    own = [v.name for v in components[CONTROLLER].having("input")] if CONTROLLER in components else []
    found: dict[str, Guess] = {}
    for desired in filter(is_desired, own):
        for measured in own:
            if is_desired(measured) or stem(measured) != stem(desired):
                continue
            (a, source), (b, target) = (sources.get(f"{CONTROLLER}.{name}", ("", "")) for name in (desired, measured))
            if (a, b) == (REFERENCE, PLANT) and have_one_unit(
                components[a], source, components[b], target
            ) is not False:
                reason = f"the controller compares them, as {desired} and {measured}"
                found[source] = Guess(f"{b}.{target}", f"{a}.{source}", reason, False)
    return found


def _tracked(owner: Component, r: ModelVariable, plant: Component, outputs: list[ModelVariable]) -> Guess | None:
    """Return the guess of the output that a reference is for, or None."""
    source = f"{REFERENCE}.{r.name}"
    ranked: list[tuple[int, float, str, bool]] = []
    for o in outputs:
        how, unit = alike(r.name, o.name), have_one_unit(owner, r.name, plant, o.name)
        if how is None or unit is False:
            continue
        ratio = SequenceMatcher(None, r.name, o.name).ratio()
        ranked.append((ORDER.index(how), -ratio, o.name, is_likely(how, unit)))
    if ranked:
        order, _, name, likely = min(ranked)
        return Guess(f"{PLANT}.{name}", source, ORDER[order], likely)
    units = {o.name: have_one_unit(owner, r.name, plant, o.name) for o in outputs}
    same = [name for name, is_same in units.items() if is_same]
    if len(same) == 1:
        return Guess(f"{PLANT}.{same[0]}", source, "the only output in this unit, by another name", False)
    if not same and list(units.values()) == [None]:
        return Guess(f"{PLANT}.{outputs[0].name}", source, "the only output, no unit to compare", False)
    return None
