"""CoFMUPy."""

from cofmupy import Coordinator
from jobs import Job, run


def simulate(job: Job) -> list[list[float]]:
    def end(name: str) -> dict[str, str]:
        return dict(zip(("id", "variable"), name.split(".", 1)))

    coordinator = Coordinator()
    coordinator.start(
        {
            "fmus": [
                {"id": name, "path": path, "initialization": job.of(name, job.start)} for name, path in job.fmus.items()
            ],
            "connections": [{"source": end(b), "target": end(a)} for a, b in job.connections.items()],
            "cosim_method": job.options.get("cosim_method", "jacobi"),
        }
    )
    if "order" in job.options:  # within a cycle it is that of a set of strings: any, in any process
        assert sorted(map(sorted, coordinator.master.sequence_order)) == sorted(map(sorted, job.options["order"]))
        coordinator.master.sequence_order = job.options["order"]
    for k in range(job.n_steps):
        changes = {name: {v: [x] for v, x in job.of(name, job.changes_at(k)).items()} for name in job.fmus}
        coordinator.master.do_step(job.macro_step, input_dict=changes)
    results = coordinator.get_results()
    return [list(row) for row in zip(*(results[tuple(name.split(".", 1))] for name in job.outputs))]


run(simulate)
