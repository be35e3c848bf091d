"""Each command on FMUs that are not of our making: compiled from C here, made by other packages, shipped by them."""

import csv
import importlib.metadata
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import cont2discrete

from benchmarks.native_fmus import FOREIGN, build_c

pytestmark = pytest.mark.fmu
STEP = 0.01  # s


def oscillation(path, m, c, d, noise, end=4.0):
    """A log of m s'' = f - c s - d s' as CSV without units: time, f held over each step, s exact but for noise."""
    t = np.arange(round(end / STEP) + 1) * STEP
    f = 3.0 * np.sign(np.sin(2.3 * t))
    plant = (np.array([[0.0, 1.0], [-c / m, -d / m]]), np.array([[0.0], [1.0 / m]]), np.eye(2), np.zeros((2, 1)))
    A, B, *_ = cont2discrete(plant, STEP)
    x = np.zeros((len(t), 2))
    for i in range(len(t) - 1):
        x[i + 1] = A @ x[i] + B[:, 0] * f[i]
    s = x[:, 0] + noise * np.random.default_rng(0).standard_normal(len(t))
    np.savetxt(path, np.column_stack([t, f, s]), "%.9g", ",", header="time,f,s", comments="")
    return path


def estimated(called, *arguments):
    """Parameters of `retune estimate` by name."""
    code, out, err = called("estimate", *arguments, "--evaluations", 20, "--jobs", 1, "--json")
    assert (code, err) == (0, "")
    return {name: p["value"] for name, p in json.loads(out)["parameters"].items()}


def refused(called, *arguments, code=2):
    """The one line that the command ends with."""
    found, out, err = called(*arguments)
    assert (found, out, err.count("\n")) == (code, "", 1), (out, err)
    return err


# -- compiled from C --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "model"), [("Axis", "Axis-ME"), ("Axis-3", None), ("Axis", "Axis-3")], ids=["FMI 2", "FMI 3", "both"]
)
@pytest.mark.full
def test_the_plant_as_model_exchange_fmu_leaves_only_the_change_to_fill_in(foreign, workplace, called, plant, model):
    """A line of the written scenario is uncommented, and the mass that it jumps to is found."""
    shutil.copy(FOREIGN / "steps.csv", workplace)
    fmus = ["--plant", foreign / f"{plant}.fmu", "--controller", foreign / "AxisController.fmu"]
    more = ["--model", foreign / f"{model}.fmu"] if model else []
    code, out, _ = called("new", *fmus, "--reference", "steps.csv", *more, "-o", "axis.toml")
    assert (code, out.count("to fill in")) == (0, 1)
    text = Path("axis.toml").read_text()
    Path("axis.toml").write_text(text.replace('# "plant.mass.m" = ', '"plant.mass.m" = '))
    code, out, _ = called("check", "axis.toml")
    assert (code, "0 errors" in out) == (0, True), out
    code, out, _ = called("run", "axis.toml", "--only", "--out", "out")
    assert code == 0
    with open("out/series.csv", newline="") as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["controller.m"]) == pytest.approx(3.0, rel=5e-3)
    assert float(last["controller.c"]) == pytest.approx(8.0, rel=5e-3)


@pytest.mark.parametrize("how", [(), pytest.param(("--online",), marks=pytest.mark.full)], ids=["offline", "online"])
def test_roll_outs_have_a_stop_time(foreign, workplace, called, how):
    """An FMU that cannot be initialised without one."""
    fmu = build_c(FOREIGN / "Axis.c", (FOREIGN / "Axis.xml").read_text(), workplace / "Axis.fmu", "-DNEEDS_STOP")
    log = oscillation("log.csv", 2.0, 8.0, 1.0, 1e-4, end=1.0)
    sought = ["--parameter", "mass.m=0.5:20", "--parameter", "spring.c=1:50", "--evaluations", 6, "--jobs", 1, *how]
    code, out, err = called("estimate", fmu, log, *sought, "--input", "f=f", "--measured", "mass.s=s", "--json")
    assert (code, "stop" in err) == (0, False), err
    assert json.loads(out)


@pytest.mark.full_but("FMI 2")
@pytest.mark.parametrize("name", ["Axis", "Axis-3", "Axis-ME"], ids=["FMI 2", "FMI 3", "model exchange"])
def test_its_parameters_are_found_in_a_log(foreign, workplace, called, name):
    """To the error of its own integration, semi-implicit Euler over half a millisecond, where it has one."""
    log = oscillation("log.csv", 3.0, 11.0, 1.0, 1e-4)
    sought = ["--parameter", "mass.m=0.5:20", "--parameter", "spring.c=1:50"]
    found = estimated(called, foreign / f"{name}.fmu", log, *sought, "--input", "f=f", "--measured", "mass.s=s")
    assert found == pytest.approx({"mass.m": 3.0, "spring.c": 11.0}, rel=1e-3)


def test_what_it_is_for_is_told(foreign, called):
    code, out, _ = called("info", foreign / "Axis-ME.fmu")
    assert code == 0
    assert "FMI 2.0 for model exchange, made by Somebody's tool" in out


# -- pythonfmu's and pythonfmu3's own examples ------------------------------------------------------------------------


@pytest.fixture(scope="session")
def example(tmp_path_factory):
    """example(package, script): an FMU of the package's own tests, built by it."""

    def build(package, script):
        sources = Path(importlib.util.find_spec(package).submodule_search_locations[0], "tests", "slaves")
        folder = tmp_path_factory.mktemp(package)
        command = [sys.executable, "-m", package, "build", "-f", sources / f"{script}.py", "-d", folder]
        subprocess.run(command, check=True, capture_output=True)  # a process of its own: the builder imports the script
        return next(folder.glob("*.fmu"))

    return build


@pytest.mark.full
def test_the_rate_of_pythonfmu3_s_dahlquist_equation_is_found(example, workplace, called):
    """x' = -k x by explicit Euler steps of h: the FMU decays as exp(-0.7 t) where 1 - k h = exp(-0.7 h)."""
    t = np.arange(301) * STEP
    np.savetxt("log.csv", np.column_stack([t, np.exp(-0.7 * t)]), "%.12g", ",", header="time,x", comments="")
    fmu = example("pythonfmu3", "pythonslaveMXCS")
    found = estimated(called, fmu, "log.csv", "--parameter", "k=0.1:5", "--measured", "x=x")
    assert found["k"] == pytest.approx((1.0 - np.exp(-0.7 * STEP)) / STEP, rel=1e-5)


@pytest.mark.full
def test_the_same_for_model_exchange_only_has_the_equation_s_own(example, workplace, called):
    t = np.arange(301) * STEP
    np.savetxt("log.csv", np.column_stack([t, np.exp(-0.7 * t)]), "%.12g", ",", header="time,x", comments="")
    fmu = example("pythonfmu3", "pythonslaveMX")
    found = estimated(called, fmu, "log.csv", "--parameter", "k=0.1:5", "--measured", "x=x")
    assert found["k"] == pytest.approx(0.7, rel=1e-5)


def test_a_fixed_parameter_of_pythonfmu3_s_example_cannot_change_in_a_run(example, workplace, called):
    fmu = example("pythonfmu3", "pythonslaveMXCS")
    assert called("new", "--plant", fmu, "--model", fmu, "-o", "my.toml")[0] == 0
    text = Path("my.toml").read_text()
    Path("my.toml").write_text(text.replace("[changes]", '[changes]\n"plant.k" = [[0.0, 1.0], [1.0, 2.0]]'))
    code, out, _ = called("check", "my.toml")
    assert code == 2
    assert "changes.\"plant.k\": error: 'k' of Dahlquist.fmu is a fixed parameter, not a tunable parameter" in out


EXAMPLES = {
    "a whole number": ("pythonfmu3", "pythonslave", "intParam=1:5", "realOut=x", 2,
        "'intParam' of PythonSlave.fmu is of type Int32; only real numbers can be estimated"),
    "a text": ("pythonfmu3", "pythonslave", "stringParameter=1:5", "realOut=x", 2, "'stringParameter'"),
    "an output that is an array": ("pythonfmu3", "pythonslave_arraytypes", "float64_input[1]=1:5",
        "float64_output=x", 2, "float64_output"),
    "raises, FMI 3": ("pythonfmu3", "PythonSlaveWithException", "realIn=1:5", "realOut=x", 1,
        "every roll-out failed, the first so: plant: do_step at t = 0.000 s returned fatal: RuntimeError()"),
    "raises, FMI 2": ("pythonfmu", "PythonSlaveWithException", "realIn=1:5", "realOut=x", 1,
        "every roll-out failed, the first so: plant: do_step at t = 0.000 s returned fatal: RuntimeError()"),
}  # fmt: skip


@pytest.mark.parametrize(("package", "script", "sought", "measured", "code", "told"), EXAMPLES.values(), ids=EXAMPLES)
def test_what_their_examples_cannot_is_one_line(
    example, workplace, called, package, script, sought, measured, code, told
):
    Path("log.csv").write_text("time,x\n" + "".join(f"{k / 10},{k * k / 10}\n" for k in range(10)))
    options = ["--parameter", sought, "--measured", measured, "--evaluations", 6]
    assert told in refused(called, "estimate", example(package, script), "log.csv", *options, code=code)


def test_pythonfmu_s_example_whose_whole_numbers_are_continuous_is_usable(example, called):
    code, out, _ = called("check", example("pythonfmu", "pythonslave"))
    assert code == 0
    assert 'warning: The variable "intOut"' in out
    assert "PythonSlave.fmu: 0 errors, " in out


def test_of_an_invalid_fmu_the_first_problem_is_told(described, called):
    inputs = '<ScalarVariable name="{}" valueReference="{}" causality="input"><Real/></ScalarVariable>'
    error = refused(called, "info", described("".join(inputs.format(name, i) for i, name in enumerate("abc"))))
    assert 'is not a usable FMU: Variable "a" (line 5) has no start value.' in error
    assert "and 2 more, which `fmpy validate` lists" in error


# -- made by, and shipped with, packages that importing FMUs does not need --------------------------------------------


@pytest.fixture
def shipped():
    """shipped(distribution, file): the path of a file that a package installs."""

    def find(distribution, file):
        try:
            files = importlib.metadata.files(distribution) or []
        except importlib.metadata.PackageNotFoundError:
            pytest.skip(f"{distribution} is not installed")
        return next(Path(f.locate()) for f in files if f.as_posix().endswith(file))

    return find


@pytest.mark.full
@pytest.mark.interop
@pytest.mark.parametrize("version", [2, 3])
def test_a_container_of_fmu_manipulation_toolbox(foreign, workplace, called, version):
    """An FMU that holds an FMU, whose units the tool leaves out."""
    pytest.importorskip("fmu_manipulation_toolbox")
    shutil.copy(foreign / "Axis.fmu", workplace)
    Path("box.csv").write_text(
        "rule;from_fmu;from_port;to_fmu;to_port\nFMU;Axis.fmu;;;\n"
        "INPUT;;f;Axis.fmu;f\nOUTPUT;Axis.fmu;mass.s;;s\nOUTPUT;Axis.fmu;mass.v;;v\n"
    )
    program = "from fmu_manipulation_toolbox.cli.fmucontainer import fmucontainer; fmucontainer()"
    options = ["-container", f"box.csv:{STEP}", "-auto-parameter", "-fmi", str(version)]
    subprocess.run([sys.executable, "-c", program, *options], check=True, capture_output=True)
    code, out, _ = called("info", "box.fmu")
    assert (code, f"FMI {version}.0 for co-simulation, made by FMUContainer" in out) == (0, True), out
    log = oscillation("log.csv", 3.0, 11.0, 1.0, 1e-4)
    sought = ["--parameter", "axis.mass.m=0.5:20", "--parameter", "axis.spring.c=1:50"]
    found = estimated(called, "box.fmu", log, *sought, "--input", "f=f", "--measured", "s=s")
    assert found == pytest.approx({"axis.mass.m": 3.0, "axis.spring.c": 11.0}, rel=1e-3)


@pytest.mark.full
@pytest.mark.interop
def test_the_oscillator_of_component_model(shipped, workplace, called):
    """Made by component-model with pythonfmu 0.6.9, indices in the names; it needs pint."""
    pytest.importorskip("pint")
    fmu = shipped("crane-fmu", "examples/HarmonicOscillator6D.fmu")
    log = oscillation("log.csv", 1.0, 2.5, 0.3, 1e-3)
    sought = ["--parameter", "k[0]=0.5:10", "--parameter", "c[0]=0.01:2"]
    found = estimated(called, fmu, log, *sought, "--input", "f[0]=f", "--measured", "x[0]=s", "--step", STEP)
    assert found == pytest.approx({"k[0]": 2.5, "c[0]": 0.3}, rel=5e-3)


GFORTRAN = """
void _gfortran_concat_string(void) {}
void _gfortran_st_write(void) {}
void _gfortran_st_write_done(void) {}
void _gfortran_transfer_character_write(void) {}
void _gfortran_transfer_integer_write(void) {}
"""
VERSIONS = """
GFORTRAN_1.0 { global: _gfortran_concat_string; _gfortran_st_write; _gfortran_st_write_done; };
GFORTRAN_1.4 { global: _gfortran_transfer_character_write; _gfortran_transfer_integer_write; } GFORTRAN_1.0;
"""


@pytest.mark.full
@pytest.mark.interop
@pytest.mark.skipif(sys.platform != "linux" or shutil.which("gcc") is None, reason="gcc on Linux")
def test_the_heated_room_of_jmodelica_that_modestpy_ships(shipped, workplace):
    """C T' = (Ti1 - T)/R1 + (Ti2 - T)/R2, made by JModelica.org in 2017 with its solver inside.

    modestpy's own log of it was made with R1 = 0.1, R2 = 0.25 K/W and C = 2000 J/K; T shows no more of them than the
    time constants R1 C and R2 C. The FMU wants the Fortran library of GCC 6, to write LAPACK's messages: a stand-in
    does.
    """
    fmu = shipped("modestpy", "simple2R1C_ic/Simple2R1C_ic_linux64.fmu")
    tables = [fmu.with_name(f"{name}.csv").read_text().splitlines()[:401] for name in ("inputs", "result")]
    rows = [f"{row},{last.partition(',')[2]}\n" for row, last in zip(*tables, strict=True)]
    Path("log.csv").write_text("".join(rows))
    Path("stub.c").write_text(GFORTRAN)
    Path("stub.map").write_text(VERSIONS)
    library = ["-Wl,--version-script=stub.map", "-Wl,-soname,libgfortran.so.3", "-o", "libgfortran.so.3"]
    subprocess.run(["gcc", "-shared", "-fPIC", "stub.c", *library], check=True)
    sought = ["--parameter", "R1=0.001:0.5:log", "--parameter", "R2=0.001:0.5:log", "--start", "C=2000"]
    roles = ["--input", "Ti1=Ti1", "--input", "Ti2=Ti2", "--measured", "T=T", "--start", "Tstart=293.15"]
    options = [*sought, *roles, "--evaluations", "20", "--json"]
    command = [sys.executable, "-m", "cosim.cli", "estimate", fmu, "log.csv", *options]
    environment = os.environ | {"LD_LIBRARY_PATH": str(workplace)}
    without = subprocess.run(command, capture_output=True, text=True)
    if without.returncode:  # where there is no such library
        assert without.returncode == 1
        assert "libgfortran.so.3: cannot open shared object file" in without.stderr
        assert without.stderr.count("\n") == 1
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    found = {name: p["value"] for name, p in json.loads(done.stdout)["parameters"].items()}
    assert found == pytest.approx({"R1": 0.1, "R2": 0.25}, rel=1e-4)
