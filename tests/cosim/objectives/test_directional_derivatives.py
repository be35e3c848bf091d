"""Directional derivatives of an FMU model by its parameters, in place of differences."""

import shutil

import numpy as np
import pytest

from benchmarks.native_fmus import FOREIGN, build_c
from cosim.objectives.model import FmuModel
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.system.plant import Plant
from estimator import Parameter

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

PARAMETERS = [Parameter("mass.m", 0.5, 20.0), Parameter("spring.c", 1.0, 40.0)]
AXIS = (FOREIGN / "Axis-3.xml").read_text()
DECLARED = AXIS.replace("<ModelExchange ", '<ModelExchange providesDirectionalDerivatives="true" ')


STIFFNESS = """[[estimation.parameters]]
name = "spring.c"
lower = 1.0
upper = 40.0
unit = "N/m"
writes = "controller.c"
true = "plant.spring.c"
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The axis in FMI 3.0, whose derivatives by parameters are right, half of what they are, or not offered."""
    folder = tmp_path_factory.mktemp("directional")
    return {
        "right": build_c(FOREIGN / "Axis.c", DECLARED, folder / "right.fmu", "-DDIRECTIONAL=1.0"),
        "wrong": build_c(FOREIGN / "Axis.c", DECLARED, folder / "wrong.fmu", "-DDIRECTIONAL=0.5"),
        "refused": build_c(FOREIGN / "Axis.c", DECLARED, folder / "refused.fmu"),
        "undeclared": build_c(FOREIGN / "Axis.c", AXIS, folder / "undeclared.fmu", "-DDIRECTIONAL=1.0"),
    }


@pytest.fixture
def model(built):
    opened = []

    def of(name):
        plant = Plant("plant", ("mass.v", "mass.s"), {"f": 0.0}, (0,))  # the states in another order than the FMU's
        opened.append(FmuModel(built[name], plant, PARAMETERS))
        return opened[-1]

    yield of
    for one in opened:
        one.close()


def test_slopes_are_those_of_newton_s_equation(model):
    axis, rng = model("right"), np.random.default_rng(0)
    assert axis.has_slopes
    for _ in range(5):
        v, s, f, m, c = rng.uniform(1.0, 3.0, 5)
        at = {"mass.m": m, "spring.c": c}
        a = (f - c * s - 1.0 * v) / m
        assert axis.slopes((v, s), (f,), **at) == [pytest.approx([-a / m, -s / m], rel=1e-14), [0.0, 0.0]]
        assert axis((v, s), (f,), **at) == pytest.approx((a, v), rel=1e-14)


def test_what_differs_from_differences_is_not_used_again(model):
    axis, at = model("wrong"), {"mass.m": 2.0, "spring.c": 8.0}
    assert axis.slopes((0.0, 0.0), (0.0,), **at) == [[0.0, 0.0], [0.0, 0.0]]  # nothing is proven where all is zero
    with pytest.raises(ValueError, match="directional derivatives by"):
        axis.slopes((1.0, 1.0), (0.0,), **at)
    assert not axis.has_slopes
    assert axis((1.0, 1.0), (0.0,), **at) == pytest.approx((-4.5, 1.0), rel=1e-14)


def test_a_call_that_the_fmu_refuses_leaves_differences(model):
    axis, at = model("refused"), {"mass.m": 2.0, "spring.c": 8.0}
    with pytest.raises(ValueError, match=r"get_directional_derivative .* returned error"):
        axis.slopes((1.0, 1.0), (0.0,), **at)
    assert not axis.has_slopes
    assert axis((1.0, 1.0), (0.0,), **at) == pytest.approx((-4.5, 1.0), rel=1e-14)


def test_what_is_not_declared_and_fmi_2_are_not_asked(model, foreign):
    assert not model("undeclared").has_slopes
    plant = Plant("plant", ("mass.v", "mass.s"), {"f": 0.0}, (0,))
    older = FmuModel(foreign / "Axis-ME.fmu", plant, PARAMETERS)
    assert not older.has_slopes
    older.close()


@pytest.mark.full
def test_least_squares_needs_fewer_evaluations_and_finds_the_same(built, foreign, tmp_path):
    shutil.copy(FOREIGN / "steps.csv", tmp_path)
    text = (FOREIGN / "axis.toml").read_text().replace('name = "m"', 'name = "mass.m"') + STIFFNESS
    for name in ("Axis", "AxisController"):
        text = text.replace(f'"{name}.fmu"', f'"{foreign / name}.fmu"')
    found = {}
    for name in ("right", "undeclared"):
        path = tmp_path / f"{name}.toml"
        path.write_text(text.replace('"axis_model:derivative"', f'"{built[name]}"'))
        found[name] = run(Scenario.load(path), estimator="least-squares", seed=0)
        assert found[name].estimates["mass.m"][-1] == pytest.approx(3.0, rel=1e-2)
    own, by_differences = found["right"], found["undeclared"]
    np.testing.assert_allclose(own.estimates["mass.m"][-1], by_differences.estimates["mass.m"][-1], rtol=1e-6)
    assert own.summary()["evaluations"] <= 0.75 * by_differences.summary()["evaluations"]
