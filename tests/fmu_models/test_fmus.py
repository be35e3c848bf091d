"""The FMUs, in hosts that have nothing but the FMU: see fmu_host.py."""

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

import fmu_models
from fmu_models import build
from fmu_models.build import MODELS
from tests.fmu_models.scripts import JUNK, script_of, values_of

ONE_OF_EACH_KIND = ("Quadrotor", "QuadrotorController", "QuadrotorReference", "PendulumControllerAdaptive")
each_model = pytest.mark.parametrize("name", build.NAMES)
each_fmu = pytest.mark.parametrize(
    ("fmi", "name"),
    [
        pytest.param(fmi, name, id=f"{name}-{fmi}", marks=() if name in ONE_OF_EACH_KIND else pytest.mark.full)
        for name in build.NAMES
        for fmi in (2, 3)
    ],
)
fmu = pytest.mark.fmu


@pytest.fixture(scope="session")
def fmus(built):
    """Paths of all FMUs of FMI 2.0, by name."""
    return built[2]


def column(result, *names):
    rows = np.array(result["rows"])
    return rows[:, [result["names"].index(name) for name in names]]


# -- model descriptions -------------------------------------------------------------------------------------------


@fmu
@pytest.mark.full_but("3")
@pytest.mark.parametrize("kind", [2, 3, "me"])
def test_the_descriptions_are_valid(built, kind):
    assert {name: validate_fmu(path) for name, path in built[kind].items()} == {name: [] for name in built[kind]}


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
    ("name", "n_states"),
    [("FrictionPendulum", 2), ("MagneticLevitation", 2), ("Pendulum", 2), ("Quadrotor", 18), ("RigidBody", 18)],
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
    def value(v):
        real = (v.start or 0.0) * rng.uniform(0.7, 1.3) + rng.uniform(0.05, 0.4)
        return real if v.max is None else min(real, v.max)

    return [rng.random() < 0.5 if v.type == "Boolean" else value(v) for v in model.variables if v.start is not None]


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
            new = not values[i] if v.type == "Boolean" else moved(v, values[i], rng)
            see(changed, v.name, base, outputs_of(values, [*values[:i], new, *values[i + 1 :]], time))
        if "time" in among:
            see(changed, "time", base, outputs_of(values, values, time + rng.uniform(-1.0, 1.0)))
    return changed


def moved(variable, value, rng):
    """Another value of a Real, within its bounds."""
    value += rng.uniform(0.1, 0.5) + 8.0 * (variable.unit == "s")
    if variable.max is None or value <= variable.max:
        return value
    return rng.uniform(variable.min, variable.max)


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


@pytest.mark.sampled(3)
@each_model
def test_initial_dependencies_are_exactly_what_a_perturbation_shows(name):
    model = MODELS[name]
    seen = observed_initially(model, {v.name for v in model.variables})
    unknowns = declared(model, "InitialUnknowns")
    assert unknowns == {k: v for k, v in seen.items() if k in unknowns}
    assert set(unknowns) == {v.name for v in model.variables if v.initial == "calculated"}


@pytest.mark.sampled(3)
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
    depends = declared(MODELS["QuadrotorController"], "Outputs")["F"]
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


@fmu
def test_derivative_outputs_are_the_derivatives_of_the_states(fmus, host):
    """Central differences, h = 10 ms apart: h^2/6 times the third derivative of phi_dot, 200 rad/s^4, is 3e-3."""
    result = host("simulate", fmu=fmus["Pendulum"], n_steps=100, start={"phi": 1.2}, script={"0": {"u": 3.0}})
    x, rates = column(result, "phi", "phi_dot"), column(result, "der(phi)", "der(phi_dot)")
    np.testing.assert_allclose((x[3:] - x[1:-2]) / 0.02, rates[2:-1], atol=3e-3)


@fmu
def test_the_quadrotor_s_attitude_stays_a_rotation(fmus, host):
    start = {"Omega_x": 1.0, "Omega_y": -2.0, "Omega_z": 3.0}
    result = host("simulate", fmu=fmus["Quadrotor"], n_steps=1600, start=start)
    R = column(result, *(f"R_{i}{j}" for i in "123" for j in "123")).reshape(-1, 3, 3)
    # One Newton step leaves a few units in the last place.
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-14)


@fmu
def test_a_free_spin_keeps_the_quadrotor_s_angular_momentum(fmus, host):
    """R J Omega is constant without moments.

    RK4 with h = 5 ms and |Omega| = 3.7 rad/s loses (|Omega| h)^5 / 120 = 2e-11 of it a step: 5e-7 N m s in 16 s.
    """
    start = {"Omega_x": 1.0, "Omega_y": -2.0, "Omega_z": 3.0}
    result = host("simulate", fmu=fmus["Quadrotor"], n_steps=1600, start=start)
    R = column(result, *(f"R_{i}{j}" for i in "123" for j in "123")).reshape(-1, 3, 3)
    momentum = np.einsum("tij,tj->ti", R, column(result, "Omega_x", "Omega_y", "Omega_z") * (1.1, 1.1, 2.2))
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-6)


@fmu
def test_references_start_at_the_start_time(fmus, host):
    result = host("simulate", fmu=fmus["PendulumReference"], n_steps=2, start={}, start_time=3.0)
    assert column(result, "phi_ref")[0] == pytest.approx(np.pi / 3.0)
    result = host("simulate", fmu=fmus["QuadrotorReference"], n_steps=0, start={}, start_time=1.0)
    expected = [4.0 * np.sin(0.8), 5.0 * np.sin(0.4), 2.0 * np.sin(0.4)]
    np.testing.assert_allclose(column(result, "r_d_x", "r_d_y", "r_d_z")[0], expected, rtol=1e-15)


@fmu
@pytest.mark.parametrize(("smooth", "jump"), [(False, -np.pi), (True, 0.0)], ids=["paper", "smooth"])
def test_the_paper_s_yaw_jumps_and_the_smooth_one_does_not(fmus, smooth, jump, host):
    result = host("simulate", fmu=fmus["QuadrotorReference"], n_steps=1000, start={"smooth_yaw": smooth})
    steps = np.diff(column(result, "psi_d")[:, 0])
    # Between jumps the yaw moves by at most 0.64 rad/s times 10 ms.
    assert steps[785] == pytest.approx(jump, abs=0.01)
    assert np.abs(np.delete(steps, 785)).max() < 0.01


@fmu
def test_the_controller_hovers_where_it_is_asked_to(fmus, host):
    result = host("simulate", fmu=fmus["QuadrotorController"], n_steps=1, start={})
    assert column(result, "F", "M_x", "M_y", "M_z")[-1] == pytest.approx([1.25 * 9.81, 0.0, 0.0, 0.0])


# -- state, faults, isolation -------------------------------------------------------------------------------------


@pytest.mark.sampled(3)
@fmu
@each_fmu
def test_a_rollback_repeats_every_bit_here_and_in_another_instance(built, host, fmi, name):
    script, junk = script_of(fmi, name), values_of(fmi, name, JUNK[name])
    result = host("rollback", fmu=built[fmi][name], script=script, junk=junk)
    assert result["statuses"] == [0, 0]
    assert result["at_once"][0] == result["at_once"][1] == result["at_once"][2]
    assert result["rows"][0] == result["rows"][1] == result["rows"][2]
    assert result["rows"][0][0] != result["rows"][0][-1]


@fmu
@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("Quadrotor", {"M": [0.0, float("nan"), 0.0]}, "Quadrotor: M_y must be finite, got nan."),
        ("QuadrotorReference", {"omega": float("inf")}, "QuadrotorReference: omega must be finite, got inf."),
        ("QuadrotorController", {"a_d": [0.0, 0.0, 9.81]}, "desired attitude undefined: the commanded force is zero"),
    ],
    ids=["plant", "reference", "controller"],
)
def test_a_fault_is_logged_and_harms_no_later_instance(built, host, fmi, name, values, message):
    result = host("fault", fmu=built[fmi][name], values=values_of(fmi, name, values), n_times=20)
    # fmi2Discard, all that pythonfmu can say of a step beside fatal, and fmi3Error; 3 is the level of our own message.
    assert result["statuses"] == [[0, {2: 2, 3: 3}[fmi]]] * 20
    for messages in result["messages"]:
        status, text = messages[0]
        assert status == 3
        assert "Traceback" in text
        assert f"ValueError: {message}" in text


@fmu
def test_a_value_set_at_the_wrong_time_is_refused(fmus, host):
    result = host("fault", fmu=fmus["Pendulum"], start={}, values={"phi": 1.0}, n_times=1)
    assert result["statuses"][0][0] == 4
    assert "phi must not be set as Real after initialisation" in result["messages"][0][0][1]


@fmu
@pytest.mark.parametrize("fmi", [2, 3])
def test_after_a_refused_call_an_instance_can_be_reset_restored_and_freed(built, host, fmi):
    """FMI 2.0.4, section 2.1.3, and 3.0.2, section 2.2.4, ask for `error`; pythonfmu's libraries have only `fatal`."""
    result = host("refusals", fmu=built[fmi]["Pendulum"])
    assert len(result["statuses"]) == {2: 8, 3: 9}[fmi]
    for function, (refused, after) in result["statuses"].items():
        assert (function, refused, after) == (function, 4, [0, 0, 0, 0, True, 0])
    if fmi == 3:
        assert any("has no event mode" in text and "eventModeUsed = false" in text for _, text in result["messages"])


@fmu
def test_a_per_cent_sign_in_an_error_reaches_the_logger_doubled(host, tmp_path):
    script = (
        "from fmu_models.kernel.blocks import ReferenceSlave\n"
        "from fmu_models.kernel.description import output\n"
        "class Faulty(ReferenceSlave):\n"
        "    '''Always wrong.'''\n"
        "    table = (output('y', '1', 'Nothing', depends=()),)\n"
        "    def outputs(self, time, parameters):\n"
        "        if time > 0.0: raise ValueError('100 % wrong: %s %n')\n"
        "        return (0.0,)\n"
    )
    files = {"faulty_fmu.py": script.encode(), **build.sources(build.PACKAGE)}
    path = build.assemble("Faulty", "faulty_fmu", files, {}, tmp_path)
    result = host("fault", fmu=str(path), start={}, values={}, n_times=1)
    (status, text), *others = result["messages"][0]
    assert (result["statuses"][0], status) == ([0, 2], 3)
    assert "in outputs" in text
    assert text.rstrip().endswith("ValueError: 100 %% wrong: %%s %%n")
    assert all("%" not in other.replace("%%", "") for _, other in others)


@pytest.mark.full
@fmu
def test_all_share_one_process(fmus, host):
    rows = host("together", fmus=list(fmus.values()), n_steps=5)["rows"]
    alone = [host("together", fmus=[path], n_steps=5)["rows"][0] for path in fmus.values()]
    assert rows == alone


@fmu
def test_two_versions_share_one_process(fmus, tmp_path, host):
    root = tmp_path / "other"
    shutil.copytree(Path(fmu_models.__file__).parent, root / "fmu_models")
    changed = (root / "fmu_models" / "pendulum" / "plant.py").read_text(encoding="utf-8").replace("0.5, ", "0.7, ")
    (root / "fmu_models" / "pendulum" / "plant.py").write_text(changed, encoding="utf-8")
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


@pytest.mark.sampled(3)
@fmu
@each_fmu
def test_an_fmu_brings_all_it_needs(built, host, fmi, name):
    """Loaded in an interpreter without site-packages: whatever is not the standard library is in the FMU."""
    modules = host("modules", fmu=built[fmi][name])
    suffix = build.guid(name, fmi)[:8]
    libraries = ["pythonfmu"] if fmi == 2 else [f"pythonfmu_{suffix}", "pythonfmu3"]
    for module in (*libraries, f"fmu_models_{suffix}", f"fmu_models_{suffix}.kernel.slave"):
        assert "/resources/" in modules[module].replace("\\", "/")
    assert "numpy" not in modules


@pytest.mark.full_but("Pendulum-2")
@fmu
@each_fmu
def test_the_script_s_namespace_outlives_many_instances(built, host, fmi, name):
    """The loaders drop a reference to it at every load."""
    result = host("fault", fmu=built[fmi][name], values={}, n_times=40)
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
