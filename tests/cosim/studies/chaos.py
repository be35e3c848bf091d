"""A study whose processes are killed at random, again and again, until all its runs are made."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from cosim.errors import FolderError
from cosim.studies.ledger import LEDGER, open_ledger
from cosim.studies.row import WALL_TIMES
from cosim.studies.table import RESULTS

STUDY = """
[study]
name = "short"
scenarios = ["pendulum"]
estimators = ["none", "target"]
sampling = "latin-hypercube"
samples = {samples}
keep = {keep}
[study.settings]
"scenario.stop_time" = 0.05
"scenario.isolation" = "{isolation}"
"estimation.budget" = 10
"estimation.trigger" = {{ kind = "innovation" }}
[factors.payload]
set = 'changes."plant.m"'
to = "[[0.0, 1.75], [0.02, {{}}]]"
uniform = [2.0, 5.0]
"""


def bytes_of(folder: Path) -> bytes:
    """The table of a study, but for its wall times, as bytes."""
    table = pq.read_table(folder / RESULTS)
    table = table.drop_columns([name for name in WALL_TIMES if name in table.column_names])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table.combine_chunks())
    return sink.getvalue().to_pybytes()


def children_of(process_id: int) -> list[int]:
    """Ids of the living processes below a process, at any depth."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            if fields[0] != "Z":
                parents[int(folder.name)] = int(fields[1])
    found, pending = [], [process_id]
    while pending:
        below = [child for child, parent in parents.items() if parent == pending[-1]]
        pending.pop()
        found += below
        pending += below
    return found


def is_alive(process: subprocess.Popen | None) -> bool:
    return process is not None and process.poll() is None


@dataclass
class Cluster:
    """A Dask cluster on the loopback: a scheduler and workers with homes, caches and temporary folders of their own."""

    place: Path
    n_workers: int = 3
    scheduler: subprocess.Popen | None = None
    workers: dict[int, subprocess.Popen] = field(default_factory=dict)
    port: int = 0

    def keep_up(self) -> None:
        """Start what is not running."""
        if not is_alive(self.scheduler):
            with socket.socket() as free:
                free.bind(("127.0.0.1", 0))
                self.port = free.getsockname()[1]
            self.stop()
            own = ("--host", "127.0.0.1", "--port", str(self.port))
            self.scheduler = self._start("scheduler", "distributed.cli.dask_scheduler", *own)
        for k in range(self.n_workers):
            if not is_alive(self.workers.get(k)):
                own = (self.address, "--host", "127.0.0.1", "--nthreads", "1")
                self.workers[k] = self._start(f"worker-{k}", "distributed.cli.dask_worker", *own)

    @property
    def address(self) -> str:
        return f"tcp://127.0.0.1:{self.port}"

    def stop(self) -> None:
        """End everything, by a signal that asks and then by one that does not."""
        processes = [p for p in (*self.workers.values(), self.scheduler) if p is not None]
        for process in processes:
            process.terminate()
        for process in processes:
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                for child in children_of(process.pid):
                    with suppress(ProcessLookupError):
                        os.kill(child, signal.SIGKILL)
                process.kill()
                process.wait()
        self.workers, self.scheduler = {}, None

    def _start(self, name: str, module: str, *arguments: str) -> subprocess.Popen:
        home = self.place / name
        (home / "tmp").mkdir(parents=True, exist_ok=True)
        (home / "elsewhere").mkdir(exist_ok=True)
        environment = os.environ | {
            "HOME": str(home), "FMU_RETUNE_CACHE": str(home / "cache"), "TMPDIR": str(home / "tmp"),
            "XDG_STATE_HOME": str(home / "state"), "DASK_TEMPORARY_DIRECTORY": str(home / "dask"),
        }  # fmt: skip
        command = [sys.executable, "-m", module, *arguments, "--no-dashboard"]
        with open(home / "log", "a") as log:
            return subprocess.Popen(command, cwd=home / "elsewhere", env=environment, stdout=log, stderr=log)


@dataclass
class Chaos:
    """What was done to a study, and how it came out."""

    kills: dict[str, int] = field(default_factory=dict)
    done_twice: list[str] = field(default_factory=list)
    heads: int = 0


def survive(
    study: Path, out: Path, n_kills: int, seed: int, cluster: Cluster | None = None, log: Callable = print
) -> Chaos:
    """Carry a study through, killing its processes n_kills times at random moments; out: its folder."""
    rng, chaos, done, head = random.Random(seed), Chaos(), {}, None
    try:
        while True:
            if cluster is not None:
                cluster.keep_up()
            begun = ["resume", str(out)] if done_in(out) is not None else ["study", str(study), "--out", str(out)]
            on = ["--jobs", "2"] if cluster is None else ["--on", cluster.address]
            command = [sys.executable, "-m", "cosim.cli", *begun, *on]
            head = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
            chaos.heads += 1
            n_before = len(done)
            while is_alive(head):
                with suppress(subprocess.TimeoutExpired):
                    head.wait(rng.uniform(0.2, 4.0))
                now = done_in(out) or {}
                chaos.done_twice += [key for key, lease in done.items() if now.get(key, lease) != lease]
                done |= now
                if is_alive(head) and sum(chaos.kills.values()) < n_kills and len(now) > n_before:
                    n_before = len(now) - (rng.random() < 0.5)  # now and then two kills at about the same time
                    name, processes = rng.choice(sorted(targets(head, cluster).items()))
                    process = rng.choice(processes)
                    with suppress(ProcessLookupError):
                        os.kill(process, signal.SIGKILL)
                        chaos.kills[name] = chaos.kills.get(name, 0) + 1
                    if cluster is not None and is_alive(cluster.scheduler):
                        cluster.keep_up()
            told = head.communicate()[1]
            log(f"head ended with {head.returncode}: {told.strip().splitlines()[-1:]}; {len(done)} done; {chaos.kills}")
            if head.returncode == 0:
                return chaos
            assert head.returncode in (1, -signal.SIGKILL), told
    finally:
        if is_alive(head):
            head.kill()
        if cluster is not None:
            cluster.stop()


def targets(head: subprocess.Popen, cluster: Cluster | None) -> dict[str, list[int]]:
    """Ids of the processes that may be killed, by kind: each kind has the same chance."""
    found = {"head": [head.pid]}
    if cluster is None:
        below = children_of(head.pid)
        workers = [child for child in below if "cosim.studies.processes" in command_of(child)]
        found |= {"worker": workers, "FMU": [child for child in below if child not in workers]}
    else:
        nannies = [worker.pid for worker in cluster.workers.values() if is_alive(worker)]
        found |= {"scheduler": [cluster.scheduler.pid], "nanny": nannies}
        found |= {"worker": [child for nanny in nannies for child in children_of(nanny)]}
    return {kind: processes for kind, processes in found.items() if processes}


def command_of(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_text()
    except OSError:
        return ""


def done_in(folder: Path) -> dict[str, int] | None:
    """Lease of each run that is done; None where there is no ledger yet."""
    if not (folder / LEDGER).exists():
        return None
    try:
        with open_ledger(folder / LEDGER, is_read_only=True) as ledger:
            return {entry.key: entry.lease for entry in ledger.entries() if entry.state in ("done", "failed")}
    except FolderError:
        time.sleep(0.1)
        return {}
