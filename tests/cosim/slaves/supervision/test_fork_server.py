"""FMUs' processes that are copies of a server: each is a child of ours, alone with its FMU, and nothing is left."""

import os
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, nullcontext
from pathlib import Path

import pytest

from cosim import Scenario, run
from cosim.errors import SlaveError
from cosim.slaves.slave import open_slave
from cosim.slaves.supervision import fork_server
from cosim.slaves.supervision.fork_server import forked_processes
from cosim.system.fmu_cache import fmu_paths

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")]

COUNTING = """
import builtins
import os
from pathlib import Path

from pythonfmu import Fmi2Causality, Fmi2Slave, Real


class Counting(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        builtins.n_instances = getattr(builtins, "n_instances", 0) + 1
        self.n = float(builtins.n_instances)
        self.parent = float(os.getppid())
        self.group = float(os.getpgid(0) == os.getpid())
        self.mark = float(int(os.environ["FMU_RETUNE_PROCESS"], 16) >> 16)
        self.shown = float(int(shown("self"), 16) >> 16)
        self.folder = float(os.stat(".").st_ino)
        self.told = float(os.environ.get("PYTHON_TOLD", 0))
        for name in ("n", "parent", "group", "mark", "shown", "folder", "told"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        if step_size > 1.0:
            os._exit(3)
        if step_size > 0.5:
            os.abort()
        return True


def shown(process):
    found = Path(f"/proc/{process}/environ").read_bytes().split(b"\\0")
    return next(e.partition(b"=")[2].decode() for e in found if e.startswith(b"FMU_RETUNE_PROCESS="))
"""
NAMES = ["n", "parent", "group", "mark", "shown", "folder", "told"]


@pytest.fixture(scope="module")
def counting(made_once):
    def make(folder):
        script = folder / "counting.py"
        script.write_text(COUNTING, encoding="utf-8")
        command = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", folder]
        environment = os.environ | {"FMU_RETUNE_PROCESS": "0" * 16}
        subprocess.run(command, check=True, capture_output=True, env=environment)

    return made_once(make, COUNTING) / "Counting.fmu"


def outputs_of(slave):
    slave.bind(outputs=NAMES)
    slave.initialize({})
    return dict(zip(NAMES, slave.get(), strict=True))


@pytest.fixture
def servers(children):
    """The children of this process that are fork servers."""

    def is_server(process):
        return b"fork_server_child" in Path(f"/proc/{process}/cmdline").read_bytes()

    return lambda: {p for p in children() if is_server(p)}


def test_each_is_a_child_of_ours_with_a_group_and_a_mark_of_its_own(counting, servers):
    with forked_processes():
        with open_slave(counting, "a") as a, open_slave(counting, "b") as b:
            found = [outputs_of(a), outputs_of(b)]
        assert len(servers()) == 1
    for outputs in found:
        assert (outputs["parent"], outputs["group"]) == (os.getpid(), 1.0)
        assert outputs["mark"] == outputs["shown"] > 0.0
    assert found[0]["mark"] != found[1]["mark"]
    assert servers() == set()


def test_a_context_within_another_takes_them_from_its_server_and_leaves_it(counting, servers):
    with forked_processes():
        for _ in range(2):
            with forked_processes(), open_slave(counting, "a") as slave:
                assert outputs_of(slave)["n"] == 1.0
        assert len(servers()) == 1
    assert servers() == set()


def test_a_server_that_begins_at_once_is_the_one_that_is_used(counting, servers):
    with forked_processes(()):
        begun = servers()
        assert len(begun) == 1
        with open_slave(counting, "a") as slave:
            assert outputs_of(slave)["n"] == 1.0
        assert servers() == begun
    assert servers() == set()


def test_a_run_starts_python_once_for_its_fmus_and_for_the_loop_ahead(monkeypatch):
    started = []

    class Counted(subprocess.Popen):
        def __init__(self, command, **kwargs):
            started.append(command)
            super().__init__(command, **kwargs)

    scenario = Scenario.load("pendulum", {"scenario.stop_time": "0.05"})
    fmu_paths(scenario)  # which may have to be built, in processes
    monkeypatch.setattr(subprocess, "Popen", Counted)
    assert run(scenario, "target").status == "done"
    assert len(started) == 1


def test_processes_go_on_after_their_server(counting, servers):
    with ExitStack() as stack:
        with forked_processes():
            slave = stack.enter_context(open_slave(counting, "a"))
            assert len(servers()) == 2, "the server and its copy, which looks like it"
        assert len(servers()) == 1
        assert outputs_of(slave)["n"] == 1.0
    assert servers() == set()


def test_none_finds_what_an_earlier_one_has_left_in_the_interpreter(counting):
    n_open = []
    with forked_processes():
        for _ in range(3):
            with open_slave(counting, "a") as slave:
                assert outputs_of(slave)["n"] == 1.0
            n_open.append(len(os.listdir("/proc/self/fd")))
    assert n_open[0] == n_open[2], "files are left open"


def test_each_has_the_working_folder_and_the_environment_of_its_time(counting, tmp_path, monkeypatch):
    with forked_processes():
        with open_slave(counting, "a") as slave:
            assert outputs_of(slave)["told"] == 0.0
        monkeypatch.chdir(tmp_path)
        with open_slave(counting, "a") as slave:
            assert outputs_of(slave)["folder"] == tmp_path.stat().st_ino
        monkeypatch.setenv("PYTHON_TOLD", "7")
        with open_slave(counting, "a") as slave:
            assert outputs_of(slave)["told"] == 7.0


@pytest.mark.parametrize(("h", "how"), [(2.0, "ended with exit code 3"), (0.75, "was ended by SIGABRT")])
def test_how_it_ended_is_known(counting, h, how):
    with forked_processes(), open_slave(counting, "a") as slave:
        outputs_of(slave)
        with pytest.raises(SlaveError, match=how):
            slave.step([], 0.0, h)


def test_where_the_server_has_died_the_next_is_started_as_any_process(counting, servers):
    with forked_processes():
        with open_slave(counting, "a") as slave:
            outputs_of(slave)
        (server,) = servers()
        os.kill(server, signal.SIGKILL)
        for _ in range(2):
            with open_slave(counting, "a") as slave:
                assert outputs_of(slave)["n"] == 1.0
        assert servers().isdisjoint({server})


def test_a_copy_that_is_not_known_here_does_not_answer_in_the_place_of_the_next(counting, monkeypatch, children):
    def unknown(pid, lifeline):
        known.append(pid)
        raise OSError("no such thing")

    known = []
    monkeypatch.setattr(fork_server, "ForkedProcess", unknown)
    with forked_processes(), open_slave(counting, "a") as slave:
        assert outputs_of(slave)["n"] == 1.0
        assert os.waitstatus_to_exitcode(os.waitpid(known[0], 0)[1]) == 0


def test_where_no_child_can_be_adopted_processes_are_started_as_any(counting, monkeypatch):
    monkeypatch.setattr(fork_server, "_children_adopted", nullcontext)
    with forked_processes(), open_slave(counting, "a") as slave:
        outputs = outputs_of(slave)
    assert (outputs["n"], outputs["parent"]) == (1.0, os.getpid())


def test_orphans_of_other_programs_are_not_given_to_this_process(counting, children):
    """They go to the system's first process, which waits for them: here they would stay zombies."""
    with forked_processes(), open_slave(counting, "a") as slave:
        outputs_of(slave)
        program = "import subprocess, sys; print(subprocess.Popen(['sleep', '60'], stdout=-3, stderr=-3).pid)"
        orphan = int(subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout)
        assert orphan not in children()
        os.kill(orphan, signal.SIGKILL)


def test_other_threads_and_forks_of_this_process_start_theirs_themselves(counting):
    found = []

    def opened():
        with open_slave(counting, "b") as slave:
            found.append(outputs_of(slave)["n"])

    with forked_processes(), open_slave(counting, "a") as slave:
        outputs_of(slave)
        thread = threading.Thread(target=opened)
        thread.start()
        thread.join()
        if (copy := os.fork()) == 0:
            try:
                opened()
                os._exit(0 if found == [1.0, 1.0] else 1)
            finally:
                os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(copy, 0)[1]) == 0
        assert slave.step([], 0.0, 0.1)[0] == 1.0


def test_where_the_program_is_killed_server_and_fmus_end(counting, tmp_path, becomes_true):
    program = f"""
import os, signal, sys
from cosim.slaves.slave import open_slave
from cosim.slaves.supervision import fork_server
from cosim.slaves.supervision.fork_server import forked_processes
from cosim.system.fmu_cache import fmu_paths
with forked_processes(), open_slave({str(counting)!r}, "a") as slave:
    slave.bind(outputs=["n"])
    slave.initialize({{}})
    print(*(p for t in os.listdir("/proc/self/task") for p in open(f"/proc/self/task/{{t}}/children").read().split()))
    sys.stdout.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment)
    processes = [Path("/proc", p) for p in result.stdout.split()]
    assert len(processes) == 2
    assert becomes_true(lambda: not any(p.exists() for p in processes))
    assert becomes_true(lambda: not list(tmp_path.iterdir()))
