"""The models of Modelica's Reference-FMUs as our components take them, and as FMPy's simulate_fmu does.

The Reference-FMUs themselves are in no package index: these are theirs by equations, in C and in Python.
"""

import shutil
import subprocess
import sys
from typing import NamedTuple

import fmpy
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.native_fmus import FOREIGN, SOURCES, build_c
from cosim import open_slave

pytestmark = pytest.mark.fmu
H = 0.01  # s
KINDS = {"CS": "CoSimulation", "ME": "ModelExchange"}


class Model(NamedTuple):
    variables: tuple[str, ...]
    """In the order of the C file: x, der(x), parameters p, and counters, which are discrete."""
    starts: tuple[float, ...]
    n_indicators: int
    end: float
    """s"""
    within: float
    """Largest difference that is allowed in model exchange, where both integrate to 1e-10."""


MODELS = {
    "BouncingBall": Model(("x h", "x v", "d h", "d v", "p g", "p e"), (1, 0, 0, -9.81, -9.81, 0.7), 1, 2.0, 1e-4),
    "VanDerPol": Model(("x x0", "x x1", "d x0", "d x1", "p mu"), (2, 0, 0, -2, 1), 0, 5.0, 1e-6),
    "Dahlquist": Model(("x x", "d x", "p k"), (1, -1, 1), 0, 5.0, 1e-7),
    "Stair": Model(("n counter", "x zero", "d zero"), (1, 0, 0), 0, 5.0, 0.0),
}


def described(name, fmi):
    """The model description of one of MODELS."""
    model, lines, rates, outputs = MODELS[name], [], [], []
    places = {variable: i for i, variable in enumerate(model.variables)}
    for (kind, variable), i, start in zip(map(str.split, places), places.values(), model.starts, strict=True):
        state = places.get(f"x {variable}", 0)
        role = {
            "x": 'causality="output" variability="continuous" initial="exact"',
            "n": 'causality="output" variability="discrete" initial="exact"',
            "d": 'causality="local" variability="continuous" initial="calculated"',
            "p": 'causality="parameter" variability="tunable" initial="exact"',
        }[kind]
        shown = f"der({variable})" if kind == "d" else variable
        begins = "" if kind == "d" else f'start="{start}"'
        (rates if kind == "d" else outputs if kind in "xn" else []).append(i)
        if fmi == 2:
            of = f'derivative="{state + 1}"' if kind == "d" else ""
            head = f'<ScalarVariable name="{shown}" valueReference="{i}" {role}>'
            lines.append(f"{head}<Real {begins} {of}/></ScalarVariable>")
        else:
            of = f'derivative="{state}"' if kind == "d" else ""
            lines.append(f'<Float64 name="{shown}" valueReference="{i}" {role} {begins} {of}/>')
    if fmi == 2:
        head = f'fmiVersion="2.0" modelName="{name}" guid="1" numberOfEventIndicators="{model.n_indicators}"'
        lists = {"Outputs": outputs, "Derivatives": rates, "InitialUnknowns": rates}
        known = {kind: "".join(f'<Unknown index="{i + 1}"/>' for i in places) for kind, places in lists.items()}
        structure = "".join(f"<{kind}>{unknowns}</{kind}>" for kind, unknowns in known.items())
    else:
        head = f'fmiVersion="3.0" modelName="{name}" instantiationToken="1"'
        time = 'name="time" causality="independent" variability="continuous"'
        lines.append(f'<Float64 {time} valueReference="{len(places)}"/>')
        kinds = {"Output": outputs, "ContinuousStateDerivative": rates, "InitialUnknown": rates}
        structure = "".join(f'<{kind} valueReference="{i}"/>' for kind, places in kinds.items() for i in places)
        structure += '<EventIndicator valueReference="0"/>' * model.n_indicators
    steps = 'canHandleVariableCommunicationStepSize="true"'
    return (
        f'<fmiModelDescription {head}><ModelExchange modelIdentifier="{name}"/><CoSimulation modelIdentifier="{name}" '
        f"{steps}/><ModelVariables>{''.join(lines)}</ModelVariables><ModelStructure>{structure}</ModelStructure>"
        "</fmiModelDescription>"
    )


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """built(name, fmi): one of MODELS as an FMU for both interfaces; or 'ME', for model exchange only."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")
    folder = tmp_path_factory.mktemp("reference")

    def build(name, fmi, kind):
        path, text = folder / f"{name}-{fmi}-{kind}.fmu", described(name, fmi)
        if kind == "ME":  # what is for both is used for co-simulation
            text = text.replace(text[text.index("<CoSimulation") : text.index("<ModelVariables")], "")
        rest = [str(SOURCES / "fmi3_not_offered.c")] if fmi == 3 else []
        return path if path.exists() else build_c(FOREIGN / f"reference/{name}.c", text, path, *rest)

    return build


def ours(path, outputs, end, h=H):
    """Outputs after each step of our component."""
    with open_slave(path, "model", isolation="none", tolerance=1e-10) as slave:
        slave.bind([], [], outputs)
        slave.initialize({}, 0.0, end)
        return np.array([slave.step([], k * h, h) for k in range(round(end / h))])


def theirs(path, kind, outputs, end, h=H, **options):
    """Outputs after each step of FMPy's simulate_fmu."""
    given = {"fmi_type": KINDS[kind], "output_interval": h, "output": outputs, "record_events": False} | options
    if kind == "ME":
        given["relative_tolerance"] = 1e-10
    table = fmpy.simulate_fmu(str(path), stop_time=end, **given)
    return np.array([table[name] for name in outputs], dtype=float).T[1:]  # FMPy sorts them by their types


QUICK = [("BouncingBall", 3, "CS"), ("VanDerPol", 2, "ME")]
REST = [(name, fmi, kind) for name in MODELS for fmi in (2, 3) for kind in KINDS if (name, fmi, kind) not in QUICK]


@pytest.mark.parametrize(
    ("name", "fmi", "kind"), [*QUICK, *[pytest.param(*case, marks=pytest.mark.full) for case in REST]]
)
def test_a_component_is_as_fmpy_simulates_it(built, name, fmi, kind):
    """In co-simulation but for FMPy's lengths of steps, which are differences of times, rounded.

    In model exchange both integrate, and find events each in its own way.
    """
    model, path = MODELS[name], built(name, fmi, kind)
    outputs = [variable[2:] for variable in model.variables if variable[0] in "xn"]
    found, expected = ours(path, outputs, model.end), theirs(path, kind, outputs, model.end)
    assert len(found) == len(expected) == round(model.end / H)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=model.within if kind == "ME" else 1e-12)


@pytest.mark.full
@pytest.mark.parametrize("fmi", [2, 3])
def test_van_der_pol_s_oscillation_is_that_of_dop853(built, fmi):
    t = np.arange(1, 501) * H
    rhs = lambda _, x: (x[1], (1.0 - x[0] ** 2) * x[1] - x[0])  # noqa: E731
    exact = solve_ivp(rhs, (0.0, 5.0), (2.0, 0.0), "DOP853", t, rtol=1e-12, atol=1e-12).y.T
    np.testing.assert_allclose(ours(built("VanDerPol", fmi, "ME"), ["x0", "x1"], 5.0), exact, atol=1e-6)


@pytest.mark.full
@pytest.mark.parametrize(("fmi", "maker"), [(2, "pythonfmu"), (3, "pythonfmu3")])
def test_values_of_every_type_pass_through_and_a_resource_is_read(tmp_path, fmi, maker):
    (tmp_path / "y.txt").write_text("a")
    script = FOREIGN / f"reference/feedthrough{fmi}.py"
    command = [sys.executable, "-m", maker, "build", "-f", script, "-d", tmp_path, tmp_path / "y.txt"]
    subprocess.run(command, check=True, capture_output=True)
    path, outputs = tmp_path / f"Feedthrough{fmi}.fmu", ["real_out", "int_out", "bool_out", "y"]
    values = [(0.0, 0.1, 2, True), (H, -3.5, -7, False), (2 * H, 1e300, 2**31 - 1, True)]
    types = [("time", "f8"), ("real_in", "f8"), ("int_in", "i4"), ("bool_in", "?")]
    expected = theirs(path, "CS", outputs, 3 * H, input=np.array(values, dtype=types))
    with open_slave(path, "model") as slave:
        slave.bind(["real_in", "int_in", "bool_in"], [], outputs)
        slave.initialize({}, 0.0, 3 * H)
        found = [slave.step([float(x) for x in row[1:]], k * H, H) for k, row in enumerate(values)]
    assert found == [(*map(float, row[1:]), 97.0) for row in values]
    np.testing.assert_array_equal(found, expected)
