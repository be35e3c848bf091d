"""A study on what mpiexec starts: the same table; and what follows when one of its processes dies."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli import main
from tests.cosim.studies.chaos import STUDY, bytes_of, children_of, command_of, done_in

pytest.importorskip("mpi4py", reason="mpi4py is not installed")
MPIEXEC = shutil.which("mpiexec", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.full,
    pytest.mark.skipif(MPIEXEC is None, reason="there is no mpiexec"),
]


def started(*arguments):
    """A command on three processes of MPI, the head among them."""
    own = os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    oversubscribe = own | {"PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe"}  # fewer processors than three
    command = [MPIEXEC, "-n", "3", sys.executable, "-m", "mpi4py.futures", "-m", "cosim.cli", *arguments, "--on", "mpi"]
    return subprocess.Popen(command, env=oversubscribe, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.usefixtures("leaves_nothing")
def test_a_study_on_mpi_is_that_of_this_machine_also_after_a_kill(tmp_path, becomes_true):
    path, out = tmp_path / "short.toml", tmp_path / "out"
    path.write_text(STUDY.format(samples=8, keep="true", isolation="none"))
    assert main(["study", str(path), "--out", str(tmp_path / "serial"), "--jobs", "1"]) == 0
    head = started("study", str(path), "--out", str(out))
    becomes_true(lambda: head.poll() is not None or len(done_in(out) or {}) >= 2)
    ranks = [p for p in children_of(head.pid) if "mpi4py.futures" in command_of(p)]  # the others have runs
    os.kill(max(ranks), signal.SIGKILL)
    told = head.communicate(timeout=60)[1]
    assert head.returncode != 0, told
    done = done_in(out)
    assert 2 <= len(done) < 16
    again = started("resume", str(out))
    told = again.communicate(timeout=300)[1]
    assert again.returncode == 0, told
    assert done_in(out).items() >= done.items()  # nothing that was done was run again
    assert bytes_of(out) == bytes_of(tmp_path / "serial")
    assert len(list((out / "runs").iterdir())) == 16
