"""Folders of unpacked FMUs: gone however the process ends, and never another's."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from cosim.fmi.folder import PREFIX, PrivateFolder, remove_abandoned

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="locks folders with flock")
ROOT = Path(__file__).parents[2]


def start(program: str, *arguments: object, stderr=None) -> subprocess.Popen:
    """A program, up to its line 'ready'."""
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program), *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=stderr, cwd=ROOT, text=True,
    )  # fmt: skip
    assert process.stdout.readline() == "ready\n"
    return process


HOLDER = """
    import sys, tempfile, time
    tempfile.tempdir = sys.argv[1]
    from cosim.fmi.folder import PrivateFolder
    folder = PrivateFolder()
    open(folder.path + "/x", "w").close()
    print("ready", flush=True)
    while True: time.sleep(0.05)  # a long sleep overlooks a signal that comes just before it
"""

WRITER = """
    import sys, time
    print("ready", flush=True)
    k, end = 0, time.monotonic() + 1.0
    while time.monotonic() < end:
        k += 1
        open(f"{sys.argv[1]}/{k}", "w").close()
"""

BUILDER = """
    import os, sys, tempfile, time
    from pathlib import Path
    tempfile.tempdir = sys.argv[1]
    os.environ["FMU_RETUNE_CACHE"] = sys.argv[1] + "-cache"
    from cosim.system.fmu_cache import build_into, find_fmu
    from fmu_models import build
    def wait(*_, **__):
        print("ready", flush=True)
        while True: time.sleep(0.05)  # a long sleep overlooks a signal that comes just before it
    build.FmuBuilder.build_FMU = wait
    {call}
"""


def test_what_a_killed_process_leaves_is_removed_by_the_next_and_not_before(temporary):
    with start(HOLDER, temporary) as process:
        (folder,) = temporary.iterdir()
        assert folder.name.startswith(PREFIX)
        remove_abandoned(str(temporary))
        assert (folder / "x").exists()
        process.kill()
    assert (folder / "x").exists()  # nobody was left to do it
    with start(HOLDER, temporary) as another:
        (its_own,) = temporary.iterdir()
        assert its_own != folder
        another.kill()
    remove_abandoned(str(temporary))
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize(
    "call", ['find_fmu("Pendulum", Path())', 'build_into(Path(sys.argv[1]).parent / "fmus", False)']
)
def test_what_a_killed_build_leaves_is_removed_by_the_next(temporary, call):
    with start(BUILDER.format(call=call), temporary) as process:
        assert any(path.name == "source" for path in temporary.rglob("*"))
        process.kill()
    remove_abandoned(str(temporary))
    assert list(temporary.iterdir()) == []


def test_a_folder_is_removed_that_an_orphan_still_writes_to_for_a_moment(temporary):
    folder = PrivateFolder()
    with start(WRITER, folder.path, stderr=subprocess.DEVNULL) as orphan:
        deadline = time.monotonic() + 60.0
        while not os.path.exists(f"{folder.path}/20") and time.monotonic() < deadline:
            time.sleep(0.001)
        folder.remove()
        orphan.wait(60.0)
    assert list(temporary.iterdir()) == []


def test_what_is_not_ours_is_left_alone(temporary, tmp_path):
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "x").touch()
    (temporary / f"{PREFIX}link").symlink_to(theirs)
    (temporary / f"{PREFIX}file").touch()
    (temporary / "fmu-retune-of-an-older-version").mkdir()
    remove_abandoned(str(temporary))
    assert (theirs / "x").exists()
    assert len(list(temporary.iterdir())) == 3
    for path in temporary.iterdir():
        path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()


@pytest.mark.skipif(sys.platform == "win32" or os.getuid() != 0, reason="gives a folder to somebody else")
def test_another_users_folder_is_left_alone_even_by_root(temporary):
    folder = temporary / f"{PREFIX}0"
    folder.mkdir()
    os.chown(folder, 12345, 12345)
    remove_abandoned(str(temporary))
    assert folder.exists()
    folder.rmdir()


def test_a_forgotten_folder_is_removed(temporary):
    folder = PrivateFolder()
    assert len(list(temporary.iterdir())) == 1
    del folder
    assert list(temporary.iterdir()) == []


def test_a_fork_removes_nothing_of_its_parent(temporary):
    with PrivateFolder() as path:
        if (child := os.fork()) == 0:
            import atexit

            atexit._run_exitfuncs()
            os._exit(0)
        os.waitpid(child, 0)
        assert Path(path).is_dir()


HANGUP = pytest.param(
    signal.SIGHUP,
    marks=pytest.mark.skipif(signal.getsignal(signal.SIGHUP) is signal.SIG_IGN, reason="ignored, as below nohup"),
)
UNPACKING = """
    import sys, tempfile, time, zipfile
    tempfile.tempdir = sys.argv[1]
    extract = zipfile.ZipFile.extractall

    def slowly(self, *arguments):
        extract(self, *arguments)
        print("ready", flush=True)
        while True: time.sleep(0.05)  # a long sleep overlooks a signal that comes just before it

    from cosim.cli import main
    zipfile.ZipFile.extractall = slowly
    sys.exit(main(["doctor", sys.argv[2]]))
"""
CLOSING = """
    import shutil, sys, tempfile, time, zipfile
    tempfile.tempdir = sys.argv[1]
    remove = shutil.rmtree

    def told(self, *arguments):
        print("ready", flush=True)
        while True: time.sleep(0.05)  # a long sleep overlooks a signal that comes just before it

    def slowly(*arguments, **options):
        time.sleep(0.5)
        remove(*arguments, **options)

    from cosim.cli import main
    zipfile.ZipFile.extractall, shutil.rmtree = told, slowly
    sys.exit(main(["doctor", sys.argv[2]]))
"""
STARTING = """
    import sys, time
    from cosim import cli

    def slowly():
        print("ready", flush=True)
        while True: time.sleep(0.05)  # a long sleep overlooks a signal that comes just before it

    cli.make_parser = slowly
    sys.exit(cli.main(["scenarios"]))
"""


@pytest.mark.fmu
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, HANGUP])
def test_a_command_that_is_ended_while_it_unpacks_leaves_nothing(native, temporary, number):
    with start(UNPACKING, temporary, native, stderr=subprocess.PIPE) as process:
        assert len(list(temporary.iterdir())) == 1
        process.send_signal(number)
        out, err = process.communicate(timeout=50)
    assert (process.returncode, out, err.count("\n")) == (130, "", 1)
    assert err.startswith("retune: interrupted")
    assert list(temporary.iterdir()) == []


@pytest.mark.fmu
@pytest.mark.parametrize("numbers", [[signal.SIGTERM] * 2, [signal.SIGINT] * 40])
def test_further_signals_do_not_cut_the_clearing_up_short(native, temporary, numbers):
    """They come while it clears up, and while the interpreter ends."""
    with start(CLOSING, temporary, native, stderr=subprocess.PIPE) as process:
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.01)
        out, err = process.communicate(timeout=50)
    assert (process.returncode, out) == (130, "")
    assert err == "retune: interrupted\n"  # no run has begun
    assert list(temporary.iterdir()) == []


def test_a_signal_is_an_interrupt_from_the_first_line_of_the_command_on(temporary):
    """Also before the options are known."""
    with start(STARTING, stderr=subprocess.PIPE) as process:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=50)
    assert (process.returncode, out, err.count("\n")) == (130, "", 1)
