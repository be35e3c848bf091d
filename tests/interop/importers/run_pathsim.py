"""PathSim, by way of pathsim-fmi."""

from jobs import Job, run
from pathsim import Connection, Simulation
from pathsim.blocks import Source
from pathsim.events import Schedule
from pathsim_fmi import CoSimulationFMU


def simulate(job: Job) -> list[list[float]]:
    h = job.macro_step
    order = job.options.get("order", list(job.fmus))
    blocks = {name: CoSimulationFMU(job.fmus[name], name, job.of(name, job.start), dt=h) for name in order}

    def port(name: str):
        component, _, variable = name.partition(".")
        return blocks[component][variable]

    connections = [Connection(port(source), port(target)) for target, source in job.connections.items()]
    parameters = job.changed()
    sources = []
    for component, block in blocks.items():
        for variable in block.fmu_wrapper.input_refs:  # what is not connected is set to 0 at every step
            name = f"{component}.{variable}"
            if name not in job.connections:
                values = [job.start.get(name, 0.0)]
                for k in range(job.n_steps + 1):
                    values.append(job.changes_at(k).get(name, values[-1]))
                sources.append(Source(lambda t, values=values: values[round(t / h) + 1]))
                connections.append(Connection(sources[-1], port(name)))
                parameters -= {name}
    rows = []

    def at_communication_point(t: float) -> None:  # before the blocks step: the simulation's own events come first
        rows.append([float(blocks[n.partition(".")[0]].outputs[n.partition(".")[2]]) for n in job.outputs])
        for name, value in job.changes_at(len(rows) - 1).items():
            if name in parameters:
                component, _, variable = name.partition(".")
                blocks[component].fmu_wrapper.set_variable(variable, value)

    observer = Schedule(t_period=h, func_act=at_communication_point)
    simulation = Simulation([*blocks.values(), *sources], connections, [observer], dt=h, log=False)
    simulation.run(job.n_steps * h)
    return rows[1:]


run(simulate)
