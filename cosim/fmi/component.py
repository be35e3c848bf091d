"""An FMU as an element of a system: its file, its variables and its units."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from fmpy.model_description import ModelDescription as ModelDescription
from fmpy.model_description import ModelVariable as ModelVariable

from ..errors import ModelDescriptionError
from ..units import Unit, defined_units
from .archive import component_interface, read_description
from .ports import Catalogue, is_numeric
from .preflight.description import is_true
from .table import describe, is_table, read_table

_EXPERIMENT = {"startTime": "start_time", "stopTime": "stop_time", "stepSize": "step_size", "tolerance": "tolerance"}


@dataclass(frozen=True)
class Component:
    """An FMU in a system."""

    fmu: Path
    """Its file, or a table's."""
    description: ModelDescription
    """Its model description."""
    variables: Mapping[str, ModelVariable]
    """Its variables by name."""
    units: Mapping[str, Unit]
    """Its units by name."""

    def having(self, causality: str, variability: str | None = None) -> list[ModelVariable]:
        """Return the numeric variables of a causality and, where given, a variability."""
        return [
            v
            for v in self.variables.values()
            if v.causality == causality and variability in (None, v.variability) and is_numeric(v)
        ]

    @cached_property
    def derivatives(self) -> dict[str, str]:
        """Declared derivative of each continuous state, by the state's name, in the order of the states."""
        rates = {v.derivative.name: v.name for v in self.variables.values() if v.derivative is not None}
        return {name: rates[name] for name in self.variables if name in rates}

    @property
    def experiment(self) -> dict[str, float]:
        """Default experiment: start_time, stop_time, step_size [s] and tolerance, as far as they are declared."""
        found = {name: getattr(self.description.defaultExperiment, key, None) for key, name in _EXPERIMENT.items()}
        return {name: float(value) for name, value in found.items() if value is not None}

    @cached_property
    def catalogue(self) -> Catalogue:
        """Its variables as they can be set and got."""
        return Catalogue(self.fmu.name, self.variables.values())

    @cached_property
    def outputs(self) -> Mapping[str, ModelVariable]:
        """Its numeric outputs by name: see outputs_of."""
        return {v.name: v for v in outputs_of(self.description)}

    def unit(self, variable: str) -> Unit | None:
        """Return the unit of a variable, where it has one."""
        v = self.variables[variable]
        name = v.unit or (v.declaredType.unit if v.declaredType is not None else None)
        if not name:
            return None
        unit = self.units.get(name, Unit(name))
        return replace(unit, is_relative=True) if unit.offset and _is_relative(v) else unit


def _is_relative(v: ModelVariable) -> bool:
    """Return whether a variable is a difference, of temperatures say: FMI 2.0.4, section 2.2.3."""
    own = v.relativeQuantity
    return is_true(own if own is not None or v.declaredType is None else v.declaredType.relativeQuantity)


def items_of(v: ModelVariable) -> dict[str, int] | None:
    """Return the items of an enumeration, by name; None for another type. That of FMI 3.0 is exchanged as an Int64."""
    if v.type != "Enumeration" and (v.declaredType is None or v.declaredType.type != "Enumeration"):
        return None
    items = v.declaredType.items if v.declaredType is not None else []
    return {str(item.name): int(item.value or 0) for item in items}


def outputs_of(description: ModelDescription) -> tuple[ModelVariable, ...]:
    """Return the numeric variables that are read at communication points: the outputs.

    Of a component that is integrated from its equations also the derivatives of those, which it declares for a solver.
    """
    is_exchanged = component_interface(description) == "model-exchange"

    def is_read(v: ModelVariable) -> bool:
        is_rate = is_exchanged and v.derivative is not None and v.derivative.causality == "output"
        return (v.causality == "output" or is_rate) and is_numeric(v)

    return tuple(v for v in description.modelVariables if is_read(v))


def is_disturbance(v: ModelVariable) -> bool:
    """Return whether an input acts only where somebody connects or changes it, by its description."""
    return "disturbance" in (v.description or "").lower()


def read_component(fmu: Path) -> Component:
    """Read an FMU, or a table, as an element of a system. Raises ModelDescriptionError, ScenarioError for a table."""
    return component_of(fmu, describe(fmu, read_table(fmu)) if is_table(fmu) else read_description(fmu))


def component_of(fmu: Path, description: ModelDescription) -> Component:
    """Return the component of an FMU whose description has been read. Raises ModelDescriptionError for a bad unit."""
    variables = {v.name: v for v in description.modelVariables}
    try:
        units = defined_units(description.unitDefinitions)
    except ValueError as e:
        raise ModelDescriptionError(f"{fmu}: {e}.") from e
    return Component(fmu, description, variables, units)
