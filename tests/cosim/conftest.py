"""FMUs that are not built in, scenarios of them, and the proof that nothing of a run is left."""

import os
import re
import shutil
import signal
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path

import fmpy
import pytest
from pythonfmu import FmuBuilder

from benchmarks.native_fmus import FOREIGN, SOURCES, build_foreign
from cosim.cli import main
from cosim.scenarios.scenario import Scenario


def children_of(process_id: int) -> set[int]:
    """Ids of the processes whose parent is process_id, dead and unburied ones included."""
    found = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process_id:
            found.add(int(folder.name))
    return found


@pytest.fixture
def children() -> Callable[[], set[int]]:
    """Ids of this process's children at the time of the call."""
    return lambda: children_of(os.getpid())


@pytest.fixture
def leaves_nothing(tmp_path, monkeypatch) -> Iterator[Path]:
    """Where this test and its child processes keep temporary files; afterwards it is empty and no child is left."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    before = children_of(os.getpid())
    yield folder
    assert list(folder.iterdir()) == []
    assert children_of(os.getpid()) <= before


@pytest.fixture
def becomes_true() -> Callable[..., bool]:
    """Whether condition() is true at some time within a limit that only a failing test ever reaches."""

    def wait_for(condition: Callable[[], object], within_s: float = 60.0) -> bool:
        deadline = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True

    return wait_for


@pytest.fixture
def pendulum() -> Callable[..., Scenario]:
    """The named pendulum scenario over 0.5 s, with further settings replaced."""

    def load(overrides: dict[str, str] | None = None, stop_time: float = 0.5) -> Scenario:
        return Scenario.load("pendulum", {"scenario.stop_time": repr(stop_time)} | (overrides or {}))

    return load


FAULTY_REFERENCE = """
from pythonfmu import *


class FaultyReference(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.phi_ref = self.phi_dot_ref = 0.0
        for name in ("phi_ref", "phi_dot_ref"):
            self.register_variable(Real(name, causality=Fmi2Causality.output))

    def do_step(self, t, h):
        if t > 0.045:
            raise ValueError("boom\\nsecond line")
        return True
"""


@pytest.fixture(scope="session")
def faulty_reference(made_once) -> Path:
    """An FMU that raises in its sixth step of 10 ms; it has none of PendulumReference's parameters."""

    def make(folder: Path) -> None:
        script = folder / "faulty_reference.py"
        script.write_text(FAULTY_REFERENCE)
        FmuBuilder.build_FMU(script, dest=folder)

    return made_once(make, FAULTY_REFERENCE) / "FaultyReference.fmu"


@pytest.fixture
def faulty_toml(faulty_reference, tmp_path) -> Path:
    """The pendulum scenario with this reference."""
    text = (files("cosim") / "scenarios" / "pendulum.toml").read_text(encoding="utf-8")
    old = next(line for line in text.splitlines() if line.startswith("reference = "))
    path = tmp_path / "faulty.toml"
    path.write_text(text.replace(old, f"reference = {{ fmu = '{faulty_reference}' }}"), encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def foreign(made_once) -> Path:
    """A folder with FMUs that are not of our making, compiled here: see build_foreign."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")
    return made_once(build_foreign, SOURCES, FOREIGN)


@pytest.fixture
def axis(foreign, tmp_path) -> Callable[..., Path]:
    """axis((old, new), ...): the path of tests/foreign/axis.toml, of which these texts are replaced, beside its files.

    The mass jumps from 2 to 3 kg; the position is to be 1 m, or what `steps` says, rows of time, position and velocity.
    """
    for name in ("Axis.fmu", "AxisController.fmu"):
        (tmp_path / name).symlink_to(foreign / name)
    shutil.copy(FOREIGN / "axis_model.py", tmp_path)

    def write(*replacements: tuple[str, str], steps: str = "0, 1, 0\n1, 1, 0") -> Path:
        (tmp_path / "steps.csv").write_text(f"time [s], s_ref [m], v_ref [m/s]\n{steps}\n")
        text = (FOREIGN / "axis.toml").read_text()
        for old, new in replacements:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (tmp_path / "axis.toml").write_text(text)
        return tmp_path / "axis.toml"

    return write


@pytest.fixture
def bare_axis(foreign, tmp_path) -> Path:
    """Axis.fmu as a tool leaves it that declares no derivatives: its outputs are position and velocity, no more."""
    with zipfile.ZipFile(foreign / "Axis.fmu") as whole:
        files = {name: whole.read(name) for name in whole.namelist()}
    xml = files["modelDescription.xml"].decode()
    for name in ("der(mass.s)", "der(mass.v)"):
        xml, n = re.subn(rf'<ScalarVariable name="{re.escape(name)}".*?</ScalarVariable>', "", xml, flags=re.S)
        assert n == 1
    structure = '<ModelStructure><Outputs><Unknown index="2"/><Unknown index="3"/></Outputs></ModelStructure>'
    files["modelDescription.xml"] = re.sub("<ModelStructure>.*</ModelStructure>", structure, xml, flags=re.S).encode()
    with zipfile.ZipFile(tmp_path / "BareAxis.fmu", "w") as bare:
        for name, content in files.items():
            bare.writestr(name, content)
    return tmp_path / "BareAxis.fmu"


UNITS = """<UnitDefinitions><Unit name="m"><BaseUnit m="1"/></Unit>
<Unit name="mm"><BaseUnit m="1" factor="0.001"/></Unit>
<Unit name="kg"><BaseUnit kg="1"/></Unit><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>
<Unit name="W"><BaseUnit kg="1" m="2" s="-3"/></Unit><Unit name="K"><BaseUnit K="1"/></Unit>
<Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit><Unit name="tick"/></UnitDefinitions>"""


@pytest.fixture
def described(tmp_path) -> Callable[..., Path]:
    """Writes an FMU that has a model description and an empty library, for what only reads it."""

    def write(
        variables: str,
        structure: str = "",
        name: str = "Model",
        interface: str = "",
        library: str = "",
        experiment: str = "",
    ) -> Path:
        path = tmp_path / f"{name}.fmu"
        xml = (
            f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="1">'
            f'<CoSimulation modelIdentifier="{name}" {interface}/>'
            f"{UNITS}{f'<DefaultExperiment {experiment}/>' if experiment else ''}"
            f"<ModelVariables>{variables}</ModelVariables><ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
        )
        with zipfile.ZipFile(path, "w") as fmu:
            fmu.writestr("modelDescription.xml", xml)
            library = library or f"{fmpy.platform}/{name}{fmpy.sharedLibraryExtension}"
            fmu.writestr(f"binaries/{library}", b"")
        return path

    return write


@pytest.fixture
def workplace(tmp_path, monkeypatch):
    """An empty folder to work in; what the command changes in this process is put back."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    handler, environment = signal.getsignal(signal.SIGTERM), dict(os.environ)
    yield folder
    signal.signal(signal.SIGTERM, handler)
    os.environ.clear()
    os.environ.update(environment)


@pytest.fixture
def called(capfd):
    """The command in this process: exit code, standard output, standard error."""

    def call(*arguments):
        try:
            code = main([str(a) for a in arguments])
        except SystemExit as leaving:
            code = leaving.code
        output = capfd.readouterr()
        return code, output.out, output.err

    return call
