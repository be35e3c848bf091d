"""FMPy: a master's loop written by hand, and simulate_fmu for a component alone."""

import numpy as np
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi2 import FMU2Slave
from jobs import Job, run


class Instance:
    """An FMU whose variables are set and got by name."""

    def __init__(self, name: str, path: str, start: dict[str, float]) -> None:
        description = read_model_description(path)
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        identifier = description.coSimulation.modelIdentifier
        self.fmu = FMU2Slave(
            guid=description.guid, unzipDirectory=extract(path), modelIdentifier=identifier, instanceName=name
        )
        self.fmu.instantiate()
        self.set(start)
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def set(self, values: dict[str, float]) -> None:
        if values:
            self.fmu.setReal([self.references[name] for name in values], list(values.values()))

    def get(self) -> dict[str, float]:
        return dict(zip(self.outputs, self.fmu.getReal([self.references[name] for name in self.outputs])))

    def step(self, t: float, h: float) -> None:
        self.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=h)


def loop(job: Job) -> list[list[float]]:
    """The components step one after another, in the order of options["order"]."""
    instances = {name: Instance(name, path, job.of(name, job.start)) for name, path in job.fmus.items()}
    values: dict[str, float] = {}
    for name, instance in instances.items():
        values |= {f"{name}.{output}": value for output, value in instance.get().items()}
    rows = []
    for k in range(job.n_steps):
        for name in job.options["order"]:
            inputs = {target: values[source] for target, source in job.connections.items()}
            instances[name].set(job.of(name, job.changes_at(k)) | job.of(name, inputs))
            instances[name].step(k * job.macro_step, job.macro_step)
            values |= {f"{name}.{output}": value for output, value in instances[name].get().items()}
        rows.append([values[name] for name in job.outputs])
    for instance in instances.values():
        instance.fmu.terminate()
        instance.fmu.freeInstance()
    return rows


def alone(job: Job) -> list[list[float]]:
    """A component alone, its inputs and tunable parameters given as a signal of one sample a step."""
    ((component, path),) = job.fmus.items()
    signals = sorted(job.changed())
    columns = [(name.partition(".")[2], np.float64) for name in signals]
    values, samples = dict(job.start), []
    for k in range(job.n_steps + 1):
        values |= job.changes_at(k)
        samples.append((k * job.macro_step, *(values[name] for name in signals)))
    outputs = [name.partition(".")[2] for name in job.outputs]
    result = simulate_fmu(
        path, stop_time=job.n_steps * job.macro_step, output_interval=job.macro_step, output=outputs,
        start_values=job.of(component, job.start), input=np.array(samples, [("time", np.float64), *columns]),
    )  # fmt: skip
    return [[float(row[name]) for name in outputs] for row in result[1:]]


run(lambda job: loop(job) if "order" in job.options else alone(job))
