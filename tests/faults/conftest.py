"""FMUs that fail in any way asked of them, and what must hold after every fault, whatever it is.

A test of any kind of fault has the latter by itself: it ends in time, nothing is left, nothing of ours is changed.
"""

import ctypes
import fcntl
import locale
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import fmpy
import pytest
import threadpoolctl  # noqa: F401  it sets a variable of the environment when it is first imported
from pythonfmu import FmuBuilder

from cosim.cli import main

HERE = Path(__file__).parent
LONGEST_S = 180  # of a test on a busy machine: only one that hangs takes it

FAULTY = '''
import ctypes
import locale
import os
import resource
import signal
import sys
import threading
import time

from pythonfmu import *
from pythonfmu.enums import Fmi2Status


forked = []


def loop():
    while True:
        pass


def recurse(n):
    return recurse(n + 1) + 1


def throw(error):
    raise error


def allocate():
    kept = []
    while True:
        kept.append(bytearray(b"x") * (1 << 24))


def change_everything():
    os.chdir("/")
    os.environ.clear()
    os.umask(0)
    locale.setlocale(locale.LC_ALL, "C")
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.path.clear()
    sys.setrecursionlimit(100)
    sys.modules.pop("cosim.errors", None)
    ctypes.CDLL("libm.so.6").fesetround(0x800)


def break_output():
    sys.stdout = sys.stderr = None
    sys.excepthook = None


def fail(how):
    if how == "raise":
        raise ValueError("boom\\nsecond line")
    return {
        "return False": lambda: False,
        "loop": loop,
        "escape": lambda: print("\\x1b[2Kforged\\rretune: all is well\\x9b\\u2028", "20 \\u00b0C\\tfine", flush=True),
        "open no more files": lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (0, 0)),
        "fork once": lambda: forked or forked.append(os.fork()),
        "compute in C": lambda: sum(range(10**13)),
        "sleep in C and let no Python run": lambda: [ctypes.PyDLL(None).sleep(3600) for _ in range(10)],
        "sleep in C": lambda: ctypes.CDLL(None).sleep(3600),
        "exit 0": lambda: os._exit(0),
        "exit 3": lambda: os._exit(3),
        "segfault": lambda: ctypes.string_at(0),
        "print": lambda: print("hello from inside") or os.write(1, b"and from below\\n"),
        "print environment": lambda: print(*sorted(os.environ), sep="\\n", flush=True),
        "name": lambda: print("cosim is", sys.modules["cosim"].__file__),
        "child": lambda: os.spawnlp(os.P_NOWAIT, "sleep", "sleep", "3600") and os._exit(0),
        "garbage": lambda: [os.write(fd, b"garbage") for fd in sockets()],
        "leave": lambda: sys.exit(0),
        "interrupt": lambda: throw(KeyboardInterrupt("mine")),
        "out of memory": lambda: throw(MemoryError("mine")),
        "recurse": lambda: recurse(0),
        "kill itself": lambda: (os.kill(os.getpid(), signal.SIGTERM), time.sleep(100)),
        "close descriptors": lambda: (os.closerange(0, 256), time.sleep(100)),
        "allocate": allocate,
        "read input": lambda: input(),
        "change everything": change_everything,
        "break Python's output": break_output,
        "start a thread": lambda: threading.Thread(target=loop, daemon=False).start(),
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
        self.is_due = self.has_failed = False
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
        odd = {"nan": float("nan"), "text": "seven", "None": None}
        return odd[self.how] if self.is_due and self.how in odd else self.y

    def at(self, where):
        if self.has_failed:
            with open(os.environ["PYTHON_FAULT_MARKER"], "a") as notes:
                notes.write(where)
        if self.where == where and self.how in ("nan", "text", "None"):
            return None
        if self.where == where and (self.is_due or "init" in where or where == "terminate"):
            self.has_failed = "PYTHON_FAULT_MARKER" in os.environ
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
            self.log("the step is %s too long", Fmi2Status.error)
            return False
        return self.at("do_step") is not False
'''


@pytest.fixture(scope="session")
def faulty(made_once) -> Path:
    def make(folder: Path) -> None:
        script = folder / "running_fmu_faulty.py"
        script.write_text(FAULTY)
        FmuBuilder.build_FMU(script, dest=folder)

    return made_once(make, FAULTY) / "Faulty.fmu"


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
    """Where unpacked FMUs go; afterwards neither a file of them nor a process is left, and the test has ended in time.

    Nor is a file left in the working directory, or is anything changed that belongs to this process.
    """
    folder, work = tmp_path / "temporary", tmp_path / "working directory"
    folder.mkdir()
    work.mkdir()
    before, surroundings = children_of(os.getpid()), ours()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.chdir(work)
    # FMUs' processes are given what begins with PYTHON.
    mark = f"PYTHON_FAULT_TEST={tmp_path.name}-{os.getpid()}"
    monkeypatch.setenv(*mark.split("="))
    with ended_in_time():
        yield folder
    assert becomes_true(lambda: list(folder.iterdir()) == [], within_s=20.0)
    assert list(work.iterdir()) == []
    assert children_of(os.getpid()) <= before
    assert becomes_true(lambda: not marked(mark), within_s=20.0)
    monkeypatch.undo()
    assert ours() == surroundings


@pytest.fixture
def command(monkeypatch, capfd) -> Callable[..., tuple[int, str, str]]:
    """The command `retune` in this process: exit code, standard output, standard error. What it changes is put back."""

    def call(*arguments: object) -> tuple[int, str, str]:
        environment, names = dict(os.environ), (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        handlers = {number: signal.getsignal(number) for number in names}
        capfd.readouterr()
        try:
            code = main([str(a) for a in arguments])
        except SystemExit as leaving:
            code = leaving.code
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
            for name in os.environ.keys() - environment.keys():
                del os.environ[name]
        return code, *capfd.readouterr()

    return call


@contextmanager
def ended_in_time() -> Iterator[None]:
    """Raises where what is inside takes LONGEST_S."""

    def out_of_time(*_: object) -> None:
        raise AssertionError(f"it has not ended within {LONGEST_S} s")

    handler = signal.signal(signal.SIGALRM, out_of_time)
    signal.alarm(LONGEST_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, handler)


def marked(entry: str) -> set[int]:
    """Ids of other processes with this in their environment: descendants of this test, however they were made."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            is_one = entry.encode() in (folder / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if is_one and is_running(int(folder.name)) and int(folder.name) != os.getpid():
            found.add(int(folder.name))
    return found


def ours() -> dict[str, object]:
    """What an FMU must not change of this process."""
    flags = {fd: fcntl.fcntl(fd, fcntl.F_GETFL) for fd in (0, 1, 2)}
    return {
        "environment": {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"},
        "directory": os.getcwd(),
        "signals": [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGSEGV, signal.SIGFPE)],
        "locale": locale.setlocale(locale.LC_ALL),
        "rounding": ctypes.CDLL("libm.so.6").fegetround() if sys.platform == "linux" else 0,
        "denormals": 5e-324 * 1.0 > 0.0,
        "files": flags,
    }


@pytest.fixture(scope="session")
def compiled(made_once) -> Callable[..., bytes]:
    """compiled(*options): the library of native.c, compiled with gcc's options."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")
    source = HERE / "native.c"

    def library(*options: str) -> bytes:
        def make(folder: Path) -> None:
            headers = f"-I{Path(fmpy.__file__).parent / 'c-code'}"
            common = ["-O1", "-w", "-fstack-protector-all", headers, "-o", folder / "native.so", source]
            subprocess.run(["gcc", *(options or ("-shared", "-fPIC")), *common, "-lm", "-lpthread"], check=True)

        return (made_once(make, source, options) / "native.so").read_bytes()

    return library


@pytest.fixture(scope="session")
def native(compiled, tmp_path_factory) -> Path:
    """A sound FMU in C, which fails as it is told."""
    path = tmp_path_factory.mktemp("sound") / "Native.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as fmu:
        fmu.write(HERE / "native.xml", "modelDescription.xml")
        fmu.writestr(f"binaries/{fmpy.platform}/Native{fmpy.sharedLibraryExtension}", compiled())
    return path


@pytest.fixture
def processes():
    """The functions of this file that look at processes."""
    return children_of, is_running, becomes_true
