"""An FMU as an element of a system: its file, its variables and its units."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fmpy.model_description import ModelDescription
from fmpy.model_description import ModelVariable as ModelVariable

from .archive import read_description
from .table import describe, is_table, read_table
from .units import Unit, defined_units


@dataclass(frozen=True)
class Component:
    """An FMU in a system."""

    fmu: Path
    """Its file, or a table's."""
    description: ModelDescription
    """Its model description."""
    variables: Mapping[str, ModelVariable]
    """By name."""
    units: Mapping[str, Unit]
    """What the FMU says of its units."""

    def unit(self, variable: str) -> Unit | None:
        """Unit of a variable, where it has one."""
        v = self.variables[variable]
        name = v.unit or (v.declaredType.unit if v.declaredType is not None else None)
        return self.units.get(name, Unit(name)) if name else None


def read_component(fmu: Path) -> Component:
    """An FMU, or a table, as an element of a system. Raises ModelDescriptionError, ScenarioError for a bad table."""
    description = describe(fmu, read_table(fmu)) if is_table(fmu) else read_description(fmu)
    variables = {v.name: v for v in description.modelVariables}
    return Component(fmu, description, variables, defined_units(description.unitDefinitions))
