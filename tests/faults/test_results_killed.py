"""Runs that are killed at any moment, or run out of disk: what was written is readable, and they go on to the bits
of a run that nobody disturbed."""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from resource import RLIMIT_FSIZE, prlimit

import numpy as np
import pytest

from cosim.runs.result import read_run
from cosim.runs.run_files import CHECKPOINT, EVENTS, LOCK, MANIFEST, RESULT, SERIES
from cosim.runs.series import read_series

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for what is left in /proc"),
]
RETUNE = Path(sys.executable).with_name("retune")
FINAL = (SERIES, EVENTS, "series.csv", "estimates.ssv")
PENDULUM = [
    "run", "pendulum", "--seed", "3", "--set", "scenario.stop_time=2", "--set", "scenario.checkpoint=50",
    "--set", 'changes."plant.m"=[[0.0, 1.75], [0.3, 4.271], [1.3, 3.0]]',
]  # fmt: skip
QUADROTOR = [
    "run", "quadrotor", "--seed", "3", "--only", "--set", "scenario.stop_time=1.5", "--set", "scenario.checkpoint=50",
]  # fmt: skip
SHORT = "scenario.stop_time=0.1"
WALL_TIMES = {"run", "wall_s", "latency_ms", "missed_deadlines"}


@pytest.fixture
def started(temporary) -> Iterator[Callable[..., subprocess.Popen]]:
    """Starts the command in a session of its own; whatever of it is left at the end is killed."""
    processes: list[subprocess.Popen] = []

    def start(*arguments: object, **options: object) -> subprocess.Popen:
        process = subprocess.Popen(
            [RETUNE, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True, env=os.environ | {"TMPDIR": str(temporary)}, **options,
        )  # fmt: skip
        processes.append(process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
            process.communicate()


def ended(process: subprocess.Popen) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=300)
    return process.returncode, out, err


def session_of(process: subprocess.Popen) -> set[int]:
    """Ids of the processes that run in the session which it has begun."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, _, _, session = (folder / "stat").read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == process.pid and state != "Z":
            found.add(int(folder.name))
    return found


def killed_when(process: subprocess.Popen, is_due: Callable[[], bool], temporary: Path, becomes_true) -> None:
    """SIGKILL as soon as is_due, and the proof that no process and no file outside the run folder is left."""
    while not is_due() and process.poll() is None:
        time.sleep(0.001)
    process.kill()
    assert ended(process)[0] == -signal.SIGKILL, "it has ended before"
    assert becomes_true(lambda: not session_of(process))
    for unpacked in temporary.iterdir():  # an FMU whose process was killed before it knew of its folder
        assert unpacked.name.startswith("fmu-retune-")
        shutil.rmtree(unpacked)


def size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def figures(folder: Path) -> dict[str, object]:
    return {k: v for k, v in json.loads((folder / RESULT).read_text()).items() if k not in WALL_TIMES}


def assert_same(undisturbed: Path, folder: Path) -> None:
    assert {p.name for p in folder.iterdir()} == {p.name for p in undisturbed.iterdir()}
    for name in FINAL:
        assert (folder / name).read_bytes() == (undisturbed / name).read_bytes(), name
    assert figures(folder) == figures(undisturbed)


def assert_readable(undisturbed: Path, folder: Path) -> int:
    """What a killed run has written is the beginning of the undisturbed one; its rows."""
    left, whole = read_run(folder), read_series(undisturbed)
    assert left.status == "unfinished"
    for name, values in left.series.items():
        np.testing.assert_array_equal(values, whole[name][: len(values)])
    events = (folder / EVENTS).read_bytes()
    assert (undisturbed / EVENTS).read_bytes().startswith(events)
    return len(left.time)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Callable[..., Path]:
    """The folder of a run that nobody disturbs, made once."""
    made: dict[tuple[str, ...], Path] = {}

    def of(*arguments: str) -> Path:
        if arguments not in made:
            made[arguments] = tmp_path_factory.mktemp("undisturbed") / "run"
            command = [RETUNE, *arguments, "--out", made[arguments]]
            subprocess.run(command, check=True, capture_output=True)
        return made[arguments]

    return of


KILLS = {
    "target": ([*PENDULUM, "--only"], 4),
    "rls": ([*PENDULUM, "--only", "--estimator", "rls"], 3),
    "quadrotor": (QUADROTOR, 3),
}


@pytest.mark.full
@pytest.mark.parametrize(("arguments", "n_kills"), KILLS.values(), ids=KILLS)
def test_a_run_that_is_killed_again_and_again_ends_with_the_same_bits(
    started, undisturbed, temporary, processes, tmp_path, arguments, n_kills
):
    whole, folder = undisturbed(*arguments), tmp_path / "run"
    moments = sorted(random.Random(7).uniform(0.0, 0.95) for _ in range(n_kills))  # shares of the series
    command = [*arguments, "--out", folder]
    for share in moments:
        due = share * size(whole / SERIES)
        killed_when(started(*command), lambda due=due: size(folder / SERIES) > due, temporary, processes[2])
        assert (folder / LOCK).exists()
        n_rows = assert_readable(whole, folder)
        assert n_rows >= int(share * len(read_series(whole)["time"])) - 50
        command = ["resume", folder]
    code, out, err = ended(started(*command))
    assert (code, err) == (0, "")
    assert "mean squared tracking error" in out
    assert_same(whole, folder)
    assert list(temporary.iterdir()) == []


@pytest.mark.full
def test_a_run_that_is_killed_while_it_is_compared_goes_on_with_that(
    started, undisturbed, temporary, processes, tmp_path
):
    whole, folder = undisturbed(*PENDULUM), tmp_path / "run"
    due = size(whole / "none" / SERIES) / 2
    process = started(*PENDULUM, "--out", folder)
    killed_when(process, lambda: size(folder / "none" / SERIES) > due, temporary, processes[2])
    assert read_run(folder).status == "done"
    assert_readable(whole / "none", folder / "none")
    assert list((folder / "true").iterdir()) == []
    code, out, err = ended(started("resume", folder, "--json"))
    assert (code, err) == (0, "")
    assert json.loads(out)["mse"] == json.loads((whole / RESULT).read_text())["mse"]
    for name in ("", "none", "true"):
        assert_same(whole / name, folder / name)
    assert (folder / "tracking.png").read_bytes() == (whole / "tracking.png").read_bytes()
    code, out, err = ended(started("resume", folder))
    assert (code, out, err) == (2, "", f"retune: {folder} cannot be resumed: it is done.\n")


@pytest.mark.full
def test_a_run_that_goes_on_is_nobody_elses(started, tmp_path, processes):
    folder = tmp_path / "run"
    process = started(*PENDULUM, "--only", "--out", folder, "--set", "scenario.stop_time=36000")
    assert processes[2](lambda: size(folder / SERIES) > 50_000, within_s=60.0)
    assert read_run(folder).status == "running"
    owner = f"process {process.pid} on {os.uname().nodename}"
    assert ended(started("resume", folder))[::2] == (
        2, f"retune: {folder} is in use by {owner}; wait for it, or end it first.\n"
    )  # fmt: skip
    assert ended(started(*PENDULUM, "--only", "--out", folder))[::2] == (
        2, f"retune: {folder} is not empty; give --out a new or empty folder.\n"
    )  # fmt: skip
    process.send_signal(signal.SIGINT)
    assert ended(process)[0] == 130
    assert read_run(folder).status == "interrupted"
    assert not (folder / LOCK).exists()


# A full disk.


def assert_full(outcome: tuple[int, str, str], folder: Path, reason: str) -> None:
    code, out, err = outcome
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert err.startswith("retune: cannot write ")
    assert err.endswith(f"{reason}; what is written stays: make room, then retune resume {folder}.\n")
    assert json.loads((folder / MANIFEST).read_text())["status"] == "running"


@pytest.fixture
def disk(tmp_path) -> Iterator[Path]:
    """A small disk of its own: 100 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=100k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("may not mount a file system")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.full
def test_a_run_on_a_full_disk_goes_on_when_there_is_room(started, undisturbed, temporary, disk):
    arguments = [*PENDULUM, "--only"]
    whole, folder = undisturbed(*arguments), disk / "run"
    assert_full(ended(started(*arguments, "--out", folder)), folder, "No space left on device")
    assert_readable(whole, folder)
    assert {p.name for p in folder.iterdir()} == {MANIFEST, SERIES, EVENTS, CHECKPOINT}
    assert_full(ended(started("resume", folder)), folder, "No space left on device")  # still no room
    subprocess.run(["mount", "-o", "remount,size=10m", str(disk)], check=True)
    assert ended(started("resume", folder))[::2] == (0, "")
    assert_same(whole, folder)
    assert list(temporary.iterdir()) == []


@pytest.mark.full_but("export")
@pytest.mark.parametrize(
    "arguments",
    [
        ["replay", "RUN", "--estimator", "least-squares", "--out", "DISK/x"],
        [*PENDULUM, "--only", "--set", SHORT, "--out", "WORK/run", "--ssv", "DISK/x.ssv"],
        ["compare", "pendulum", "--estimators", "none", "--seeds", "1", "--set", SHORT, "--out", "DISK/x"],
        ["illustrate", "--out", "DISK/x.png"],
        pytest.param(["export", "pendulum", "--ssp", "DISK/x.ssp"], marks=pytest.mark.full),
        pytest.param(["build", "--out", "DISK/x"], marks=pytest.mark.full),
    ],
    ids=lambda arguments: arguments[0],
)  # fmt: skip
def test_every_command_for_which_the_disk_has_no_room_says_so_and_has_not_finished(
    arguments, started, undisturbed, temporary, disk, tmp_path
):
    (disk / "filler").write_bytes(bytes(os.statvfs(disk).f_bavail * os.statvfs(disk).f_bsize))
    where = {"RUN": str(undisturbed(*PENDULUM, "--only")), "DISK": str(disk), "WORK": str(tmp_path)}
    for name, path in where.items():
        arguments = [argument.replace(name, path) for argument in arguments]
    code, out, err = ended(started(*arguments))
    assert (code, out, len(err.splitlines())) == (1, "", 1)
    assert re.fullmatch(rf"retune: cannot (write|build into) {disk}/x.*: No space left on device\.\n", err), err
    assert [path.name for path in disk.rglob("*") if path.is_file() and path.stat().st_size] == ["filler"]


@pytest.mark.full
@pytest.mark.parametrize("name", [CHECKPOINT, SERIES])
def test_a_run_whose_files_may_not_grow_goes_on_when_they_may(
    started, undisturbed, temporary, tmp_path, processes, name
):
    """A limit of the system's on the size of a file, below that of one which is still to be written."""
    # Without the second set of FMUs, which is unpacked in mid-run and would be too large itself.
    arguments = [*PENDULUM, "--only", "--set", "guard.lookahead=false"]
    whole, folder = undisturbed(*arguments), tmp_path / "run"
    process = started(*arguments, "--out", folder)
    assert processes[2](lambda: (folder / MANIFEST).exists() or process.poll() is not None, within_s=60.0)
    room = 10_000 if name == CHECKPOINT else size(whole / SERIES) * 7 // 10
    prlimit(process.pid, RLIMIT_FSIZE, (room, room))
    assert_full(ended(process), folder, "File too large")
    assert_readable(whole, folder)
    assert ended(started("resume", folder))[::2] == (0, "")
    assert_same(whole, folder)
    assert list(temporary.iterdir()) == []
