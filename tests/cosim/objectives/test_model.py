"""A plant FMU as the estimator's model."""

import math
import os
import re
import signal

import numpy as np
import pytest

from cosim import ScenarioError, SlaveError, run
from cosim.objectives.model import FmuModel, opened_model
from cosim.scenarios.scenario import Scenario
from cosim.slaves.slave import open_slave
from cosim.system.fmu_cache import find_fmu
from cosim.system.plant import Plant, plant_of
from estimator import Parameter
from fmu_models import friction_pendulum, magnetic_levitation, pendulum, quadrotor, rigid_body

pytestmark = pytest.mark.fmu

MODELS = {
    "pendulum": ("Pendulum", pendulum.derivative, {"m": (0.1, 5.0), "l": (0.1, 3.0)}),
    "quadrotor": (
        "Quadrotor",
        quadrotor.derivative,
        {"m": (0.5, 4.0), "J_x": (0.1, 12.0), "J_y": (0.1, 12.0), "J_z": (0.1, 12.0)},
    ),
    "stiction": (
        "FrictionPendulum", friction_pendulum.derivative, {"m": (0.1, 5.0), "F_c": (0.0, 3.0), "u_d": (0.0, 3.0)},
    ),
    "magnetic-levitation": (
        "MagneticLevitation", magnetic_levitation.derivative, {"m": (0.03, 0.4), "z_0": (0.001, 0.016)},
    ),
    "rigid-body": (
        "RigidBody",
        rigid_body.derivative,
        {"m": (0.5, 8.0), "c_x": (-0.3, 0.3), "c_z": (-0.3, 0.3), "J_yy": (1.0, 9.0)},
    ),
}  # fmt: skip


def plant_like(scenario, fmi, tmp_path):
    """The plant of a named scenario as seen through its co-simulation FMU of that version."""
    loaded = Scenario.load(scenario)
    with open_slave(find_fmu(MODELS[scenario][0], tmp_path, fmi), loaded.plant) as slave:
        return plant_of(loaded, slave) if fmi == 2 else None


@pytest.fixture
def model(tmp_path, leaves_nothing):
    """The FMU model of a named scenario's plant; its process and folder are gone afterwards."""
    opened = []

    def of(scenario):
        name, _, bounds = MODELS[scenario]
        plant = plant_like(scenario, 2, tmp_path)
        parameters = [Parameter(key, low, high) for key, (low, high) in bounds.items()]
        opened.append(FmuModel(find_fmu(name, tmp_path, 3, "ModelExchange"), plant, parameters))
        return opened[-1]

    yield of
    for one in opened:
        one.close()


@pytest.mark.parametrize("scenario", list(MODELS))
def test_the_fmu_computes_the_derivatives_of_the_physics(model, scenario):
    """Against the function that the FMU was made from, at random points: 1e-12 of the largest term."""
    _, derivative, bounds = MODELS[scenario]
    fmu, rng = model(scenario), np.random.default_rng(1)
    n_x, n_u = (2, 2) if len(bounds) < 4 else (18, 10 if scenario == "quadrotor" else 12)
    theta = {}
    for k in range(50):
        x, u = tuple(rng.normal(0.0, 2.0, n_x).tolist()), tuple(rng.normal(0.0, 10.0, n_u).tolist())
        theta = {key: float(rng.uniform(low, high)) for key, (low, high) in bounds.items()} if k % 3 == 0 else theta
        expected = derivative(x, u, **theta)
        np.testing.assert_allclose(fmu(x, u, **theta), expected, rtol=1e-12, atol=1e-12 * max(map(abs, expected)))


X, U = (*(0.0,) * 6, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, *(0.0,) * 3), (12.0, 0.1, *(0.0,) * 8)
THETA = {"m": 1.0, "J_x": 1.0, "J_y": 1.0, "J_z": 2.0}


def test_a_candidate_without_a_value_is_nan_and_the_next_one_is_not(model):
    fmu = model("quadrotor")
    before = fmu(X, U, **THETA)
    assert np.isnan(fmu(X, U, **THETA | {"m": math.nan})).all()
    assert fmu(X, U, **THETA) == before


@pytest.mark.parametrize("killed_by", [signal.SIGSEGV, signal.SIGKILL])
def test_an_fmu_that_dies_on_a_candidate_is_started_anew(model, children, killed_by):
    """A candidate that it dies of has no value; one during which it is killed from outside is made once more."""
    others = children()
    fmu = model("quadrotor")
    (process_id,) = children() - others
    before = fmu(X, U, **THETA)
    os.kill(process_id, killed_by)
    if killed_by == signal.SIGSEGV:
        with pytest.raises(ValueError, match=r"Quadrotor: .*process was ended by SIGSEGV"):
            fmu(X, U, **THETA)
    assert fmu(X, U, **THETA) == before


def test_an_fmu_that_does_not_end_well_is_a_warning(model, monkeypatch, caplog):
    fmu = model("pendulum")
    close = fmu._process.close

    def fails(*arguments, **named):
        close(*arguments, **named)
        raise SlaveError("pendulum", "terminate", None, "returned error")

    monkeypatch.setattr(fmu._process, "close", fails)
    fmu.close()
    assert caplog.messages == ["pendulum: terminate returned error"]


@pytest.mark.full
def test_the_pendulum_is_re_tuned_with_an_fmu_as_its_model(leaves_nothing):
    """The scenario of the paper to a second after the jump to 4.271 kg and 0.981 m; noise 1e-3 rad/s^2."""
    settings = {"scenario.stop_time": "4.0", "estimation.model": "Pendulum"}
    result = run(Scenario.load("pendulum", settings), seed=0)
    assert result.status == "done"
    assert result.estimates["m"][-1] == pytest.approx(4.271, abs=2e-3)
    assert result.estimates["l"][-1] == pytest.approx(0.981, abs=1e-3)
    by_function = run(Scenario.load("pendulum", {"scenario.stop_time": "4.0"}), seed=0)
    for name in result.estimates:
        np.testing.assert_array_equal(result.estimates[name], by_function.estimates[name])


def test_a_path_beside_the_scenario_is_a_model(tmp_path, leaves_nothing):
    path = find_fmu("Pendulum", tmp_path, 3, "ModelExchange")
    (tmp_path / "my model.fmu").write_bytes(path.read_bytes())
    scenario = Scenario.load("pendulum", {"estimation.model": "my model.fmu"}).model_copy(update={"folder": tmp_path})
    with opened_model(scenario, plant_like("pendulum", 2, tmp_path)) as model:
        expected = pendulum.derivative((0.3, 0.1), (2.0,), m=2.0, l=1.0)
        assert model((0.3, 0.1), (2.0, 0.0), m=2.0, l=1.0) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"estimation.model": "Pendulun"}, "estimation.model: no FMU 'Pendulun': "),
        ({"estimation.model": "nowhere.fmu"}, "estimation.model: no FMU 'nowhere.fmu': "),
        ({"estimation.model": "Quadrotor"}, "estimation.model: Quadrotor.fmu has no state 'phi'"),
        ({"estimation.model": "PendulumController"}, "estimation.model: no FMU 'PendulumController': "),
        ({"estimation.model": "FrictionPendulum", "estimation.parameters": "EXTRA"}, "no variable 'mass' in FrictionP"),
    ],
)
def test_a_model_that_does_not_fit_is_refused_in_one_line(leaves_nothing, settings, reason):
    extra = '[{name = "mass", lower = 1, upper = 2, unit = "kg", writes = "controller.m", true = "plant.m"}]'
    settings = {k: v.replace("EXTRA", extra) for k, v in settings.items()}
    with pytest.raises(ScenarioError, match=re.escape(reason)) as caught:
        run(Scenario.load("pendulum", {"scenario.stop_time": "0.1"} | settings))
    assert len(str(caught.value).splitlines()) == 1


def test_a_parameter_that_the_fmu_does_not_take_is_refused(tmp_path, leaves_nothing):
    plant = plant_like("pendulum", 2, tmp_path)
    path = find_fmu("Pendulum", tmp_path, 3, "ModelExchange")
    with pytest.raises(ScenarioError, match=re.escape("'m' of Pendulum.fmu takes 0.1 to 5.0; 'm' has [0.05, 5].")):
        FmuModel(path, plant, [Parameter("m", 0.05, 5.0)])


@pytest.fixture
def axis(foreign, leaves_nothing):
    """The model of the axis that was compiled from C, by the name of its FMU."""
    opened = []

    def of(name):
        plant = Plant("plant", ("mass.v", "mass.s"), {"f": 0.0}, (0,))  # the states in another order than the FMU's
        opened.append(FmuModel(foreign / f"{name}.fmu", plant, [Parameter("mass.m", 0.5, 20.0)]))
        return opened[-1]

    yield of
    for one in opened:
        one.close()


@pytest.mark.parametrize("name", ["Axis-ME", "Axis-3"], ids=["FMI 2.0", "FMI 3.0"])
def test_an_fmu_of_another_tool_gives_newton_s_derivatives(axis, name):
    model, rng = axis(name), np.random.default_rng(0)
    for _ in range(5):
        v, s, f, m = rng.uniform(0.5, 3.0, 4)
        assert model((v, s), (f,), **{"mass.m": m}) == pytest.approx(((f - 8.0 * s - 1.0 * v) / m, v), rel=1e-14)
