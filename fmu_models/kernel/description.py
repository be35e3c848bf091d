"""Variable tables, and the FMI 2.0 model description made from one. Standard library only."""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple
from xml.etree.ElementTree import Element, SubElement

Type = Literal["Real", "Integer", "Boolean"]
Causality = Literal["parameter", "input", "output", "local", "independent"]
Variability = Literal["fixed", "tunable", "discrete", "continuous"]
Initial = Literal["exact", "calculated"]


@dataclass(frozen=True, kw_only=True)
class VariableRow:
    """Row of a variable table: an FMI scalar variable."""

    name: str
    """FMI name, structured naming convention."""
    unit: str | None
    """Unit such as "kg.m2" or "rad/s", "1" if dimensionless; None where it is unknown, or the type has none."""
    description: str
    """One line for the user."""
    causality: Causality
    """Role of the variable for the importer."""
    variability: Variability
    """Times at which its value may change."""
    type: Type = "Real"
    """FMI type."""
    initial: Initial | None = None
    """Origin of its initial value; None for inputs and time, where FMI allows no such attribute."""
    start: float | bool | None = None
    """Start value [unit]; None exactly for time and where `initial` is "calculated"."""
    min: float | None = None
    """Smallest allowed value [unit]."""
    max: float | None = None
    """Largest allowed value [unit]."""
    nominal: float | None = None
    """Typical size [unit]."""
    derivative: str | None = None
    """Name of the state whose time derivative this is."""
    dependencies: tuple[str, ...] = ()
    """Names of all that a calculated value, or a state's derivative, depends on."""
    is_latched: bool = False
    """True where an input takes effect at the next step only: no output depends on it directly."""
    is_disturbance: bool = False
    """True where an input acts on a plant by itself, not through an actuator."""

    def __post_init__(self) -> None:
        lower = float("-inf") if self.min is None else self.min
        upper = float("inf") if self.max is None else self.max
        if (self.start is None) != (self.initial == "calculated" or self.causality == "independent"):
            raise ValueError(f"Variable {self.name!r} must have a start or be calculated, got start={self.start}.")
        if not lower <= (lower if self.start is None else self.start) <= upper:
            raise ValueError(
                f"Variable {self.name!r} must have min <= start <= max, got {lower}, {self.start}, {upper}."
            )
        if (self.type == "Boolean") != isinstance(self.start, bool) and self.start is not None:
            raise ValueError(f"Variable {self.name!r} must start as its type, {self.type}, got {self.start!r}.")
        if self.unit is not None:
            base_unit(self.unit)


def parameter(
    name: str, unit: str | None, start: float | bool, description: str, *,
    variability: Literal["fixed", "tunable"] = "tunable", type: Literal["Real", "Integer"] = "Real",
    min: float | None = None, max: float | None = None, nominal: float | None = None,
) -> VariableRow:  # fmt: skip
    """Return the row of a parameter, Boolean where its start is one; tunable by default."""
    return VariableRow(
        name=name, unit=unit, description=description, causality="parameter", variability=variability,
        type="Boolean" if isinstance(start, bool) else type,
        initial="exact", start=start, min=min, max=max, nominal=nominal,
    )  # fmt: skip


def input_variable(
    name: str, unit: str | None, start: float | bool, description: str, *, nominal: float | None = None,
    min: float | None = None, max: float | None = None, is_latched: bool = False,
) -> VariableRow:  # fmt: skip
    """Return the row of a continuous input, or of a Boolean one where its start is one."""
    is_boolean = isinstance(start, bool)
    return VariableRow(
        name=name, unit=unit, description=description, causality="input",
        variability="discrete" if is_boolean else "continuous", type="Boolean" if is_boolean else "Real",
        start=start, min=min, max=max, nominal=nominal, is_latched=is_latched,
    )  # fmt: skip


def disturbance(name: str, unit: str, description: str) -> VariableRow:
    """Return the row of an input that acts on a plant past its actuators, zero unless it is connected."""
    return VariableRow(
        name=name, unit=unit, description=description, causality="input", variability="continuous",
        start=0.0, is_disturbance=True,
    )  # fmt: skip


def state(
    name: str, unit: str, start: float, description: str, *, depends: Iterable[str], nominal: float | None = None
) -> VariableRow:
    """Return the row of a state, an output with a start; its time *derivative* depends on `depends`."""
    return VariableRow(
        name=name, unit=unit, description=description, causality="output", variability="continuous",
        initial="exact", start=start, nominal=nominal, dependencies=tuple(depends),
    )  # fmt: skip


def output(
    name: str, unit: str | None, description: str, *, depends: Iterable[str], nominal: float | None = None,
    derivative: str | None = None, variability: Literal["discrete", "continuous"] = "continuous", type: Type = "Real",
) -> VariableRow:  # fmt: skip
    """Return the row of a calculated output, which depends on `depends`; discrete where it is no Real."""
    return VariableRow(
        name=name, unit=unit, description=description, causality="output",
        variability=variability if type == "Real" else "discrete", type=type,
        initial="calculated", nominal=nominal, derivative=derivative, dependencies=tuple(depends),
    )  # fmt: skip


_BASE_UNITS: Mapping[str, Mapping[str, int]] = {
    "1": {}, "kg": {"kg": 1}, "m": {"m": 1}, "s": {"s": 1}, "A": {"A": 1}, "K": {"K": 1}, "mol": {"mol": 1},
    "cd": {"cd": 1}, "rad": {"rad": 1}, "N": {"kg": 1, "m": 1, "s": -2}, "Pa": {"kg": 1, "m": -1, "s": -2},
    "J": {"kg": 1, "m": 2, "s": -2}, "W": {"kg": 1, "m": 2, "s": -3}, "C": {"A": 1, "s": 1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1}, "F": {"kg": -1, "m": -2, "s": 4, "A": 2},
    "Ohm": {"kg": 1, "m": 2, "s": -3, "A": -2}, "H": {"kg": 1, "m": 2, "s": -2, "A": -2},
    "T": {"kg": 1, "s": -2, "A": -1}, "Wb": {"kg": 1, "m": 2, "s": -2, "A": -1},
}  # fmt: skip
_IN_ORDER = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")  # of FMI's attributes


def base_unit(unit: str) -> dict[str, int]:
    """Return the exponents of the SI base units in an FMI unit string: "N.m/rad" -> kg 1, m 2, s -2, rad -1.

    Factors are joined with dots; everything after the only slash divides. Raises ValueError for other text, and for
    units that are no product of the base units, such as km, h or degC.
    """
    exponents: Counter[str] = Counter()
    numerator, slash, denominator = unit.partition("/")
    for sign, factors in ((1, numerator), (-1, denominator if slash else "1")):
        for factor in factors.split("."):
            match = re.fullmatch(r"(1|[A-Za-z]+)(\d*)", factor)
            if match is None or match[1] not in _BASE_UNITS:
                raise ValueError(f"unit {unit!r} must be made of {', '.join(_BASE_UNITS)}, got {factor!r}.")
            for base, exponent in _BASE_UNITS[match[1]].items():
                exponents[base] += sign * exponent * int(match[2] or 1)
    return {base: exponents[base] for base in _IN_ORDER if exponents[base]}


TIME = VariableRow(
    name="time", unit="s", description="Simulation time", causality="independent", variability="continuous"
)
"""Independent variable, for tables in which another depends on it."""


def per_second(unit: str) -> str:
    """Return the unit of a time derivative: "m" -> "m/s" -> "m/s2"."""
    stem, slash, power = unit.partition("/s")
    return f"{stem}/s{int(power or 1) + 1}" if slash else f"{unit}/s"


class Unknown(NamedTuple):
    """Row of a model structure."""

    section: Literal["Output", "ContinuousStateDerivative", "InitialUnknown"]
    """List of the model structure that it belongs to."""
    name: str
    """Name of the variable."""
    dependencies: Mapping[str, str]
    """Kind of the dependency on each known variable, by its name."""


def unknowns(variables: Sequence[VariableRow], has_feedthrough: bool) -> list[Unknown]:
    """Return the model structure: calculated variables, their dependencies. `has_feedthrough` as below."""
    states = {v.derivative for v in variables if v.derivative is not None}
    inputs = {v.name for v in variables if v.causality == "input" and not v.is_latched}
    at_once = states | {TIME.name} | (inputs if has_feedthrough else set())
    initially = {v.name for v in variables}

    def depends(v: VariableRow, known: set[str]) -> dict[str, str]:
        if v.name in states:  # its own dependencies are those of its derivative
            return {v.name: "constant"}
        return {name: "dependent" for name in v.dependencies if name in known}

    return [
        *(Unknown("Output", v.name, depends(v, at_once)) for v in variables if v.causality == "output"),
        *(Unknown("ContinuousStateDerivative", v.name, depends(v, at_once)) for v in variables if v.derivative),
        *(Unknown("InitialUnknown", v.name, depends(v, initially)) for v in variables if v.initial == "calculated"),
    ]


def model_description(
    attributes: Mapping[str, str],
    capabilities: Mapping[str, str],
    log_categories: Mapping[str, str],
    default_experiment: Mapping[str, str],
    variables: Sequence[VariableRow],
    has_feedthrough: bool,
) -> Element:
    """Return the `fmiModelDescription` of a co-simulation FMU; positions in `variables` are the value references.

    `has_feedthrough`: an output depends directly on the inputs among its dependencies that are not latched. Otherwise
    the model holds its inputs over a step, and only the initial values depend on them. FMI 2.0.4, sections 2.2.8 and
    4.3.
    """
    root = Element("fmiModelDescription", {"fmiVersion": "2.0", **attributes})
    SubElement(root, "CoSimulation", capabilities)
    define_units(root, {v.unit for v in variables if v.unit is not None})
    categories = SubElement(root, "LogCategories")
    for name, text in log_categories.items():
        SubElement(categories, "Category", name=name, description=text)
    SubElement(root, "DefaultExperiment", default_experiment)
    index = {v.name: i for i, v in enumerate(variables, 1)}
    table = SubElement(root, "ModelVariables")
    for v in variables:
        table.append(_scalar_variable(v, index))
    root.append(_model_structure(variables, index, has_feedthrough))
    return root


def define_units(root: Element, units: Collection[str]) -> None:
    """Define units, of which there must be one where the element is: FMI 2.0.4, section 2.2.2."""
    table = SubElement(root, "UnitDefinitions") if units else root
    for unit in sorted(units):
        exponents = {base: str(exponent) for base, exponent in base_unit(unit).items()}
        SubElement(SubElement(table, "Unit", name=unit), "BaseUnit", exponents)


def _scalar_variable(v: VariableRow, index: Mapping[str, int]) -> Element:
    attributes = {"name": v.name, "valueReference": str(index[v.name] - 1), "description": v.description}
    attributes |= {"causality": v.causality, "variability": v.variability}
    if v.initial is not None:
        attributes["initial"] = v.initial
    element = Element("ScalarVariable", attributes)
    read = {
        "Real": lambda x: repr(float(x)),
        "Integer": lambda x: str(int(x)),
        "Boolean": lambda x: str(bool(x)).lower(),
    }
    typed = {"unit": v.unit} if v.unit is not None else {}
    for name in ("min", "max", "nominal", "start"):
        if (value := getattr(v, name)) is not None:
            typed[name] = read[v.type](value)
    if v.derivative is not None:
        typed["derivative"] = str(index[v.derivative])
    SubElement(element, v.type, typed)
    return element


def _model_structure(variables: Sequence[VariableRow], index: Mapping[str, int], has_feedthrough: bool) -> Element:
    structure = Element("ModelStructure")
    sections = {"Output": "Outputs", "ContinuousStateDerivative": "Derivatives", "InitialUnknown": "InitialUnknowns"}
    for unknown in unknowns(variables, has_feedthrough):
        section = sections[unknown.section]
        parent = structure.find(section)
        parent = SubElement(structure, section) if parent is None else parent
        known = sorted((index[name], kind) for name, kind in unknown.dependencies.items())
        depends, kinds = " ".join(str(i) for i, _ in known), " ".join(kind for _, kind in known)
        attributes = {"index": str(index[unknown.name]), "dependencies": depends, "dependenciesKind": kinds}
        SubElement(parent, "Unknown", attributes)
    return structure
