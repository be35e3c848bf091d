"""A study's table is byte for byte that of a serial run, whatever was killed; nothing that is done runs twice."""

import os
import time
from pathlib import Path

import pytest

from cosim.cli import main
from cosim.fmi.folder import remove_abandoned
from cosim.studies.head import UNCOMMITTED
from tests.cosim.studies.chaos import STUDY, Cluster, bytes_of, survive

pytestmark = [pytest.mark.fmu, pytest.mark.full]

SIZES = [
    pytest.param(6, 3, "process", id="3 kills"),
    pytest.param(100, 50, "none", id="50 kills", marks=pytest.mark.slow),
]
"""Points of the study, each with two runs, kills, and whether FMUs have processes of their own."""


@pytest.fixture
def serial(tmp_path, leaves_nothing):
    """serial(samples, isolation, keep): a study's file, and its table of runs made one after the other."""

    def made(samples, isolation, keep=False):
        path = tmp_path / "short.toml"
        path.write_text(STUDY.format(samples=samples, keep=str(keep).lower(), isolation=isolation))
        assert main(["study", str(path), "--out", str(tmp_path / "serial"), "--jobs", "1"]) == 0
        return path, bytes_of(tmp_path / "serial")

    return made


def processes_with(folder):
    """Ids of living processes that keep their temporary files in that folder or below, but for this one."""
    found = set()
    for place in Path("/proc").glob("[0-9]*"):
        try:
            state = (place / "stat").read_text().rpartition(")")[2].split()[0]
            environment = (place / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if any(entry.startswith(f"TMPDIR={folder}".encode()) for entry in environment) and state != "Z":
            found.add(int(place.name))
    return found - {os.getpid()}


def check(tmp_path, table, chaos, n_kills):
    assert sum(chaos.kills.values()) <= n_kills
    assert chaos.done_twice == []
    assert bytes_of(tmp_path / "out") == table
    assert not list((tmp_path / "out").rglob(f"{UNCOMMITTED}*"))
    deadline = time.monotonic() + 60.0
    while (left := processes_with(tmp_path)) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left


@pytest.mark.parametrize(("samples", "n_kills", "isolation"), SIZES)
def test_on_processes_of_this_machine(serial, tmp_path, samples, n_kills, isolation):
    path, table = serial(samples, isolation, keep=True)
    chaos = survive(path, tmp_path / "out", n_kills, seed=n_kills)
    print(chaos)
    check(tmp_path, table, chaos, n_kills)
    assert len(list((tmp_path / "out" / "runs").iterdir())) == 2 * samples


@pytest.mark.parametrize(("samples", "n_kills", "isolation"), SIZES)
def test_on_a_dask_cluster_of_three_workers(serial, tmp_path, samples, n_kills, isolation):
    path, table = serial(samples, isolation)
    cluster = Cluster(tmp_path / "cluster")
    chaos = survive(path, tmp_path / "out", n_kills, n_kills, cluster)
    print(chaos)
    check(tmp_path, table, chaos, n_kills)
    for k in range(3):
        home = tmp_path / "cluster" / f"worker-{k}"
        remove_abandoned(str(home / "tmp"))  # as the next process there does: a kill may hit who would have done it
        assert list((home / "tmp").iterdir()) == []
        assert list((home / "elsewhere").iterdir()) == []
