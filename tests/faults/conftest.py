"""One FMU that fails in any way asked of it, and the proof that nothing of it is left after each test."""

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from pythonfmu import FmuBuilder

FAULTY = '''
import ctypes
import os
import sys
import time

from pythonfmu import *


def loop():
    while True:
        pass


def fail(how):
    if how == "raise":
        raise ValueError("boom\\nsecond line")
    return {
        "return False": lambda: False,
        "loop": loop,
        "sleep in C": lambda: ctypes.CDLL(None).sleep(3600),
        "exit 0": lambda: os._exit(0),
        "exit 3": lambda: os._exit(3),
        "segfault": lambda: ctypes.string_at(0),
        "print": lambda: print("hello from inside") or os.write(1, b"and from below\\n"),
        "name": lambda: print("cosim is", sys.modules["cosim"].__file__),
        "child": lambda: os.spawnlp(os.P_NOWAIT, "sleep", "sleep", "3600") and os._exit(0),
        "garbage": lambda: [os.write(fd, b"garbage") for fd in sockets()],
    }[how]()


def sockets():
    for fd in os.listdir("/proc/self/fd"):
        try:
            if os.readlink("/proc/self/fd/" + fd).startswith("socket:"):
                yield int(fd)
        except OSError:
            pass


class Faulty(Fmi2Slave):
    """Fails in the way `how`, in the function `where`, from t = 0.02 s on; until then y = u."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.how = self.where = ""
        self.u = self.y = 0.0
        self.is_due = False
        text = dict(causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed)
        self.register_variable(String("how", **text))
        self.register_variable(String("where", **text))
        self.register_variable(Real("u", causality=Fmi2Causality.input, start=0.0, setter=self.set_u))
        self.register_variable(Real("y", causality=Fmi2Causality.output, getter=self.get_y))
        if self.instance_name.startswith("instantiate: "):
            fail(self.instance_name.removeprefix("instantiate: "))

    def set_u(self, u):
        self.u = u
        self.at("set")

    def get_y(self):
        self.at("get")
        return float("nan") if self.is_due and self.how == "nan" else self.y

    def at(self, where):
        if self.where == where and (self.is_due or "init" in where or where == "terminate"):
            return fail(self.how)

    def enter_initialization_mode(self):
        self.at("enter_init")

    def exit_initialization_mode(self):
        self.at("exit_init")

    def terminate(self):
        self.at("terminate")

    def do_step(self, t, h):
        self.is_due = t > 0.015
        self.y = self.u
        if self.how == "log":
            self.log("100 % of %s and %n and %d at t = %f")
        if self.how == "log a reason and return False" and self.is_due:
            self.log("the step is %s too long", 2)
            return False
        return self.at("do_step") is not False
'''


@pytest.fixture(scope="session")
def faulty(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("faulty")
    script = folder / "running_fmu_faulty.py"
    script.write_text(FAULTY)
    return FmuBuilder.build_FMU(script, dest=folder)


def children_of(process_id: int) -> set[int]:
    """Ids of the processes whose parent is process_id, dead and unburied ones included."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            _, _, rest = (folder / "stat").read_text().rpartition(")")
        except OSError:
            continue
        if int(rest.split()[1]) == process_id:
            found.add(int(folder.name))
    return found


def is_running(process_id: int) -> bool:
    try:
        state = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def becomes_true(condition, within_s: float = 20.0) -> bool:
    """Whether condition() is true at some time within a limit that only a failing test ever reaches."""
    deadline = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture(autouse=True)
def temporary(tmp_path, monkeypatch) -> Iterator[Path]:
    """Where unpacked FMUs go; afterwards neither a file of them nor a process is left."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    before = children_of(os.getpid())
    yield folder
    assert list(folder.iterdir()) == []
    assert children_of(os.getpid()) <= before


@pytest.fixture
def processes():
    """The functions of this file that look at processes."""
    return children_of, is_running, becomes_true
