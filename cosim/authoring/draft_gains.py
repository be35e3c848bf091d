"""Parameters in a draft scenario for a controller that has gains, and none of the plant's parameters: see `draft`."""

from collections.abc import Iterator, Mapping
from typing import Final

from ..errors import one_line
from ..fmi.component import Component, ModelVariable
from ..fmi.ports import attribute
from ..fmi.types import is_real
from ..scenarios.formula import identifier
from .draft_parameters import bounds, described, is_gravity, last_name, unit_and_scale, unit_name
from .guess import CONTROLLER, PLANT
from .toml_lines import quoted, said

_INERTIAS: Final = {"j", "m", "inertia", "mass"}
_INERTIA_UNITS: Final = {"kg", "kg.m2", "kg.m^2"}
_GAINS: Final = ("k", "gain")


def gain_parameter(components: Mapping[str, Component]) -> ModelVariable | None:
    """Return the plant's parameter that a controller's gains most likely follow from; None where there are none."""
    if CONTROLLER not in components or not _tunable(components[CONTROLLER]):
        return None
    plant = components[PLANT]
    likely = [v for v in _tunable(plant) if _is_inertia(plant, v)]
    return next(iter([*likely, *_tunable(plant)]), None)


def _tunable(component: Component) -> list[ModelVariable]:
    """Return the real tunable parameters that begin with a number other than zero."""
    found = [v for v in component.having("parameter", "tunable") if is_real(v.type) and not is_gravity(component, v)]
    return [v for v in found if v.start is not None and float(v.start)]


def _is_inertia(plant: Component, v: ModelVariable) -> bool:
    return last_name(v).lower() in _INERTIAS or unit_name(plant, v.name) in _INERTIA_UNITS


def gains(components: Mapping[str, Component], its: ModelVariable, is_fmu: bool) -> Iterator[list[str]]:
    """Yield the table of the plant's parameter, with formulas for the gains: in proportion, those that look like one.

    is_fmu: whether the model is an FMU, whose parameters have the plant's names.
    """
    plant, controller = components[PLANT], components[CONTROLLER]
    low, high, notes = bounds(its)
    start, name = float(its.start or 0.0), last_name(its)
    yield [
        "# The controller has none of the plant's parameters: formulas give what it has, in the estimates by name.",
        said("[[estimation.parameters]]", described(plant, its)),
        f"name = {quoted(its.name if is_fmu else name)}",
        said(f"lower = {low!r}", notes[0]),
        said(f"upper = {high!r}", notes[1]),
        *unit_and_scale(attribute(its, "unit"), low, high),
        said(f"start = {start!r}", "GUESS: what the controller's gains were made for"),
        f"true = {quoted(f'{PLANT}.{its.name}')}",
        *_formulas(controller, its, start, is_fmu),
    ]
    others = ", ".join(one_line(v.name) for v in _tunable(plant) if v.name != its.name)
    if others:
        yield [f"# The plant also has {others}: give each a table with start and without writes, and use it above."]


def _formulas(controller: Component, its: ModelVariable, start: float, is_fmu: bool) -> list[str]:
    own = _tunable(controller)
    chosen = [v for v in own if last_name(v).lower().startswith(_GAINS)] or own[:1]
    name = identifier(its.name) if is_fmu else last_name(its)
    lines = ["[estimation.parameters.writes]"]
    for v in own:
        target, at = quoted(f"{CONTROLLER}.{v.name}"), float(v.start or 0.0)
        about = described(controller, v)
        if v in chosen:
            lines.append(said(f'{target} = "{at!r} * {name} / {start!r}"', f"GUESS: in proportion; {about}"))
        else:
            lines.append(said(f'# {target} = "{at!r}"', f"GUESS: does not depend on {name}; {about}"))
    return lines
