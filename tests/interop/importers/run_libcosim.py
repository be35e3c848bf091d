"""libcosim's fixed-step algorithm, by way of libcosimpy."""

from jobs import Job, run
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave


def simulate(job: Job) -> list[list[float]]:
    execution = CosimExecution.from_step_size(round(job.macro_step * 1e9))  # ns
    slaves = {name: CosimLocalSlave(path, name) for name, path in job.fmus.items()}
    indices = {name: execution.add_local_slave(slave) for name, slave in slaves.items()}
    place = {
        f"{name}.{v.name.decode()}": (index, v.reference)
        for name, index in indices.items()
        for v in execution.slave_variables(index)
    }
    observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
    done = [execution.add_observer(observer), execution.add_manipulator(manipulator)]
    done += [execution.real_initial_value(*place[name], value) for name, value in job.start.items()]
    for target, source in job.connections.items():
        done.append(execution.connect_real_variables(*place[source], *place[target]) == 0)
    rows = []
    for k in range(job.n_steps):
        for name, value in job.changes_at(k).items():
            index, reference = place[name]
            done.append(manipulator.slave_real_values(index, [reference], [value]))
        done.append(execution.step())
        rows.append([observer.last_real_values(place[name][0], [place[name][1]])[0] for name in job.outputs])
    assert all(done)
    return rows


log_output_level(CosimLogLevel.WARNING)
run(simulate)
