"""libcosim with FMUs joined by an OspSystemStructure, no more: `python libcosim_master.py FOLDER < PLAN > ROWS`.

All step at once with what the others' outputs were before: its default, the fixed-step algorithm.
"""

import json
import os
import sys
from pathlib import Path
from xml.etree.ElementTree import Element, ElementTree, SubElement

import fmpy
from libcosimpy.CosimEnums import CosimExecutionState
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver


def system_structure(plan: dict, types: dict) -> ElementTree:
    """FMUs, start values and connections."""
    root = Element(
        "OspSystemStructure", {"xmlns": "http://opensimulationplatform.com/MSMI/OSPSystemStructure", "version": "0.1"}
    )
    SubElement(root, "BaseStepSize").text = repr(plan["macro_step"])
    SubElement(root, "Algorithm").text = "fixedStep"
    simulators, connections = SubElement(root, "Simulators"), SubElement(root, "Connections")
    for name, path in plan["fmus"].items():
        simulator = SubElement(simulators, "Simulator", name=name, source=Path(path).as_uri())
        values = SubElement(simulator, "InitialValues")
        for variable, value in plan["start"].get(name, {}).items():
            text = str(value).lower() if isinstance(value, bool) else repr(value)
            SubElement(SubElement(values, "InitialValue", variable=variable), types[name, variable], value=text)
    for target, source in plan["connections"].items():
        connection = SubElement(connections, "VariableConnection")
        for reference in (source, target):
            simulator, _, name = reference.partition(".")
            SubElement(connection, "Variable", simulator=simulator, name=name)
    return ElementTree(root)


def main() -> None:
    plan, folder = json.load(sys.stdin), Path(sys.argv[1])
    log_output_level(CosimLogLevel.WARNING)
    variables = {
        (name, v.name): v
        for name, path in plan["fmus"].items()
        for v in fmpy.read_model_description(path).modelVariables
    }
    file = folder / "OspSystemStructure.xml"
    types = {place: v.type for place, v in variables.items()}
    system_structure(plan, types).write(file, encoding="UTF-8", xml_declaration=True)
    execution = CosimExecution.from_osp_config_file(str(file))
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    assert execution.add_observer(observer)
    assert execution.add_manipulator(manipulator)
    indices = {name: execution.slave_index_from_instance_name(name) for name in plan["fmus"]}

    def place(reference: str) -> tuple[int, list[int], str]:
        name, _, variable = reference.partition(".")
        return indices[name], [variables[name, variable].valueReference], types[name, variable]

    read = {"Real": observer.last_real_values, "Integer": observer.last_integer_values}
    recorded = [place(reference) for reference in plan["recorded"]]
    changed = [(place(reference)[:2], series) for reference, series in plan["set"].items()]
    rows = []
    for k in range(plan["n_steps"]):
        for (index, references), series in changed:
            assert manipulator.slave_real_values(index, references, [series[k]])
        assert execution.step()
        assert execution.status().state != CosimExecutionState.ERROR.value
        rows.append([float(read[kind](index, references)[0]) for index, references, kind in recorded])
    json.dump({"rows": rows}, sys.stdout)
    sys.stdout.flush()
    os._exit(0)  # before pythonfmu's exit handler


if __name__ == "__main__":
    main()
