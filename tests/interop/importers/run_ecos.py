"""ecos, by way of ecospy."""

import ctypes
import sys
from pathlib import Path

for library in Path(sys.prefix, "lib").glob("libtbb.so.12"):
    ctypes.CDLL(str(library))  # what libecosc.so needs, from the package tbb; else the system's is found
from ecospy import EcosSimulation, EcosSimulationStructure  # noqa: E402
from jobs import Job, run  # noqa: E402


def simulate(job: Job) -> list[list[float]]:
    def there(name: str) -> str:
        return name.replace(".", "::", 1)

    with EcosSimulationStructure() as structure:
        for name, path in job.fmus.items():
            structure.add_model(name, path)
        for target, source in job.connections.items():
            structure.make_real_connection(there(source), there(target))
        structure.add_parameter_set("start", {there(name): value for name, value in job.start.items()})
        with EcosSimulation(structure=structure, step_size=job.macro_step) as simulation:
            assert simulation.init(parameter_set="start")
            rows = []
            for k in range(job.n_steps):
                for name, value in job.changes_at(k).items():
                    simulation.set_real(there(name), value)
                simulation.step()
                rows.append([simulation.get_real(there(name)) for name in job.outputs])
            simulation.terminate()
            return rows


run(simulate)
