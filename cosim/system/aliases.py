"""Translation of a scenario's names to those in its FMUs, so that one scenario fits FMUs of FMI 2.0 and 3.0.

Where an FMU has R[1,2] and no R_12, R_12 is R[1,2], and the other way round; "controller.R" = "plant.R" connects two
arrays element by element.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import WiringError
from ..fmi.elements import element_names, indices_of, resolved
from ..scenarios.scenario import Scenario
from ..scenarios.schema.estimation import EstimatedParameter
from ..variable_name import VariableName
from .plant import Described


def as_the_fmus_have_it(scenario: Scenario, slaves: Mapping[str, Described]) -> Scenario:
    """Return the scenario with every reference to a variable in its FMU's own spelling. Raises WiringError.

    A name that no FMU has stays as it is, and is reported where it is looked up.
    """
    known = {name: {v.name: v for v in slave.description.modelVariables} for name, slave in slaves.items()}

    def own(reference: VariableName) -> VariableName:
        component, name = reference.parts
        return VariableName(f"{component}.{resolved(name, known[component])}")

    def writes(p: EstimatedParameter) -> VariableName | dict[VariableName, str]:
        return own(p.writes) if isinstance(p.writes, VariableName) else {own(k): v for k, v in p.written.items()}

    estimation = scenario.estimation
    parameters = tuple(
        p.model_copy(update={"writes": writes(p)} | ({} if own(true) == true else {"true": own(true)}))
        for p, true in ((p, scenario.true_reference(p)) for p in estimation.parameters)
    )
    changed: dict[str, Any] = {
        "components": {
            name: c.model_copy(update={"start": {resolved(k, known[name]): value for k, value in c.start.items()}})
            for name, c in scenario.components.items()
        },
        "connections": _connections(scenario.connections, known),
        "changes": {own(k): value for k, value in scenario.changes.items()},
        "tracking": {own(k): own(value) for k, value in scenario.tracking.items()},
        "sampling": scenario.sampling.model_copy(
            update={
                "derivatives": {
                    own(k): d.model_copy(update={"of": own(d.of)}) if d.of else d
                    for k, d in scenario.sampling.derivatives.items()
                },
                "outputs": {own(k): noise for k, noise in scenario.sampling.outputs.items()},
                "states": {own(k): noise for k, noise in scenario.sampling.states.items()},
            }
        ),
        "estimation": estimation.model_copy(update={"parameters": parameters}),
    }
    return scenario.model_copy(update=changed)


def _connections(
    connections: Mapping[VariableName, VariableName], known: Mapping[str, Mapping[str, object]]
) -> dict[VariableName, VariableName]:
    """Return the connections, input = output, arrays element by element. Raises WiringError."""
    result: dict[VariableName, VariableName] = {}
    for target, source in connections.items():
        targets, sources = (_parts(reference, known) for reference in (target, source))
        to, of = (_sizes(parts) for parts in (targets, sources))
        if to != of:
            raise WiringError(f"'{target}' has {_told(to)} and '{source}' {_told(of)}: they cannot be connected.")
        result |= zip(targets, sources, strict=True)
    return result


def _sizes(parts: Sequence[VariableName]) -> tuple[int, ...]:
    """Return the sizes of the array that has these elements, the last index fastest; none for a scalar."""
    return indices_of(parts[-1].parts[1]) if len(parts) > 1 else ()


def _told(sizes: Sequence[int]) -> str:
    return f"{' x '.join(map(str, sizes))} elements" if sizes else "1 element"


def _parts(reference: VariableName, known: Mapping[str, Mapping[str, object]]) -> list[VariableName]:
    """Return the elements of an array, or a scalar under its FMU's own name."""
    component, name = reference.parts
    names = known[component]
    found = resolved(name, names)
    if found in names:
        return [VariableName(f"{component}.{found}")]
    first = (element_names(name, (1,) * n)[0] for n in (1, 2, 3))
    stem = next((f[: f.rindex("[") + 1] for f in first if f in names), None)
    if stem is None:
        return [reference]
    return [VariableName(f"{component}.{n}") for n in names if n.startswith(stem)]
