"""Draft of a scenario from the declarations of its FMUs, for the author to review: guesses are marked.

In comments, `guess` marks what is likely, `GUESS` what needs checking, and `FILL` what has to be filled in.
"""

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ..errors import WiringError, one_line
from ..fmi.component import Component, ModelVariable, read_component
from ..fmi.table import is_table
from ..fmi.types import is_real
from ..scenarios.json_schema import URL
from ..variable_name import VariableName
from .draft_estimation import estimation, is_settable, model_states, sampling
from .draft_gains import gain_parameter, gains
from .draft_parameters import described, last_name, parameters, shared_parameters, unit_name
from .draft_times import rows, settings, span
from .guess import (
    CONTROLLER,
    PLANT,
    REFERENCE,
    SWAPPED,
    Guess,
    are_swapped,
    echoes,
    guess_connections,
    have_one_unit,
    sources,
)
from .guess_tracking import guess_tracking
from .set_points import size_of
from .toml_lines import key, quoted, said

MOST_PAIRS: Final = 1_000_000
"""Pairs of names that are compared, which takes some seconds."""
_FUNCTION: Final = re.compile(r"[\w.]+:[\w.]+")
_MOST_OFFERED: Final = 10  # outputs in a comment


@dataclass(frozen=True)
class Draft:
    """Text of a scenario file."""

    text: str

    def lines(self, mark: str) -> list[tuple[int, str]]:
        """Return number and text of the lines with a mark: 'FILL', 'GUESS' or 'guess'."""
        marked = re.compile(rf"#.*\b{mark}\b")
        numbered = enumerate(self.text.splitlines(), 1)
        return [(i, line) for i, line in numbered if i > len(_LEGEND) and marked.search(line)]


def draft(fmus: Mapping[str, Path], folder: Path, model: str | None = None) -> Draft:
    """Return a draft scenario in folder for the FMUs of a plant and, where given, a controller and a reference.

    model: `module:function` or the path of a model-exchange FMU; by default the plant, if it offers model exchange.
    Raises ModelDescriptionError, ScenarioError, WiringError.
    """
    played = next((path for name, path in fmus.items() if name != REFERENCE and is_table(path)), None)
    if played is not None:
        raise WiringError(f"{played} is a table: only the reference can be one.")
    components = {name: read_component(path) for name, path in fmus.items()}
    if not components[PLANT].having("output"):
        raise WiringError(f"{fmus[PLANT]} has no outputs: nothing of it can be tracked or measured.")
    _check_size(components)
    shared = shared_parameters(components)
    gained = None if shared else gain_parameter(components)
    tracked, guesses = guess_tracking(components), guess_connections(components)
    names = [one.name for one in shared] if gained is None else [last_name(gained)]
    model, is_fmu = _model(model, components[PLANT], folder)
    blocks = [
        _LEGEND,
        settings(components),
        _components(components, folder, guesses),
        _connections(components, guesses),
        _changes(components, [one.its for one in shared] if gained is None else [gained]),
        _tracking(components, tracked),
        *_limits(components, tracked),
        sampling(components[PLANT], model),
        estimation(components[PLANT], model, names, {g.target for g in guesses if g.source is None}),
        *(parameters(components, shared, is_fmu) if gained is None else gains(components, gained, is_fmu)),
    ]
    return Draft("\n\n".join("\n".join(block) for block in blocks) + "\n")


def _model(model: str | None, plant: Component, folder: Path) -> tuple[str | None, bool]:
    """Return the model as the scenario names it, the plant's own where it offers one, and whether it is an FMU."""
    if model is None and plant.description.modelExchange is not None:
        model = str(plant.fmu)
    is_fmu = model is not None and model.lower().endswith(".fmu")
    if model is None or (not is_fmu and _FUNCTION.fullmatch(model)):
        return model, False
    if not is_fmu or not Path(model).is_file():
        raise WiringError(f"{one_line(model)} is no model: it must be module:function, or an FMU's file.")
    return _relative(Path(model), folder), True


def _check_size(components: Mapping[str, Component]) -> None:
    """Raise WiringError where there are too many names to compare each with each."""

    def count(name: str, *role: str) -> int:
        return len(components[name].having(*role)) if name in components else 0

    pairs = {
        "inputs and outputs": count(CONTROLLER, "input") * (count(PLANT, "output") + count(REFERENCE, "output"))
        + count(PLANT, "input") * count(CONTROLLER, "output")
        + count(REFERENCE, "input") * count(PLANT, "output"),
        "outputs of plant and reference": count(PLANT, "output") * count(REFERENCE, "output"),
        "parameters of plant and controller": count(PLANT, "parameter") * count(CONTROLLER, "parameter", "tunable"),
    }
    for what, n in pairs.items():
        if n > MOST_PAIRS:
            raise WiringError(f"there are too many {what} to guess which belong together: {n} pairs.")


_LEGEND: Final = [
    f"#:schema {URL}",
    "# Written by `retune new` from what the FMUs declare. Look it over, then: retune check, retune run.",
    "# guess: name and unit agree.  GUESS: look at it.  FILL: yours to say.",
]


def _components(components: Mapping[str, Component], folder: Path, guesses: list[Guess]) -> list[str]:
    is_doubtful = are_swapped(components, [(g.target, g.source) for g in guesses if g.source is not None])
    lines = [said("[components]", f"GUESS: {SWAPPED}") if is_doubtful else "[components]"]
    for name in (PLANT, CONTROLLER, REFERENCE):
        if name not in components:
            file = 'table = "FILL.csv"' if name == REFERENCE else 'fmu = "FILL.fmu"'
            what = "set points over time" if name == REFERENCE else "the FMU that is re-tuned"
            lines.append(said(f"{name} = {{ {file} }}", f"FILL {what}"))
            continue
        component = components[name]
        path = quoted(_relative(component.fmu, folder))
        kind = "table" if is_table(component.fmu) else "fmu"
        starts = [component.variables[state] for state in model_states(component)] if name == PLANT else []
        given = [f"{key(v.name)} = {float(v.start or 0.0)!r}" for v in starts if is_settable(v)]
        start = f", start = {{ {', '.join(given)} }}" if given else ""
        lines.append(f"{name} = {{ {kind} = {path}{start} }}")
    return lines


def _connections(components: Mapping[str, Component], guesses: list[Guess]) -> list[str]:
    lines = ["[connections]           # input = output"]
    for guess in guesses:
        name, variable = VariableName(guess.target).parts
        unit = components[name].unit(variable)
        of = f" [{unit.name}]" if unit else ""
        if guess.source is None and guess.is_likely:
            lines.append(said(f'# {quoted(guess.target)} = ""', f"{guess.reason}{of}"))
        elif guess.beside is not None:
            note = f"GUESS{of}: a disturbance: {guess.reason}; it stays at its start, unless [changes] names it"
            lines.append(said(f'# {quoted(guess.target)} = ""', note))
        elif guess.source is None:
            left = _offered(guess.target, components)
            changed = ", unless [changes] names it" if name == PLANT else ""
            note = f"FILL{of}: {guess.reason}{left}; as it is it stays at its start{changed}"
            lines.append(said(f'# {quoted(guess.target)} = ""', note))
        else:
            mark = "guess" if guess.is_likely else "GUESS"
            lines.append(said(f"{quoted(guess.target)} = {quoted(guess.source)}", f"{mark}{of}: {guess.reason}"))
    return lines


def _offered(target: str, components: Mapping[str, Component]) -> str:
    """Return the outputs that an input may be connected to, where they are few."""
    given = [name for name in sources(*VariableName(target).parts) if name in components]
    other = next(iter(given), "")
    names = [v.name for v in components[other].having("output")] if other else []
    return f"; {other}'s outputs: {', '.join(map(one_line, names))}" if 0 < len(names) <= _MOST_OFFERED else ""


def _changes(components: Mapping[str, Component], parameters: list[ModelVariable]) -> list[str]:
    lines = [said("[changes]", "FILL what happens to the plant: rows [time, value], or a formula in t")]
    plant = components[PLANT]
    times = span(components)
    tunable = {v.name: v for v in plant.having("parameter", "tunable") if is_real(v.type)}
    others = [v for name, v in tunable.items() if name not in {v.name for v in parameters}]
    if len(others) > _MOST_OFFERED:
        others = []
    for v in [*parameters, *others]:
        if v.name in tunable and v.start is not None:
            start = float(v.start)
            other = 1.5 * start if start else 1.0
            text = f"# {quoted(f'{PLANT}.{v.name}')} = {rows(times, start, other)}"
            lines.append(said(text, described(plant, v)))
        elif v.name not in tunable:
            lines.append(f"# {PLANT}.{one_line(v.name)} is fixed in {plant.fmu.name}: it cannot change in a run")
    return lines


def _tracking(components: Mapping[str, Component], found: list[Guess]) -> list[str]:
    lines = ["[tracking]              # tracked output = its reference"]
    plant = components[PLANT]
    for guess in found:
        name, variable = VariableName(guess.target).variable, quoted(guess.target)
        is_one = _is_tracked(plant, guess, found)
        text = f"{variable} = {quoted(str(guess.source))}"
        mark = "guess" if guess.is_likely else "GUESS"
        note = f"{mark}: {guess.reason}" if is_one else "possible too, in another unit"
        lines.append(said(text if is_one else f"# {text}", f"[{unit_name(plant, name)}] {note}"))
    if not found:
        echoed = echoes(plant)
        offered = ", ".join(one_line(v.name) for v in plant.having("output") if v.name not in echoed)
        given = components[REFERENCE].having("output") if REFERENCE in components else []
        source = quoted(f"{REFERENCE}.{given[0].name if len(given) == 1 else 'FILL'}")
        its = f"; the reference's {', '.join(one_line(v.name) for v in given)}" if len(given) > 1 else ""
        lines.append(said(f'"plant.FILL" = {source}', f"FILL; the plant's outputs are {offered}{its}"))
    return lines


def _is_tracked(plant: Component, guess: Guess, found: list[Guess]) -> bool:
    """Return whether an output is tracked: it is the first that was found, or in its unit."""
    first, name = (VariableName(g.target).variable for g in (found[0], guess))
    return have_one_unit(plant, name, plant, first) is not False


def _limits(components: Mapping[str, Component], found: list[Guess]) -> Iterator[list[str]]:
    """Yield the limit of the tracking error, where a table says how large the set points are, and it is a number."""
    given = [guess.source for guess in found if guess.source and _is_tracked(components[PLANT], guess, found)]
    tracked = [VariableName(source).variable for source in given]
    size = max((size for name in tracked if (size := size_of(components[REFERENCE], name))), default=math.inf)
    divergence = f"{10 * size:.3g}"
    if math.isfinite(float(divergence)):
        about = "GUESS: ten times the set points; a hundredth of it is guard.tolerance"
        yield [
            "[limits]                # the tracking error at which the run ends",
            said(f"divergence = {divergence}", about),
        ]


def _relative(path: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        return path.resolve().as_posix()
