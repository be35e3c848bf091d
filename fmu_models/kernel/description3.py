"""FMI 3.0 model description made from a variable table. Standard library only."""

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element, SubElement

from .arrays import Array, arrays
from .description import TIME, Unknown, VariableRow, define_units, unknowns


def variables_of(table: Sequence[VariableRow]) -> list[Array]:
    """Return the FMI 3.0 variables of a table, time included (section 2.4.7.4); a position is a value reference."""
    complete = table if TIME in table else (*table, TIME)
    return arrays(complete)


def model_description(
    attributes: Mapping[str, str],
    interface: str,
    capabilities: Mapping[str, str],
    log_categories: Mapping[str, str],
    default_experiment: Mapping[str, str],
    table: Sequence[VariableRow],
    has_feedthrough: bool,
) -> Element:
    """Return the `fmiModelDescription` element of FMI 3.0; dictionaries hold XML attributes, in order.

    interface: "CoSimulation" or "ModelExchange", with its capabilities;  has_feedthrough: an unknown depends at once
    on the inputs among its dependencies. FMI 3.0.1, section 2.4.
    """
    root = Element("fmiModelDescription", {"fmiVersion": "3.0", **attributes})
    SubElement(root, interface, capabilities)
    variables = variables_of(table)
    define_units(root, {v.unit for array in variables for v in array.members if v.unit is not None})
    categories = SubElement(root, "LogCategories")
    for name, text in log_categories.items():
        SubElement(categories, "Category", name=name, description=text)
    SubElement(root, "DefaultExperiment", default_experiment)
    reference = {v.name: i for i, array in enumerate(variables) for v in array.members}
    model_variables = SubElement(root, "ModelVariables")
    for array in variables:
        model_variables.append(_variable(array, reference))
    structure = SubElement(root, "ModelStructure")
    merged: dict[tuple[str, int], dict[int, str]] = {}
    for unknown in unknowns(table, has_feedthrough):
        _merge(merged.setdefault((unknown.section, reference[unknown.name]), {}), unknown, reference)
    for (section, i), known in merged.items():
        depends, kinds = " ".join(map(str, sorted(known))), " ".join(known[k] for k in sorted(known))
        attributes = {"valueReference": str(i), "dependencies": depends, "dependenciesKind": kinds}
        SubElement(structure, section, attributes)
    return root


def _merge(known: dict[int, str], unknown: Unknown, reference: Mapping[str, int]) -> None:
    """Add the dependencies of one element to those of its array."""
    for name, kind in unknown.dependencies.items():
        known[reference[name]] = kind if known.get(reference[name], kind) == kind else "dependent"


def _variable(array: Array, reference: Mapping[str, int]) -> Element:
    v = array.members[0]
    attributes = {"name": array.name, "valueReference": str(reference[v.name]), "description": array.description}
    attributes |= {"causality": v.causality, "variability": v.variability}
    if v.initial is not None:
        attributes["initial"] = v.initial
    if v.start is not None:
        values = [str(m.start).lower() if v.type == "Boolean" else repr(float(m.start or 0.0)) for m in array.members]
        attributes["start"] = " ".join(values)
    if v.type == "Real":
        attributes["unit"] = str(v.unit)
        for name in ("min", "max", "nominal"):
            if (value := getattr(v, name)) is not None:
                attributes[name] = repr(float(value))
        if v.derivative is not None:
            attributes["derivative"] = str(reference[v.derivative])
    element = Element("Boolean" if v.type == "Boolean" else "Float64", attributes)
    for size in array.shape:
        SubElement(element, "Dimension", start=str(size))
    return element
