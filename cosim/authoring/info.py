"""Contents of an FMU of any version and kind, from its model description; none of its code is executed."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import one_line
from ..fmi.archive import look_into
from ..fmi.component import Component, ModelVariable, component_of
from ..fmi.feedthrough import declared
from ..fmi.ports import attribute, kind_of
from ..fmi.types import TYPES, Value
from ..text_table import aligned

_CAPABILITIES = {
    "canHandleVariableCommunicationStepSize": "variable communication step",
    "canGetAndSetFMUstate": "state saved and restored",
    "canSerializeFMUstate": "state as bytes",
    "providesDirectionalDerivative": "directional derivatives",
    "providesAdjointDerivatives": "adjoint derivatives",
    "canInterpolateInputs": "inputs interpolated",
    "hasEventMode": "event mode",
    "needsExecutionTool": "needs its tool",
    "canBeInstantiatedOnlyOncePerProcess": "once a process",
}


@dataclass(frozen=True)
class VariableInfo:
    """A variable, as text and numbers from its model description."""

    name: str
    role: str
    """'tunable parameter', 'fixed parameter', 'input', 'output', 'local variable', ..."""
    type: str
    start: Value | None
    min: Value | None
    max: Value | None
    unit: str | None
    derivative_of: str | None
    """Continuous state that it is the time derivative of."""
    derivative: str | None
    """Variable that is its time derivative, if it is a continuous state."""
    depends_on: tuple[str, ...] | None
    """Declared dependencies, if it is an output."""
    description: str


@dataclass(frozen=True)
class Info:
    """Declarations of an FMU. As text, tables."""

    file: str
    fmi_version: str
    kinds: dict[str, list[str]]
    """Capabilities by kind: 'co-simulation', 'model exchange', 'scheduled execution'."""
    model: str
    description: str
    tool: str
    platforms: list[str]
    experiment: dict[str, float]
    """start_time, stop_time, step_size [s] and tolerance, as far as they are declared."""
    variables: tuple[VariableInfo, ...]
    """In the order of the model description."""

    def __str__(self) -> str:
        return "\n\n".join("\n".join(block) for block in _blocks(self))


def info(fmu: Path) -> Info:
    """Return the declarations of an FMU. Raises ModelDescriptionError."""
    description, platforms = look_into(fmu)
    component = component_of(fmu, description)
    interfaces: dict[str, object] = {
        "co-simulation": description.coSimulation,
        "model exchange": description.modelExchange,
        "scheduled execution": description.scheduledExecution,
    }
    on = declared(component)
    return Info(
        str(fmu),
        str(description.fmiVersion),
        {kind: _capabilities(interface) for kind, interface in interfaces.items() if interface is not None},
        one_line(description.modelName or ""),
        one_line(description.description or ""),
        one_line(description.generationTool or ""),
        platforms,
        component.experiment,
        tuple([_variable(component, v, on.get(v.name)) for v in component.variables.values()]),
    )


def _capabilities(interface: object) -> list[str]:
    found = [text for name, text in _CAPABILITIES.items() if getattr(interface, name, False) in (True, "true", "1")]
    return list(dict.fromkeys(found))


def _variable(component: Component, v: ModelVariable, on: Sequence[str] | None) -> VariableInfo:
    unit = component.unit(v.name)
    size = f"[{','.join(map(str, v.shape))}]" if v.shape else ""
    return VariableInfo(
        v.name,
        kind_of(v),
        f"{v.type}{size}",
        _value(v.start),
        _value(attribute(v, "min")),
        _value(attribute(v, "max")),
        unit.name if unit else None,
        v.derivative.name if v.derivative is not None else None,
        component.derivatives.get(v.name),
        None if on is None else tuple(on),
        one_line(v.description or ""),
    )


def _value(text: str | None) -> Value | None:
    """Return a number as such; any other start value, such as an array's or a String's, as text."""
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        return one_line(text)


def _blocks(info: Info) -> Iterator[list[str]]:
    kinds = " and ".join(info.kinds) or "no kind"
    yield [f"{info.file}: FMI {info.fmi_version} for {kinds}, made by {info.tool or 'a tool that it does not name'}"]
    facts = {"model": f"{info.model}{': ' + info.description if info.description else ''}"}
    facts |= {"experiment": _span(info.experiment), "platforms": ", ".join(info.platforms) or "none"}
    facts |= {kind: ", ".join(found) or "no optional capability" for kind, found in info.kinds.items()}
    yield [f"{name:19} {text}" for name, text in facts.items()]
    states = [v for v in info.variables if v.derivative is not None]
    shown = ("tunable parameter", "fixed parameter", "structural parameter", "input")
    for role in (*shown, "output"):
        found = [v for v in info.variables if v.role == role]
        if role in shown and found:
            yield _table(f"{role}s", found, {"start": "start", "min": "min", "max": "max", "unit": "unit"})
        elif found:
            yield _table("outputs", found, {"start": "start", "unit": "unit", "derivative of": "derivative_of"})
    if states:
        yield _table("states", states, {"start": "start", "unit": "unit", "derivative": "derivative"})
    others = [v.role for v in info.variables if v.role not in (*shown, "output")]
    counts = [f"{others.count(role)} of the kind '{role}'" for role in dict.fromkeys(others)]
    if counts:
        yield [f"and {', '.join(counts)}"]


def _span(experiment: Mapping[str, float]) -> str:
    forms = {
        "start_time": "from {:g} s",
        "stop_time": "to {:g} s",
        "step_size": "step {:g} s",
        "tolerance": "tolerance {:g}",
    }
    return (
        ", ".join(form.format(experiment[name]) for name, form in forms.items() if name in experiment) or "not declared"
    )


def _table(title: str, variables: Sequence[VariableInfo], columns: dict[str, str]) -> list[str]:
    """Return the rows with their descriptions at the end."""
    rows: list[list[str]] = [[title, *columns]]
    rows += [[_name(v), *(_short(getattr(v, name)) for name in columns.values())] for v in variables]
    lines = aligned(rows)
    width = max(map(len, lines))
    texts = ["", *(v.description for v in variables)]
    return [f"{line:{width}}  {text}".rstrip() for line, text in zip(lines, texts, strict=True)]


def _name(v: VariableInfo) -> str:
    is_double = v.type in TYPES and TYPES[v.type].is_double  # not of an array, whose size is said
    return v.name if is_double else f"{v.name} ({v.type})"


def _short(value: Value | None) -> str:
    """Return a number with few digits, other text as it is, a dash for nothing."""
    if isinstance(value, float):
        return f"{value:.6g}"
    text = "-" if value is None else str(value)
    return text if len(text) <= 40 else text[:37] + "..."
