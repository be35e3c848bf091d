"""A plain FMPy master of any FMUs, with none of our code: `python fmpy_master.py < PLAN > ROWS`, both JSON.

At each communication point the FMUs step in the order of the plan; an input takes the newest value of its source.
"""

import json
import os
import sys
from math import isnan

import fmpy
from fmpy.fmi2 import FMU2Slave


class Component:
    """One FMU, by names."""

    def __init__(self, name: str, path: str, start: dict, start_time: float, is_logged: bool = False) -> None:
        description = fmpy.read_model_description(path)
        self.variables = {v.name: v for v in description.modelVariables}
        self.outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        self.fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=fmpy.extract(path), instanceName=name,
            modelIdentifier=description.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=start_time)
        self.fmu.enterInitializationMode()
        self.set(start)

    def set(self, values: dict) -> None:
        for name, value in values.items():
            v = self.variables[name]
            getattr(self.fmu, f"set{v.type}")([v.valueReference], [value])

    def get(self) -> dict:
        typed = {name: self.variables[name] for name in self.outputs}
        return {name: getattr(self.fmu, f"get{v.type}")([v.valueReference])[0] for name, v in typed.items()}


def main() -> None:
    plan = json.load(sys.stdin)
    h, start_time = plan["macro_step"], plan["start_time"]
    components = {
        name: Component(name, path, plan["start"].get(name, {}), start_time) for name, path in plan["fmus"].items()
    }
    values: dict[str, float] = {}

    def read(name: str) -> None:
        values.update({f"{name}.{k}": v for k, v in components[name].get().items()})

    for name in plan["order"]:  # sources first, as far as the order goes
        components[name].set(inputs(plan, name, values))
        components[name].fmu.exitInitializationMode()
        read(name)
    rows = []
    for k in range(plan["n_steps"]):
        t = start_time + k * h
        for name, series in plan["added"].items():  # measurement noise
            values[name] += series[k]
        for name in plan["order"]:
            told = {key.partition(".")[2]: s[k] for key, s in plan["set"].items() if key.startswith(f"{name}.")}
            components[name].set(inputs(plan, name, values) | told)
            if name == plan["last"]:
                rows.append([values[key] for key in plan["recorded"]])
            components[name].fmu.doStep(t, h)
            read(name)
    assert not any(isnan(value) for row in rows for value in row)
    json.dump({"rows": rows}, sys.stdout)
    sys.stdout.flush()
    os._exit(0)  # before pythonfmu's exit handler


def inputs(plan: dict, name: str, values: dict) -> dict:
    """What is known of the inputs of a component, by their names."""
    wires = {target: source for target, source in plan["connections"].items() if target.startswith(f"{name}.")}
    return {target.partition(".")[2]: values[source] for target, source in wires.items() if source in values}


if __name__ == "__main__":
    main()
