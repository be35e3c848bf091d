"""A running FMU may do what it likes: the answer is one line that names instance, call and time, and nothing stays."""

import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from cosim.errors import SlaveError
from cosim.fmi.folder import remove_abandoned
from cosim.slaves.slave import Slave, open_slave

pytestmark = [
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for what is left in /proc"),
]
ROOT = Path(__file__).parents[2]
H = 0.01  # s


def run(slave: Slave, how: str, where: str, n_steps: int = 4) -> list[tuple[float, ...]]:
    slave.bind(inputs=["u"], outputs=["y"])
    slave.initialize({"how": how, "where": where})
    return [slave.step([float(k)], t=k * H, h=H) for k in range(n_steps)]


def fault_of(slave: Slave, how: str, where: str) -> SlaveError:
    with slave, pytest.raises(SlaveError) as caught:
        run(slave, how, where)
    with pytest.raises(RuntimeError, match="must not be called after"):
        slave.get()
    return caught.value


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("loop", "instantiate did not return within 1 s"),
        ("exit 0", "the FMU's process ended with exit code 0 in instantiate"),
    ],
    ids=["loop", "exit"],
)
def test_an_fmu_that_fails_while_it_is_instantiated_is_told_in_the_first_call(faulty, how, message):
    timeout = 1.0 if how == "loop" else 20.0
    with open_slave(faulty, f"instantiate: {how}", timeout=timeout) as slave, pytest.raises(SlaveError) as caught:
        slave.bind(outputs=["y"])
    assert re.fullmatch(f"instantiate: {how}: {message}", str(caught.value))


@pytest.mark.parametrize(
    ("how", "where", "message"),
    [
        ("return False", "do_step", "plant: do_step at t = 0.020 s returned discard"),
        ("nan", "", "plant: get at t = 0.030 s: output 'y' is nan"),
    ],
    ids=["discard", "nan"],
)
def test_without_a_process_of_its_own_a_status_is_told_in_the_same_words(faulty, how, where, message):
    # The other faults would end or damage the interpreter that runs this test.
    assert str(fault_of(open_slave(faulty, "plant", isolation="none"), how, where)) == message


def test_the_fault_of_one_fmu_does_not_touch_the_others(faulty):
    with open_slave(faulty, "good") as good, open_slave(faulty, "bad") as bad:
        for slave, how in ((good, ""), (bad, "segfault")):
            slave.bind(inputs=["u"], outputs=["y"])
            slave.initialize({"how": how, "where": "do_step" if how else ""})
        for k in range(2):
            good.begin_step([k], k * H, H)
            bad.begin_step([k], k * H, H)
            assert (good.end_step(), bad.end_step()) == ((k,), (k,))
        good.begin_step([7.0], 2 * H, H)
        bad.begin_step([7.0], 2 * H, H)
        with pytest.raises(SlaveError, match=r"^bad: .*SIGSEGV"):
            bad.end_step()
        assert good.end_step() == (7.0,)


@pytest.mark.parametrize("where", ["set", "do_step", "get"])
def test_a_copy_that_an_fmu_forks_off_answers_nothing(faulty, where):
    with open_slave(faulty, "plant") as slave:
        assert run(slave, "fork once", where, n_steps=20) == [(float(k),) for k in range(20)]


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_percent_signs_in_log_messages_are_only_text(faulty, isolation):
    with open_slave(faulty, "plant", isolation=isolation) as slave:
        assert run(slave, "log", "") == [(0.0,), (1.0,), (2.0,), (3.0,)]


def test_what_an_fmu_prints_goes_to_standard_error(faulty, capfd):
    with open_slave(faulty, "plant") as slave:
        run(slave, "print", "do_step")
    printed = capfd.readouterr()
    assert printed.out == ""
    assert "hello from inside" in printed.err
    assert "and from below" in printed.err


def test_what_an_fmu_prints_stays_in_its_line(faulty, capfd):
    with open_slave(faulty, "plant") as slave:
        run(slave, "escape", "do_step", n_steps=3)
    printed = capfd.readouterr().err
    assert printed == "plant: \\x1b[2Kforged\\rretune: all is well\\x9b\\u2028 20 \u00b0C\tfine\n"


def test_an_fmu_that_may_open_no_more_files_ends_quietly(faulty, capfd):
    with open_slave(faulty, "plant") as slave:
        run(slave, "open no more files", "do_step")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("how", ["raise", "loop", "exit 3"])
def test_a_fault_while_terminating_is_a_warning(faulty, caplog, how):
    slave = open_slave(faulty, "plant")
    run(slave, how, "terminate")
    slave.close()
    slave.close()
    (record,) = caplog.records
    assert re.match("plant: .*(terminate|close) at t = 0.040 s", record.getMessage())


def test_ctrl_c_is_for_the_program_not_for_its_fmus(faulty, processes):
    children_of, _, _ = processes
    before = children_of(os.getpid())
    with open_slave(faulty, "plant") as slave:
        run(slave, "", "")
        (worker,) = children_of(os.getpid()) - before
        assert os.getpgid(worker) != os.getpgid(0)  # a terminal sends the signal to a process group
        os.kill(worker, signal.SIGINT)
        assert slave.step([5.0], 0.04, H) == (5.0,)


def test_an_fmu_that_is_killed_from_outside_is_seen_in_the_next_call(faulty, processes):
    children_of, is_running, becomes_true = processes
    before = children_of(os.getpid())
    with open_slave(faulty, "plant") as slave:
        run(slave, "", "")
        (worker,) = children_of(os.getpid()) - before
        os.kill(worker, signal.SIGKILL)
        assert becomes_true(lambda: not is_running(worker))
        with pytest.raises(
            SlaveError, match=r"^plant: the FMU's process was ended by SIGKILL in do_step at t = 0.040 s$"
        ):
            slave.step([5.0], 0.04, H)


def test_an_interrupted_step_is_closed_at_once(faulty, processes, temporary):
    children_of, is_running, _ = processes
    before = children_of(os.getpid())
    slave = open_slave(faulty, "plant", timeout=3600.0)
    run(slave, "loop", "do_step", n_steps=2)
    (worker,) = children_of(os.getpid()) - before
    slave.begin_step([1.0], 2 * H, H)  # never returns
    assert is_running(worker)
    slave.close()
    assert not is_running(worker)
    assert list(temporary.iterdir()) == []
    with pytest.raises(RuntimeError, match="must not be called after close"):
        slave.end_step()


PROGRAM = """
    import sys, tempfile
    from pathlib import Path
    tempfile.tempdir = sys.argv[2]
    from cosim.slaves.slave import open_slave
    slave = open_slave(Path(sys.argv[1]), "plant", timeout=3600.0)
    slave.bind(inputs=["u"], outputs=["y"])
    slave.initialize({"how": sys.argv[3], "where": "do_step" if sys.argv[3] else ""})
    for k in range(2):
        slave.step([0.0], k * 0.01, 0.01)
    print("ready", flush=True)
"""


def test_the_process_imports_the_cosim_of_the_program_and_nothing_from_its_folder(faulty, temporary, tmp_path):
    """Also when it is importable only because the program has extended sys.path."""
    elsewhere, folder = tmp_path / "elsewhere", tmp_path / "folder"
    shutil.copytree(ROOT / "cosim", elsewhere / "cosim", ignore=shutil.ignore_patterns("__pycache__"))
    folder.mkdir()
    (folder / "struct.py").write_text("raise SystemExit('a module of the working directory was imported')")
    words = f"import sys; sys.path.insert(0, {str(elsewhere)!r})\n" + textwrap.dedent(PROGRAM)
    program = subprocess.run(
        [sys.executable, "-P", "-c", words + "slave.step([0.0], 0.02, 0.01)", faulty, temporary, "name"],
        cwd=folder,
        capture_output=True,
        check=False,
        text=True,
    )
    assert (program.returncode, program.stdout) == (0, "ready\n")
    assert f"cosim is {elsewhere / 'cosim'}" in program.stderr


def start_program(faulty: Path, temporary: Path, how: str, last_words: str) -> subprocess.Popen:
    """A program that runs an FMU, up to its line 'ready'; then it executes last_words."""
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PROGRAM) + last_words, faulty, temporary, how],
        stdout=subprocess.PIPE,
        cwd=ROOT,
    )
    assert process.stdout.readline() == b"ready\n"
    return process


@pytest.mark.parametrize("how", ["", "loop", "sleep in C"], ids=["idle", "looping", "waiting in C"])
def test_no_fmu_outlives_a_program_that_is_killed(faulty, temporary, processes, how):
    children_of, is_running, becomes_true = processes
    words = "import time; slave.begin_step([0.0], 0.02, 0.01) if sys.argv[3] else None; time.sleep(3600)"
    with start_program(faulty, temporary, how, words) as program:
        (worker,) = children_of(program.pid)
        program.kill()
    assert becomes_true(lambda: not is_running(worker))
    assert becomes_true(lambda: not list(temporary.iterdir()))


@pytest.mark.full
@pytest.mark.parametrize("how", ["compute in C", "sleep in C and let no Python run"])
def test_nor_does_one_that_lets_no_other_python_code_run(faulty, temporary, processes, how):
    """Nobody is left to remove its folder, but nobody holds it either."""
    children_of, is_running, becomes_true = processes
    words = (
        "import time; slave.begin_step([0.0], 0.02, 0.01); time.sleep(0.5); print('ready', flush=True); time.sleep(60)"
    )
    with start_program(faulty, temporary, how, words) as program:
        (worker,) = children_of(program.pid)
        assert program.stdout.readline() == b"ready\n"
        program.kill()
    assert becomes_true(lambda: not is_running(worker), within_s=40.0)
    remove_abandoned(str(temporary))
    assert not list(temporary.iterdir())


@pytest.mark.full_but("exception")
@pytest.mark.parametrize("words", ["", "raise SystemExit(3)", "1 / 0"], ids=["end", "exit", "exception"])
def test_a_program_that_forgets_to_close_leaves_nothing(faulty, temporary, words):
    program = start_program(faulty, temporary, "", f"import sys; sys.stderr = open('/dev/null', 'w')\n{words}")
    program.communicate(timeout=60)
    assert list(temporary.iterdir()) == []


def test_standard_output_of_a_program_is_its_own(faulty, temporary):
    with start_program(faulty, temporary, "print", "slave.step([0.0], 0.02, 0.01); print('result')") as program:
        assert program.stdout.read() == b"result\n"
