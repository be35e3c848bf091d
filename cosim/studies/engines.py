"""Engines that make the runs of a study: processes of this machine, a Dask cluster, MPI."""

import importlib
import json
import logging
import os
import sys
import warnings
from collections.abc import Callable, Generator
from concurrent.futures import BrokenExecutor, CancelledError, Executor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from ..errors import ScenarioError, one_line
from .processes import LocalProcesses
from .recipe import KilledFmuError

MPI: Final = "mpi"
"""Name of the engine for programs that mpiexec has started."""
_CONNECT_S: Final = 30


@dataclass(frozen=True)
class Engine:
    """An executor, and what a study has to know of it."""

    name: str
    """Name, for messages."""
    executor: Executor
    """Executor that makes the calls."""
    width: Callable[[], int]
    """Number of calls that it makes at a time, now."""
    is_here: bool
    """True where its workers see the files of this machine."""
    losses: tuple[type[BaseException], ...] = (BrokenExecutor, MemoryError, KilledFmuError)
    """Exceptions of a call whose worker has died."""
    ends: tuple[type[BaseException], ...] = ()
    """Exceptions that say that the engine itself has gone."""
    is_alive: Callable[[], bool] = lambda: True
    """True as long as the engine can make calls."""
    dashboard: str = ""
    """Address of its own page, if it has one."""


def jobs_here(jobs: int | None, n_runs: int) -> int:
    """Return how many of n_runs are made at a time on this machine: at most jobs, by default one per processor."""
    return min(jobs or os.cpu_count() or 1, n_runs)


@contextmanager
def engine_for(on: str | None, jobs: int, is_plain: bool = False) -> Generator[Engine]:
    """Yield the engine at an address: of a Dask scheduler, a file that has it, or `mpi`; by default this machine.

    jobs: processes of this machine. is_plain: a Dask scheduler elsewhere may be talked to without TLS. Raises
    ScenarioError in one line.
    """
    if on is None:
        with LocalProcesses(jobs) as executor:
            yield Engine("this machine", executor, lambda: jobs, is_here=True)
    elif on == MPI:
        with _mpi() as engine:
            yield engine
    else:
        with _dask(on, is_plain) as engine:
            yield engine


@contextmanager
def _dask(on: str, is_plain: bool) -> Generator[Engine]:
    """Yield an engine on a Dask cluster, whose own retries are off."""
    _check_address(on, is_plain)
    distributed = _imported("distributed", "--on", "dask")
    for log in ("distributed", "tornado", "asyncio"):  # which print tracebacks of what ends in one line here
        logging.getLogger(log).setLevel(logging.CRITICAL)
    try:
        client: Any = distributed.Client(
            **({"scheduler_file": on} if Path(on).is_file() else {"address": on}),
            timeout=_CONNECT_S, set_as_default=False, heartbeat_interval=2000,
        )  # fmt: skip
    except TypeError as e:  # what distributed raises for want of a certificate
        raise ScenarioError(f"--on {on}: give Dask's configuration a certificate: see docs/studies.md.") from e
    except (OSError, ValueError, ImportError) as e:
        raise ScenarioError(f"--on {on}: no Dask scheduler answers: {one_line(str(e))}.") from e
    with client, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")  # FMUs travel once a worker

        def without_retries(dask_scheduler: Any = None) -> None:  # travels by value: the scheduler need not have us
            dask_scheduler.allowed_failures = 0

        client.run_on_scheduler(without_retries)
        gone = (CancelledError, distributed.comm.CommClosedError, TimeoutError)
        lost = (distributed.scheduler.KilledWorker, BrokenExecutor, MemoryError, KilledFmuError)
        executor = client.get_executor(pure=False, retries=0)
        try:
            yield Engine(
                f"the Dask scheduler at {client.scheduler.address}", executor, partial(_n_threads, client), False,
                lost, gone, lambda: client.status == "running", client.dashboard_link,
            )  # fmt: skip
        finally:
            executor.shutdown(wait=False)


def _n_threads(client: Any) -> int:
    """Return the number of a cluster's threads, as the client was last told; one more run waits for a new worker."""
    workers: dict[str, Any] = client.scheduler_info(n_workers=-1)["workers"]
    return max(1, sum(w["nthreads"] for w in workers.values()))


@contextmanager
def _mpi() -> Generator[Engine]:
    """Yield an engine on what `mpiexec -n 9 python -m mpi4py.futures -m cosim.cli` has started."""
    futures = _imported("mpi4py.futures", "--on mpi", "mpi")
    if "mpi4py.futures" not in sys.orig_argv or _imported("mpi4py.MPI", "--on mpi", "mpi").COMM_WORLD.Get_size() < 2:
        raise ScenarioError("--on mpi: begin with mpiexec -n 9 python -m mpi4py.futures -m cosim.cli, for 8 workers.")
    with futures.MPIPoolExecutor() as executor:
        executor.bootup()
        n = int(executor.num_workers)
        yield Engine("MPI", executor, lambda: max(1, n), is_here=False)


def _check_address(on: str, is_plain: bool) -> None:
    """Raise ScenarioError for what is no address, and for one that is neither encrypted nor of this machine."""
    address = on
    if Path(on).is_file():
        try:
            address = str(json.loads(Path(on).read_bytes())["address"])
        except (OSError, ValueError, KeyError, TypeError) as e:
            raise ScenarioError(f"--on {on}: the file names no Dask scheduler.") from e
    parts = urlsplit(address)
    if parts.scheme not in ("tcp", "tls") or not parts.hostname:
        raise ScenarioError(
            f"--on {on}: must be the address of a Dask scheduler, such as tls://head:8786, a file with it, or mpi."
        )
    if parts.scheme == "tcp" and not is_plain and not _is_loopback(parts.hostname):
        raise ScenarioError(
            f"--on {on}: whoever reaches a port of Dask without TLS runs code on its workers and here; use tls://, or "
            "--plain in a network where everybody is trusted."
        )


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _imported(module: str, option: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as e:
        raise ScenarioError(f"{option} needs {module.partition('.')[0]}: pip install 'fmu-retune[{extra}]'.") from e


def reason_of(error: BaseException) -> str:
    """Return in one line why a call has no result."""
    if (worker := getattr(error, "last_worker", None)) is not None:  # Dask's KilledWorker, which takes a paragraph
        return f"its worker {worker.address} has died"
    name, text = type(error).__name__, one_line(str(error))
    return text if isinstance(error, BrokenExecutor | KilledFmuError) else f"{name}: {text}" if text else name
