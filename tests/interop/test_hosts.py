"""FMUs in Python under a host that is not Python: a small C program, with and without libpython preloaded."""

import csv
import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from importlib.util import find_spec
from pathlib import Path

import fmpy
import numpy as np
import pytest
from find_libpython import find_libpython

from cosim import open_slave
from fmu_models.build import NAMES, build_all

pytestmark = [
    pytest.mark.full,
    pytest.mark.interop,
    pytest.mark.fmu,
    pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD is Linux's"),
    pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler: gcc is not installed"),
]

LIBPYTHON = find_libpython() if sys.platform == "linux" else None
HERE = Path(sys.executable).parent
QUIET_END = {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=65535"}  # see docs/commands.md
needs_libpython = pytest.mark.skipif(LIBPYTHON is None, reason="this Python was built without a shared library")

SLAVE = '''
import os, sys
import only_here
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class Where(Fmi2Slave):
    """Tells where it runs."""
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.y = 1.0
        self.register_variable(Real("y", causality=Fmi2Causality.output))
        if "logger" in kwargs:
            print(sys.prefix, sys.version_info[:2], only_here.__file__, file=sys.stderr, flush=True)
    def do_step(self, t, h):
        return True
'''


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    """Runs the C program on an FMU; `prefix` is a command that starts it."""
    folder = tmp_path_factory.mktemp("host")
    source = Path(__file__).with_name("host.c")
    subprocess.run(["gcc", "-Wall", "-Werror", "-o", folder / "host", source, "-ldl"], check=True)

    def start(fmu, *arguments, environment=None, prefix=""):
        unpacked = folder / f"{fmu.stem}-{len(list(folder.iterdir()))}"
        with zipfile.ZipFile(fmu) as archive:
            archive.extractall(unpacked)
        description = fmpy.read_model_description(fmu)
        library = unpacked / "binaries" / "linux64" / f"{description.coSimulation.modelIdentifier}.so"
        resources = (unpacked / "resources").as_uri()
        command = [folder / "host", library, description.guid, resources, *arguments]
        line = f"{prefix} {' '.join(map(str, command))}"
        variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "PYTHONHOME")} | (environment or {})
        return subprocess.run(["sh", "-c", line], capture_output=True, text=True, env=variables, timeout=60)

    return start


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    return build_all(tmp_path_factory.mktemp("fmus"))


def references(fmu, causality):
    variables = fmpy.read_model_description(fmu).modelVariables
    return {v.name: v.valueReference for v in variables if v.causality == causality and v.type == "Real"}


def trajectory(host, fmu, parameter, value, **how):
    """All outputs over 40 steps, with a tunable parameter set before step 15, there and in a slave of ours."""
    outputs = references(fmu, "output")
    changed = references(fmu, "parameter")[parameter]
    done = host(fmu, 40, 0.01, 15, changed, value, *outputs.values(), **how)
    assert done.returncode == 0, done.stderr
    rows = []
    with open_slave(fmu, "model") as slave:
        slave.bind([], [parameter], list(outputs))
        slave.initialize({}, 0.0, None)
        for k in range(40):
            rows.append(slave.step([], k * 0.01, 0.01, [value] if k == 15 else None))
    return np.array([list(map(float, line.split())) for line in done.stdout.splitlines()]), np.array(rows)


def doctors_line(fmu):
    """What `retune doctor` says to type before the importer's own command."""
    report = subprocess.run([HERE / "retune", "doctor", fmu], capture_output=True, text=True)
    assert report.returncode == 0, report.stdout + report.stderr
    line = report.stdout.splitlines()[-1].strip()
    assert line.endswith(" IMPORTER")
    return line.removesuffix(" IMPORTER")


@needs_libpython
@pytest.mark.parametrize("name", NAMES)
def test_an_fmu_runs_in_c_with_libpython_preloaded(host, fmus, name):
    variables = fmpy.read_model_description(fmus[name]).modelVariables
    tunable = next(v for v in variables if v.variability == "tunable" and v.type == "Real")
    there, here = trajectory(
        host, fmus[name], tunable.name, 1.05 * float(tunable.start), environment={"LD_PRELOAD": LIBPYTHON} | QUIET_END
    )
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-9)


def test_without_libpython_the_loader_says_what_is_missing(host, fmus):
    done = host(fmus["Pendulum"], 1, 0.01, -1, 0, 0.0)
    assert done.returncode == 2
    assert "undefined symbol: _Py" in done.stderr


@needs_libpython
def test_the_line_that_doctor_prints_starts_the_host(host, fmus):
    there, here = trajectory(host, fmus["Pendulum"], "m", 2.0, prefix=doctors_line(fmus["Pendulum"]))
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-9)


@pytest.fixture
def ecos(tmp_path):
    """The command of the package ecospy, a native importer; it is not marked as executable there."""
    spec = find_spec("ecospy")
    if spec is None:
        pytest.skip("ecospy has binaries for Linux on x86_64 only")
    command = tmp_path / "ecos"
    shutil.copyfile(Path(spec.origin).parent / "binaries" / "ecos", command)
    command.chmod(0o755)

    def simulate(fmu, prefix=""):
        line = f"{prefix} {command} simulate --path {fmu} --stopTime 0.995 --stepSize 0.01"
        environment = os.environ | {"LD_LIBRARY_PATH": f"{sys.prefix}/lib"}  # of the package tbb
        return subprocess.run(["sh", "-c", line], capture_output=True, text=True, env=environment, cwd=tmp_path)

    return simulate


@needs_libpython
def test_the_line_that_doctor_prints_starts_a_native_importer(ecos, fmus, tmp_path):
    done = ecos(fmus["Pendulum"], doctors_line(fmus["Pendulum"]))
    assert done.returncode == 0, done.stdout + done.stderr
    header, *rows = csv.reader((tmp_path / "Pendulum.csv").read_text().splitlines(), skipinitialspace=True)
    columns = [header.index(f"instance::{name}[REAL]") for name in ("phi", "phi_dot")]
    there = np.array([[float(row[i]) for i in columns] for row in rows[1:]])
    with open_slave(fmus["Pendulum"], "model") as slave:
        slave.bind([], [], ["phi", "phi_dot"])
        slave.initialize({}, 0.0, None)
        here = np.array([slave.step([], k * 0.01, 0.01) for k in range(len(there))])
    assert len(there) >= 99
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-6)  # six decimals in the file


def test_without_the_line_a_native_importer_crashes(ecos, fmus):
    """ecos 0.7.2 does not look at what dlopen returns."""
    assert ecos(fmus["Pendulum"]).returncode != 0


@pytest.fixture
def where(tmp_path):
    """An FMU that needs the module `only_here`, and a virtual environment that has it."""
    venv = tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", venv], check=True)
    paths = sysconfig.get_paths("venv", vars={"base": str(venv), "platbase": str(venv)})
    (Path(paths["purelib"]) / "only_here.py").write_text("")
    (tmp_path / "where.py").write_text(SLAVE)
    python = {**os.environ, "PYTHONPATH": paths["purelib"]}
    code = "import sys; from pythonfmu import FmuBuilder; FmuBuilder.build_FMU(sys.argv[1], dest=sys.argv[2])"
    subprocess.run([sys.executable, "-c", code, tmp_path / "where.py", tmp_path], check=True, env=python)
    return tmp_path / "Where.fmu", venv


@needs_libpython
def test_the_first_python_on_the_path_decides_on_the_virtual_environment(host, where):
    fmu, venv = where
    environment = {"LD_PRELOAD": LIBPYTHON, "PATH": f"{venv / 'bin'}:{os.environ['PATH']}"} | QUIET_END
    done = host(fmu, 1, 0.01, -1, 0, 0.0, 0, environment=environment)
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr
    prefix, version = done.stderr.split(" ", 1)[0], tuple(sys.version_info[:2])
    assert Path(prefix) == venv
    assert str(version) in done.stderr


@needs_libpython
def test_an_environment_variable_of_the_activated_one_does_not(host, where):
    fmu, venv = where
    environment = {"LD_PRELOAD": LIBPYTHON, "PATH": f"{HERE}:/usr/bin:/bin", "VIRTUAL_ENV": str(venv)} | QUIET_END
    done = host(fmu, 1, 0.01, -1, 0, 0.0, 0, environment=environment)
    assert done.returncode == 3
    assert "No module named 'only_here'" in done.stderr
    report = subprocess.run([HERE / "retune", "doctor", fmu], capture_output=True, text=True)
    assert report.returncode == 1
    assert f"MISSING  modules    only_here cannot be imported in {sys.prefix}" in report.stdout
