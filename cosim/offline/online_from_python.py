"""The command `retune estimate --online` as a function, `cosim.estimate_online`."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..blas_threads import one_thread
from ..runs.lock import new_locked_folder
from ..runs.record import recording
from .from_python import Bounds, cuts_of, sought
from .log_windows import Cut
from .online import Online, SampleProgress, run_online
from .online_report import write_files
from .request import EstimateError, Request


def estimate_online(
    fmu: Path | str,
    logs: Path | str | Sequence[Path | str],
    parameters: Mapping[str, Bounds],
    measured: Mapping[str, str],
    inputs: Mapping[str, str] | None = None,
    *,
    samples: int = 50,
    evaluations_per_sample: int = 1,
    start: Mapping[str, str | float] | None = None,
    noise: Mapping[str, float] | None = None,
    time: str | None = None,
    time_unit: str | None = None,
    windows: Sequence[Cut] = (),
    step: float | None = None,
    method: str = "target",
    evaluations: int = 30,
    seed: int = 0,
    jobs: int | None = None,
    timeout: float = 10.0,
    environment: Sequence[str] = (),
    out: Path | str | None = None,
    progress: SampleProgress = lambda n, n_all: None,
) -> Online:
    """Take logs of measurements sample by sample, as if the loop ran: when it triggers, and what it would write.

    samples: how many of them a candidate is evaluated on. evaluations: candidates of an episode, of which
    evaluations_per_sample are simulated at each sample.
    out: an absent or empty folder for the files that `retune estimate --online` writes; none by default.
    progress: called with the number of samples taken so far, and the number of all.
    The other arguments are those of `cosim.estimate`.

    Raises CosimError in one line for what is refused.
    """
    if samples < 1 or evaluations_per_sample < 1:
        raise EstimateError("samples and evaluations_per_sample must be 1 or more.")
    paths = [logs] if isinstance(logs, Path | str) else logs
    request = Request(
        fmu=Path(fmu),
        logs=tuple(map(Path, paths)),
        parameters=tuple(sought(name, bounds) for name, bounds in parameters.items()),
        measured=measured,
        inputs=inputs or {},
        start=start or {},
        noise=noise or {},
        time=time,
        time_unit=time_unit,
        windows=cuts_of(windows),
        step=step,
        method=method,
        evaluations=evaluations,
        seed=seed,
        jobs=(os.cpu_count() or 1) if jobs is None else jobs,
        timeout=timeout,
        environment=tuple(environment),
    )
    with one_thread():  # as the command runs: the number of BLAS threads changes bits
        if out is None:
            return run_online(request, samples, progress, evaluations_per_sample)
        with new_locked_folder(f"{request.fmu.stem}-online", Path(out)) as folder:
            found = run_online(request, samples, progress, evaluations_per_sample)
            with recording(folder):
                write_files(found, folder)
    return found
