"""A run folder has one command at a time, for exactly as long as that lives."""

import os
import signal
import subprocess
import sys

import pytest

from cosim.errors import FolderError
from cosim.runs.lock import is_locked, locked, new_locked_folder
from cosim.runs.run_files import LOCK
from cosim.terminal.folders import new_folder

HOLDER = """
import sys, time
from pathlib import Path
from cosim.runs.lock import locked
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
from cosim.runs.lock import locked
from cosim.runs.record import FolderError
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


# New folders.


def test_a_new_folder_is_nobody_elses_until_the_end(tmp_path):
    with new_folder("pendulum", tmp_path / "new") as folder:
        assert is_locked(folder)
        with new_locked_folder("pendulum", folder):  # as the function does that the command calls
            (folder / "result").touch()
        assert is_locked(folder)
    assert [path.name for path in folder.iterdir()] == ["result"]


def test_a_folder_that_another_has_just_taken_is_left_as_it_is(tmp_path, holder):
    (tmp_path / "runs").mkdir()
    with pytest.raises(FolderError, match=f"is in use by process {holder.pid} on "), new_folder("figures", tmp_path):
        pass
    assert sorted(path.name for path in tmp_path.iterdir()) == [LOCK, "runs"]


def test_what_was_filled_by_another_meanwhile_is_refused(tmp_path, monkeypatch):
    def _filled_first(folder):
        (folder / "precious").touch()
        return locked(folder)

    monkeypatch.setattr("cosim.runs.lock.locked", _filled_first)
    with pytest.raises(FolderError, match="is not empty"), new_folder("pendulum", tmp_path / "new"):
        pass
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["precious"]


def test_what_a_killed_command_leaves_before_its_run_is_nothing(tmp_path, holder):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    for baseline in ("none", "true"):
        (tmp_path / baseline).mkdir()
    with new_folder("pendulum", tmp_path) as folder:
        assert [path.name for path in folder.iterdir()] == [LOCK]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", [LOCK, "none/mine"])
def test_what_the_user_has_there_is_no_leftover(tmp_path, name):
    (tmp_path / "none").mkdir()
    (tmp_path / LOCK).touch()
    (tmp_path / name).write_text("precious")
    with pytest.raises(FolderError, match="is not empty"), new_folder("pendulum", tmp_path):
        pass
    assert (tmp_path / name).read_text() == "precious"


def test_a_failure_before_anything_is_written_leaves_what_was_there(tmp_path):
    (tmp_path / "there").mkdir()
    for out in (tmp_path / "there", tmp_path / "a" / "b"):
        with pytest.raises(FileExistsError), new_folder("pendulum", out) as folder:
            _ = [(folder / name).mkdir() for name in ("none", "true", "none")]
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]
