"""A run folder has one command at a time, for exactly as long as that lives."""

import os
import signal
import subprocess
import sys

import pytest

from cosim.results.lock import is_locked, locked
from cosim.results.record import LOCK, FolderError

HOLDER = """
import sys, time
from pathlib import Path
from cosim.results.lock import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the folder until its input ends."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, tmp_path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_file_is_there_while_the_folder_is_held(tmp_path):
    assert not is_locked(tmp_path)
    with locked(tmp_path):
        assert is_locked(tmp_path)
        assert f"process {os.getpid()} on " in (tmp_path / LOCK).read_text()
    assert not is_locked(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_error_inside_gives_the_folder_back(tmp_path):
    with pytest.raises(KeyError), locked(tmp_path):
        raise KeyError
    assert list(tmp_path.iterdir()) == []


def test_the_same_process_may_come_again(tmp_path):
    with locked(tmp_path):
        with locked(tmp_path):
            pass
        assert is_locked(tmp_path)
    assert not is_locked(tmp_path)


def test_another_process_is_refused_by_name_and_let_in_afterwards(tmp_path, holder):
    assert is_locked(tmp_path)
    with pytest.raises(FolderError, match=f"{tmp_path} is in use by process {holder.pid} on "), locked(tmp_path):
        pass
    assert (tmp_path / LOCK).exists()
    holder.communicate("")
    with locked(tmp_path):
        pass


def test_who_was_killed_keeps_nobody_out(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / LOCK).read_text() == f"process {holder.pid} on {os.uname().nodename}"
    assert not is_locked(tmp_path)
    with locked(tmp_path):
        assert f"process {os.getpid()} on " in (tmp_path / LOCK).read_text()
    assert list(tmp_path.iterdir()) == []


def test_of_many_processes_one_at_a_time_is_in(tmp_path):
    """Each makes a file that nobody else may see there, and tries again until it was in."""
    program = """
import sys, time
from pathlib import Path
from cosim.results.lock import locked
from cosim.results.record import FolderError
folder, done = Path(sys.argv[1]), 0
while done < 20:
    try:
        with locked(folder):
            (folder / "mine").touch(exist_ok=False)
            (folder / "mine").unlink()
            done += 1
    except FolderError:
        pass
"""
    command = [sys.executable, "-c", program, tmp_path]
    processes = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(3)]
    assert [p.communicate()[1] for p in processes] == [""] * 3
    assert [p.returncode for p in processes] == [0] * 3
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_or_cannot_be_written_is_told(tmp_path):
    with pytest.raises(FolderError, match=r"cannot write in .*gone: No such file"), locked(tmp_path / "gone"):
        pass
    assert not is_locked(tmp_path / "gone")
