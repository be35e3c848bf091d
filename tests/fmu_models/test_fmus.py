"""The FMUs, in hosts that have nothing but the FMU: see fmu_host.py."""

import json
import os
import random
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from pythonfmu import FmuBuilder
from scipy.integrate import solve_ivp

import fmu_models
from fmu_models import build
from fmu_models.friction_pendulum_controller_adaptive_fmu import FrictionPendulumControllerAdaptive
from fmu_models.friction_pendulum_controller_fmu import FrictionPendulumController
from fmu_models.friction_pendulum_fmu import FrictionPendulum
from fmu_models.pendulum_controller_adaptive_fmu import PendulumControllerAdaptive
from fmu_models.pendulum_controller_fmu import PendulumController
from fmu_models.pendulum_fmu import Pendulum
from fmu_models.pendulum_reference_fmu import PendulumReference
from fmu_models.pendulum_sine_fmu import PendulumSine
from fmu_models.quadrotor_controller_adaptive_fmu import QuadrotorControllerAdaptive
from fmu_models.quadrotor_controller_fmu import QuadrotorController
from fmu_models.quadrotor_fmu import Quadrotor
from fmu_models.quadrotor_reference_fmu import QuadrotorReference
from fmu_models.rigid_body_controller_adaptive_fmu import RigidBodyControllerAdaptive
from fmu_models.rigid_body_controller_fmu import RigidBodyController
from fmu_models.rigid_body_fmu import RigidBody
from fmu_models.rigid_body_reference_fmu import RigidBodyReference

MODELS = {
    model.__name__: model
    for model in (
        FrictionPendulum,
        FrictionPendulumController,
        FrictionPendulumControllerAdaptive,
        Pendulum,
        PendulumController,
        PendulumControllerAdaptive,
        PendulumReference,
        PendulumSine,
        Quadrotor,
        QuadrotorController,
        QuadrotorControllerAdaptive,
        QuadrotorReference,
        RigidBody,
        RigidBodyController,
        RigidBodyControllerAdaptive,
        RigidBodyReference,
    )
}
SCRIPTS = {  # values to set before a step, as a host's master would
    "FrictionPendulum": {"0": {"u": 4.0}, "15": {"u": -6.0, "u_d": 2.0}, "30": {"u": 1.0, "F_c": 2.5}},
    "FrictionPendulumController": {"0": {"phi": 0.3}, "15": {"phi_dot_ref": 0.5, "F_s": 2.0}, "30": {"phi_dot": -0.2}},
    "FrictionPendulumControllerAdaptive": {
        "0": {"phi": 0.3},
        "15": {"update_ready": True, "m": 3.0},
        "30": {"phi": 0.4},
    },
    "Pendulum": {"0": {"u": 2.0}, "15": {"u": -3.0, "m": 4.271}, "30": {"u": 1.0}},
    "PendulumController": {"0": {"phi": 0.3}, "15": {"phi_ref": 0.5, "m": 2.0}, "30": {"phi_dot": -0.2}},
    "PendulumControllerAdaptive": {"0": {"phi": 0.3}, "15": {"update_ready": True, "l": 2.0}, "30": {"phi": 0.4}},
    "PendulumReference": {"15": {"step_time": 0.35, "phi_final": 0.9}},
    "PendulumSine": {"15": {"omega_2": 4.0}, "30": {"amplitude_1": 0.3}},
    "Quadrotor": {"0": {"F": 13.0, "M_x": 0.1}, "15": {"M_y": -0.2, "m": 1.4, "J_z": 3.0}, "30": {"M_z": 0.3}},
    "QuadrotorController": {"0": {"r_x": 0.3, "R_12": 0.1}, "15": {"Omega_x": 0.5, "J_x": 2.0}, "30": {"j_d_x": 1.0}},
    "QuadrotorControllerAdaptive": {"0": {"r_x": 0.3}, "15": {"update_ready": True, "m": 2.0}, "30": {"r_x": 0.4}},
    "QuadrotorReference": {"15": {"omega": 0.8}, "30": {"smooth_yaw": True}},
    "RigidBody": {"0": {"F_x": 1.0, "M_x": 0.1}, "15": {"M_y": -0.2, "m": 4.0, "c_x": 0.1}, "30": {"J_xy": -0.2}},
    "RigidBodyController": {"0": {"r_x": 0.3, "R_12": 0.1}, "15": {"Omega_x": 0.5, "c_z": 0.1}, "30": {"a_d_x": 1.0}},
    "RigidBodyControllerAdaptive": {"0": {"r_x": 0.3}, "15": {"update_ready": True, "m": 2.0}, "30": {"r_x": 0.4}},
    "RigidBodyReference": {"15": {"omega": 0.8}, "30": {"amplitude_phi": 0.1}},
}
JUNK = {
    "FrictionPendulum": {"u": 9.0, "F_s": 3.0},
    "FrictionPendulumController": {"phi": 9.0, "u_d": 3.0},
    "FrictionPendulumControllerAdaptive": {"update_ready": True, "u_d": 3.0},
    "Pendulum": {"u": 9.0, "m": 3.0},
    "PendulumController": {"phi": 9.0, "Kp": 3.0},
    "PendulumControllerAdaptive": {"update_ready": True, "m": 3.0},
    "PendulumReference": {"step_time": 9.0},
    "PendulumSine": {"omega_1": 9.0},
    "Quadrotor": {"F": 9.0, "M_z": 9.0, "m": 3.0},
    "QuadrotorController": {"r_y": 9.0, "K_v_x": 3.0},
    "QuadrotorControllerAdaptive": {"update_ready": True, "m": 3.0},
    "QuadrotorReference": {"amplitude_z": 9.0},
    "RigidBody": {"F_z": 9.0, "M_z": 9.0, "m": 3.0},
    "RigidBodyController": {"r_y": 9.0, "K_v": 3.0},
    "RigidBodyControllerAdaptive": {"update_ready": True, "m": 3.0},
    "RigidBodyReference": {"amplitude_z": 9.0},
}
each_model = pytest.mark.parametrize("name", list(MODELS))
fmu = pytest.mark.fmu


@pytest.fixture(scope="session")
def fmus(tmp_path_factory):
    """Paths of all FMUs, by name."""
    return {name: str(path) for name, path in build.build_all(tmp_path_factory.mktemp("fmus")).items()}


def host(task, **arguments):
    """What the task returned in an interpreter without site-packages."""
    command = [sys.executable, "-I", "-S", str(Path(__file__).with_name("fmu_host.py")), task, json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def column(result, *names):
    rows = np.array(result["rows"])
    return rows[:, [result["names"].index(name) for name in names]]


# -- model descriptions -------------------------------------------------------------------------------------------


@fmu
@each_model
def test_the_description_is_valid(fmus, name):
    assert validate_fmu(fmus[name]) == []


@fmu
@each_model
def test_the_description_agrees_with_the_table(fmus, name):
    description = fmpy.read_model_description(fmus[name])
    assert description.modelName == name
    assert description.guid == build.guid(name)
    assert [v.name for v in description.modelVariables] == [v.name for v in MODELS[name].variables]
    for i, (read, v) in enumerate(zip(description.modelVariables, MODELS[name].variables, strict=True)):
        assert (read.valueReference, read.causality, read.variability) == (i, v.causality, v.variability)
        assert (read.unit, read.description, read.type) == (v.unit, v.description, v.type)
        assert v.description
        if v.type == "Real":
            texts = (read.start, read.min, read.max, read.nominal)
            assert [None if text is None else float(text) for text in texts] == [v.start, v.min, v.max, v.nominal]
        assert (read.derivative.name if read.derivative else None) == v.derivative


@fmu
@each_model
def test_every_unit_is_defined_with_its_dimension(fmus, name):
    description = fmpy.read_model_description(fmus[name])
    dimensions = {
        unit.name: tuple(getattr(unit.baseUnit, base) for base in ("kg", "m", "s", "rad"))
        for unit in description.unitDefinitions
    }
    reals = [v for v in description.modelVariables if v.type == "Real"]
    assert {v.unit for v in reals} == set(dimensions)
    known = {
        "N": (1, 1, -2, 0),
        "N.m": (1, 2, -2, 0),
        "kg.m2": (1, 2, 0, 0),
        "rad/s2": (0, 0, -2, 1),
        "1": (0, 0, 0, 0),
    }
    assert {unit: dimension for unit, dimension in dimensions.items() if unit in known}.items() <= known.items()
    for v in reals:
        if v.derivative is not None:
            per_second = np.subtract(dimensions[v.derivative.unit], (0, 0, 1, 0))
            assert dimensions[v.unit] == tuple(per_second)


@fmu
@each_model
def test_the_capabilities_are_those_of_the_code(fmus, name):
    capabilities = fmpy.read_model_description(fmus[name]).coSimulation
    assert capabilities.canGetAndSetFMUstate
    assert capabilities.canSerializeFMUstate
    assert capabilities.canHandleVariableCommunicationStepSize
    assert not capabilities.needsExecutionTool


@fmu
@pytest.mark.parametrize(
    ("name", "n_states"), [("FrictionPendulum", 2), ("Pendulum", 2), ("Quadrotor", 18), ("RigidBody", 18)]
)
def test_every_state_has_its_derivative_and_every_input_its_held_value(fmus, name, n_states):
    description = fmpy.read_model_description(fmus[name])
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]
    inputs = [v.name for v in description.modelVariables if v.causality == "input"]
    states = [v.name for v in description.modelVariables if v.causality == "output" and v.initial == "exact"]
    assert len(states) == n_states
    assert outputs == [*states, *(f"der({state})" for state in states), *(f"{name}_held" for name in inputs)]
    derivatives = [unknown.variable for unknown in description.derivatives]
    assert [(v.name, v.derivative.name) for v in derivatives] == [(f"der({state})", state) for state in states]


# -- declared dependencies ----------------------------------------------------------------------------------------


def new_slave(model, values, time):
    slave = model(instance_name="one")
    slave.setup_experiment(time)
    for i, v in enumerate(model.variables[: len(values)]):
        (slave.set_boolean if v.type == "Boolean" else slave.set_real)([i], [values[i]])
    return slave


def random_values(model, rng):
    return [
        rng.random() < 0.5 if v.type == "Boolean" else (v.start or 0.0) * rng.uniform(0.7, 1.3) + rng.uniform(0.05, 0.4)
        for v in model.variables
        if v.start is not None
    ]


def observed(model, outputs_of, among, n_points=60):
    """For each output the names among `among` that change it, at random points: found by perturbing one at a time."""
    rng = random.Random(1)
    changed = {v.name: set() for v in model.variables if v.causality == "output"}
    for _ in range(n_points):
        values, time = random_values(model, rng), rng.uniform(0.0, 15.0)
        base = outputs_of(values, values, time)
        for i, v in enumerate(model.variables[: len(values)]):
            if v.name not in among:
                continue
            new = not values[i] if v.type == "Boolean" else values[i] + rng.uniform(0.1, 0.5) + 8.0 * (v.unit == "s")
            see(changed, v.name, base, outputs_of(values, [*values[:i], new, *values[i + 1 :]], time))
        if "time" in among:
            see(changed, "time", base, outputs_of(values, values, time + rng.uniform(-1.0, 1.0)))
    return changed


def see(changed, cause, base, perturbed):
    for name, a, b in zip(changed, base, perturbed, strict=True):
        if a != b:
            changed[name].add(cause)


def declared(model, section):
    root = model(instance_name="one").to_xml()
    names = [v.name for v in model.variables]
    unknowns = root.findall(f"ModelStructure/{section}/Unknown")
    return {
        names[int(u.get("index")) - 1]: {names[int(i) - 1] for i in u.get("dependencies").split()} for u in unknowns
    }


def names_of(model, *causalities):
    return {v.name for v in model.variables if v.causality in causalities}


def states_of(model):
    return {v.derivative for v in model.variables if v.derivative is not None}


def indices_of_outputs(model):
    return [i for i, v in enumerate(model.variables) if v.causality == "output"]


def observed_initially(model, among):
    def initial_outputs(_, values, time):
        return new_slave(model, values, time).get_real(indices_of_outputs(model))

    return observed(model, initial_outputs, among)


def observed_feedthrough(model):
    inputs = {i: v.name for i, v in enumerate(model.variables) if v.causality == "input"}

    def outputs_after_a_step(values, perturbed, time):
        slave = new_slave(model, values, time)
        slave.exit_initialization_mode()
        slave.do_step(time, 0.01)
        for i in inputs:
            (slave.set_boolean if model.variables[i].type == "Boolean" else slave.set_real)([i], [perturbed[i]])
        return slave.get_real(indices_of_outputs(model))

    return observed(model, outputs_after_a_step, set(inputs.values()))


@each_model
def test_initial_dependencies_are_exactly_what_a_perturbation_shows(name):
    model = MODELS[name]
    seen = observed_initially(model, {v.name for v in model.variables})
    unknowns = declared(model, "InitialUnknowns")
    assert unknowns == {k: v for k, v in seen.items() if k in unknowns}
    assert set(unknowns) == {v.name for v in model.variables if v.initial == "calculated"}


@each_model
def test_dependencies_at_communication_points_are_exactly_what_a_perturbation_shows(name):
    """On inputs after a step, which a plant holds; on states and time at the start, where any may be set."""
    model = MODELS[name]
    on_inputs, on_states = observed_feedthrough(model), observed_initially(model, states_of(model) | {"time"})
    seen = {output: on_inputs[output] | on_states[output] for output in on_inputs}
    assert declared(model, "Outputs") == seen
    rates = {v.name for v in model.variables if v.derivative is not None}
    assert declared(model, "Derivatives") == {output: seen[output] for output in seen if output in rates}


def test_thrust_needs_neither_rates_nor_yaw_nor_higher_derivatives():
    depends = declared(QuadrotorController, "Outputs")["F"]
    assert not {name for name in depends if name.startswith(("Omega", "j_d", "s_d", "psi", "R_11"))}
    assert {"r_x", "v_z", "R_33", "a_d_y"} <= depends


# -- simulation ---------------------------------------------------------------------------------------------------


@pytest.mark.full_but("Pendulum", "QuadrotorController")
@fmu
@pytest.mark.interop
@each_model
def test_it_runs_in_fmpy_and_on_its_command_line(fmus, tmp_path, name):
    # In a process of its own, which ends before pythonfmu's exit handler.
    code = """
import os, sys, fmpy
result = fmpy.simulate_fmu(sys.argv[1], stop_time=1.0, output_interval=0.01)
print(len(result), len(result.dtype.names), flush=True)
os._exit(0)
"""
    done = subprocess.run([sys.executable, "-c", code, fmus[name]], capture_output=True, text=True, check=True)
    n_outputs = sum(v.causality == "output" for v in MODELS[name].variables)
    assert done.stdout.split() == ["101", str(1 + n_outputs)]
    # pythonfmu 0.7.0 writes into a freed block of 48 bytes when the process ends, which aborts one in hundreds: a list
    # of freed blocks that is never full keeps that block out of use.
    environment = os.environ | {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=65535"}
    for command in (["validate"], ["simulate", "--output-file", str(tmp_path / "out.csv"), "--stop-time", "0.1"]):
        done = subprocess.run(
            [sys.executable, "-m", "fmpy", command[0], fmus[name], *command[1:]],
            capture_output=True, text=True, env=environment,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
    assert len((tmp_path / "out.csv").read_text().splitlines()) > 2


def damped_pendulum(_, x, force, m, l, b, g):
    """Newton's second law along the tangent, where the speed is l phi_dot."""
    return (x[1], (force - m * g * np.sin(x[0]) - b * l * x[1]) / (m * l))


@fmu
def test_the_pendulum_follows_an_independent_solver(fmus):
    """Largest error over 10 s against DOP853.

    RK4 with h = 5 ms on w = sqrt(g/l) = 3.6 rad/s has a phase error of w (w h)^4 / 120 a second: 3e-9 rad/s, times
    10 s, times the speed 5 rad/s: 2e-7 rad at the most. Halving h divides it by 16.
    """
    start = {"phi": 1.2, "phi_dot": 0.4, "u": 3.0, "m": 2.0, "b": 0.2}
    t = np.arange(1001) * 0.01
    truth = solve_ivp(
        damped_pendulum, (0.0, 10.0), (1.2, 0.4), "DOP853", t, args=(3.0, 2.0, 0.75, 0.2, 9.81), rtol=1e-12, atol=1e-13
    ).y.T  # fmt: skip
    errors = []
    for max_step in (0.005, 0.0025):
        result = host("simulate", fmu=fmus["Pendulum"], n_steps=1000, start={**start, "max_step": max_step})
        errors.append(np.abs(column(result, "phi", "phi_dot") - truth).max())
    assert errors[0] < 2e-7
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)


@fmu
def test_derivative_outputs_are_the_derivatives_of_the_states(fmus):
    """Central differences, h = 10 ms apart: h^2/6 times the third derivative of phi_dot, 200 rad/s^4, is 3e-3."""
    result = host("simulate", fmu=fmus["Pendulum"], n_steps=100, start={"phi": 1.2}, script={"0": {"u": 3.0}})
    x, rates = column(result, "phi", "phi_dot"), column(result, "der(phi)", "der(phi_dot)")
    np.testing.assert_allclose((x[3:] - x[1:-2]) / 0.02, rates[2:-1], atol=3e-3)


@fmu
def test_the_quadrotor_s_attitude_stays_a_rotation(fmus):
    start = {"Omega_x": 1.0, "Omega_y": -2.0, "Omega_z": 3.0}
    result = host("simulate", fmu=fmus["Quadrotor"], n_steps=1600, start=start)
    R = column(result, *(f"R_{i}{j}" for i in "123" for j in "123")).reshape(-1, 3, 3)
    # One Newton step leaves a few units in the last place.
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)


@fmu
def test_a_free_spin_keeps_the_quadrotor_s_angular_momentum(fmus):
    """R J Omega is constant without moments.

    RK4 with h = 5 ms and |Omega| = 3.7 rad/s loses (|Omega| h)^5 / 120 = 2e-11 of it a step: 5e-7 N m s in 16 s.
    """
    start = {"Omega_x": 1.0, "Omega_y": -2.0, "Omega_z": 3.0}
    result = host("simulate", fmu=fmus["Quadrotor"], n_steps=1600, start=start)
    R = column(result, *(f"R_{i}{j}" for i in "123" for j in "123")).reshape(-1, 3, 3)
    momentum = np.einsum("tij,tj->ti", R, column(result, "Omega_x", "Omega_y", "Omega_z") * (1.1, 1.1, 2.2))
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-6)


@fmu
def test_references_start_at_the_start_time(fmus):
    result = host("simulate", fmu=fmus["PendulumReference"], n_steps=2, start={}, start_time=3.0)
    assert column(result, "phi_ref")[0] == pytest.approx(np.pi / 3.0)
    result = host("simulate", fmu=fmus["QuadrotorReference"], n_steps=0, start={}, start_time=1.0)
    expected = [4.0 * np.sin(0.8), 5.0 * np.sin(0.4), 2.0 * np.sin(0.4)]
    np.testing.assert_allclose(column(result, "r_d_x", "r_d_y", "r_d_z")[0], expected, rtol=1e-15)


@fmu
@pytest.mark.parametrize(("smooth", "jump"), [(False, -np.pi), (True, 0.0)], ids=["paper", "smooth"])
def test_the_paper_s_yaw_jumps_and_the_smooth_one_does_not(fmus, smooth, jump):
    result = host("simulate", fmu=fmus["QuadrotorReference"], n_steps=1000, start={"smooth_yaw": smooth})
    steps = np.diff(column(result, "psi_d")[:, 0])
    # Between jumps the yaw moves by at most 0.64 rad/s times 10 ms.
    assert steps[785] == pytest.approx(jump, abs=0.01)
    assert np.abs(np.delete(steps, 785)).max() < 0.01


@fmu
def test_the_controller_hovers_where_it_is_asked_to(fmus):
    result = host("simulate", fmu=fmus["QuadrotorController"], n_steps=1, start={})
    assert column(result, "F", "M_x", "M_y", "M_z")[-1] == pytest.approx([1.25 * 9.81, 0.0, 0.0, 0.0])


# -- state, faults, isolation -------------------------------------------------------------------------------------


@fmu
@each_model
def test_a_rollback_repeats_every_bit_here_and_in_another_instance(fmus, name):
    result = host("rollback", fmu=fmus[name], script=SCRIPTS[name], junk=JUNK[name])
    assert result["statuses"] == [0, 0]
    assert result["at_once"][0] == result["at_once"][1] == result["at_once"][2]
    assert result["rows"][0] == result["rows"][1] == result["rows"][2]
    assert result["rows"][0][0] != result["rows"][0][-1]


@fmu
@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("Pendulum", {"u": float("nan")}, "Pendulum: u must be finite, got nan."),
        ("Quadrotor", {"J_y": float("inf")}, "Quadrotor: J_y must be finite, got inf."),
        ("QuadrotorReference", {"omega": float("nan")}, "QuadrotorReference: omega must be finite, got nan."),
        ("QuadrotorController", {"a_d_z": 9.81}, "desired attitude undefined: the commanded force is zero"),
    ],
)
def test_a_fault_is_logged_and_harms_no_later_instance(fmus, name, values, message):
    result = host("fault", fmu=fmus[name], start={}, values=values, n_times=20)
    # 4 is fmi2Fatal, what pythonfmu makes of every exception; 3 is the level of our own message.
    assert result["statuses"] == [[0, 4]] * 20
    for messages in result["messages"]:
        status, text = messages[0]
        assert status == 3
        assert "Traceback" in text
        assert f"ValueError: {message}" in text


@fmu
def test_a_value_set_at_the_wrong_time_is_refused(fmus):
    result = host("fault", fmu=fmus["Pendulum"], start={}, values={"phi": 1.0}, n_times=1)
    assert result["statuses"][0][0] == 4
    assert "phi must not be set as Real after initialisation" in result["messages"][0][0][1]


@fmu
def test_a_per_cent_sign_in_an_error_reaches_the_logger_doubled(tmp_path):
    script = tmp_path / "faulty.py"
    script.write_text(
        "from fmu_models.blocks import Reference\n"
        "from fmu_models.description import output\n"
        "class Faulty(Reference):\n"
        "    '''Always wrong.'''\n"
        "    table = (output('y', '1', 'Nothing', depends=()),)\n"
        "    def outputs(self, time, parameters):\n"
        "        if time > 0.0: raise ValueError('100 % wrong: %s %n')\n"
        "        return (0.0,)\n"
    )
    package = tmp_path / "package" / "fmu_models"
    package.mkdir(parents=True)
    for source in Path(fmu_models.__file__).parent.glob("*.py"):
        (package / source.name).write_bytes(source.read_bytes())
    with build._imports_restored("faulty"):
        path = FmuBuilder.build_FMU(script, dest=tmp_path / "out", project_files=[package])
    result = host("fault", fmu=str(path), start={}, values={}, n_times=1)
    (status, text), *others = result["messages"][0]
    assert (result["statuses"][0], status) == ([0, 4], 3)
    assert "in outputs" in text
    assert text.rstrip().endswith("ValueError: 100 %% wrong: %%s %%n")
    assert all("%" not in other.replace("%%", "") for _, other in others)


@pytest.mark.full
@fmu
def test_all_share_one_process(fmus):
    rows = host("together", fmus=list(fmus.values()), n_steps=5)["rows"]
    alone = [host("together", fmus=[path], n_steps=5)["rows"][0] for path in fmus.values()]
    assert rows == alone


@fmu
def test_two_versions_share_one_process(fmus, tmp_path):
    root = tmp_path / "other"
    shutil.copytree(Path(fmu_models.__file__).parent, root / "fmu_models")
    changed = (root / "fmu_models" / "pendulum_fmu.py").read_text(encoding="utf-8").replace("0.5, ", "0.7, ")
    (root / "fmu_models" / "pendulum_fmu.py").write_text(changed, encoding="utf-8")
    code = "import sys; from fmu_models import build; build.build('Pendulum', sys.argv[1])"
    subprocess.run([sys.executable, "-P", "-c", code, root], check=True, env=os.environ | {"PYTHONPATH": str(root)})
    rows = host("together", fmus=[fmus["Pendulum"], str(root / "Pendulum.fmu")], n_steps=0)["rows"]
    assert [row[0] for row in rows] == [0.5, 0.7]


@fmu
def test_an_fmu_loads_after_the_folder_of_another_is_gone(fmus):
    """simulate_fmu deletes the folder that it unpacked into, in a process that goes on."""
    code = """
import sys, fmpy
sys.meta_path = [f for f in sys.meta_path if not f.__module__.startswith("__editable__")]  # it finds our own package
print([len(fmpy.simulate_fmu(path, stop_time=0.1)) > 1 for path in sys.argv[1:]])
"""
    command = [sys.executable, "-I", "-c", code, fmus["FrictionPendulum"], fmus["QuadrotorController"]]
    environment = os.environ | {"GLIBC_TUNABLES": "glibc.malloc.tcache_count=65535"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (0, "[True, True]\n"), done.stderr


@fmu
@each_model
def test_an_fmu_brings_all_it_needs(fmus, name):
    """Loaded in an interpreter without site-packages: whatever is not the standard library is in the FMU."""
    modules = host("modules", fmu=fmus[name])
    package = f"fmu_models_{build.guid(name)[:8]}"
    for module in ("pythonfmu", package, f"{package}.slave"):
        assert "/resources/" in modules[module].replace("\\", "/")


@pytest.mark.full_but("Pendulum")
@fmu
@each_model
def test_the_script_s_namespace_outlives_many_instances(fmus, name):
    """pythonfmu drops a reference to it at every load."""
    result = host("fault", fmu=fmus[name], start={}, values={}, n_times=40)
    assert result["statuses"] == [[0, 0]] * 40
    assert result["messages"] == [[]] * 40


@fmu
@each_model
def test_the_shipped_description_is_the_class_s_own(fmus, name):
    with zipfile.ZipFile(fmus[name]) as archive:
        shipped = ElementTree.fromstring(archive.read("modelDescription.xml"))
    expected = MODELS[name](instance_name="one").to_xml()
    expected.set("guid", build.guid(name))

    def rows(root):
        return [(element.tag, element.attrib) for element in root.iter()]

    assert rows(shipped) == rows(expected)
