"""The FMUs in FMI 3.0: the same behaviour behind arrays, and model exchange of the plants."""

import json
import random
import re
import subprocess
import sys

import fmpy
import numpy as np
import pytest
from pythonfmu3 import Fmi3Status
from scipy.integrate import solve_ivp

from fmu_models import build
from fmu_models.kernel.arrays import arrays
from fmu_models.kernel.blocks import ReferenceSlave
from fmu_models.kernel.description import input_variable, output, parameter, state
from fmu_models.kernel.description3 import variables_of
from fmu_models.kernel.fmi3 import Fmi3CoSimulation, Fmi3ModelExchange
from tests.fmu_models.scripts import script_of, values_of

ROTATION = [[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]]
STARTS = {"Quadrotor": {"R": ROTATION, "Omega": [1.0, -2.0, 3.0], "max_step": 0.002}, "RigidBody": {"R": ROTATION}}
each_model = pytest.mark.parametrize("name", build.NAMES)
each_plant = pytest.mark.parametrize("name", build.PLANTS)
fmu = pytest.mark.fmu


def model_of(name):
    return build.MODELS[name]


def exchange(name):
    """A model-exchange instance of the plant, as the entry script makes it, without an FMU."""
    return type(name, (Fmi3ModelExchange,), {"model": model_of(name)})(instance_name="one")


def co_simulation(name):
    return type(name, (Fmi3CoSimulation,), {"model": model_of(name)})(instance_name="one")


# -- arrays ---------------------------------------------------------------------------------------------------------


def vector(name, **options):
    return [parameter(f"{name}_{a}", "m", 1.0, f"Size, body {a}", **options) for a in "xyz"]


def test_three_axes_are_a_vector_and_nine_elements_a_matrix():
    matrix = [state(f"R_{i}{j}", "1", 0.0, f"Attitude, row {i}, column {j}", depends=()) for i in "123" for j in "123"]
    found = arrays([*vector("c"), input_variable("u", "N", 0.0, "Force"), *matrix])
    assert [(a.name, a.shape, len(a.members)) for a in found] == [("c", (3,), 3), ("u", (), 1), ("R", (3, 3), 9)]
    assert [a.description for a in found] == ["Size, body x, y, z", "Force", "Attitude, row by row"]


@pytest.mark.parametrize(
    "table",
    [
        vector("c")[:2],
        [*vector("c")[:2], parameter("c_z", "kg", 1.0, "Other unit")],
        [*vector("c")[:2], parameter("c_z", "m", 1.0, "Other bounds", min=0.0)],
        [*vector("c")[:2], parameter("d", "m", 1.0, "Between"), vector("c")[2]],
        [*vector("c"), parameter("c", "m", 1.0, "Has the name already")],
        vector("c")[::-1],
    ],
    ids=["two", "unit", "bounds", "apart", "name taken", "order"],
)
def test_what_is_no_array_stays_scalar(table):
    assert all(a.shape == () for a in arrays(table))


@each_model
def test_elements_keep_their_order_and_none_is_lost(name):
    variables = variables_of(model_of(name).variables)
    assert [m for a in variables for m in a.members if m.name != "time"] == [
        v for v in model_of(name).variables if v.name != "time"
    ]
    assert len({a.name for a in variables}) == len(variables)


# -- descriptions ---------------------------------------------------------------------------------------------------


@pytest.mark.full_but("Pendulum", "QuadrotorController")
@fmu
@each_model
def test_every_variable_is_described(built, name):
    description = fmpy.read_model_description(built[3][name])
    assert description.coSimulation.canGetAndSetFMUstate
    assert description.coSimulation.canSerializeFMUstate
    units = {unit.name for unit in description.unitDefinitions}
    for v in description.modelVariables:
        assert v.description
        assert v.type == "Boolean" or v.unit in units
    assert [v.causality for v in description.modelVariables].count("independent") == 1


@fmu
def test_the_quadrotor_s_arrays_are_these(built):
    variables = {v.name: v for v in fmpy.read_model_description(built[3]["Quadrotor"]).modelVariables}
    assert {name: v.shape for name, v in variables.items() if v.shape} == {
        "J": (3,), "M": (3,), "F_d": (3,), "M_d": (3,), "r": (3,), "v": (3,), "R": (3, 3), "Omega": (3,),
        "M_held": (3,), "F_d_held": (3,), "M_d_held": (3,),
        "der(r)": (3,), "der(v)": (3,), "der(R)": (3, 3), "der(Omega)": (3,),
    }  # fmt: skip
    assert variables["R"].start.split() == ["1.0", "0.0", "0.0", "0.0", "1.0", "0.0", "0.0", "0.0", "1.0"]
    assert variables["der(R)"].derivative is variables["R"]
    assert (variables["J"].min, variables["J"].max, variables["J"].unit) == ("0.1", "12.0", "kg.m2")


def declared(model, section):
    """Names that the unknowns of a section depend on, by unknown."""
    xml = model.to_xml()
    names = {v.get("valueReference"): v.get("name") for v in xml.find("ModelVariables")}
    return {
        names[u.get("valueReference")]: {names[i] for i in u.get("dependencies").split()}
        for u in xml.find("ModelStructure").iter(section)
    }


@each_plant
def test_derivatives_depend_on_exactly_what_a_perturbation_shows(name):
    """States and inputs of model exchange, each array perturbed at random points element by element."""
    model, rng = exchange(name), random.Random(1)
    variables = {v.get("name"): v for v in model.to_xml().find("ModelVariables")}
    reference = {n: int(v.get("valueReference")) for n, v in variables.items()}
    size = {n: int(np.prod([int(d.get("start")) for d in v.iter("Dimension")] or [1])) for n, v in variables.items()}
    rates = {n: v for n, v in variables.items() if v.get("derivative")}
    inputs = [n for n, v in variables.items() if v.get("causality") == "input"]
    states = [n for n, i in reference.items() if str(i) in {v.get("derivative") for v in rates.values()}]
    seen = {n: set() for n in rates}
    parameters = [n for n, v in variables.items() if v.get("causality") == "parameter"]
    for _ in range(60):
        for known in parameters:  # a start of zero hides a dependency
            starts = map(float, variables[known].get("start").split())
            values = [
                x + min(rng.uniform(0.01, 0.1), 0.5 * (float(variables[known].get("max", "inf")) - x)) for x in starts
            ]
            model.set_float64([reference[known]], values)
        for known in (*states, *inputs):
            model.set_float64([reference[known]], [rng.uniform(-1.0, 1.0) for _ in range(size[known])])
        before = {n: model.get_float64([reference[n]]) for n in rates}
        for known in (*states, *inputs):
            old = model.get_float64([reference[known]])
            for k in range(size[known]):
                model.set_float64([reference[known]], [*old[:k], old[k] + rng.uniform(1.0, 5.0), *old[k + 1 :]])
                for n in rates:
                    if model.get_float64([reference[n]]) != before[n]:
                        seen[n].add(known)
            model.set_float64([reference[known]], old)
    assert declared(model, "ContinuousStateDerivative") == seen
    assert declared(model, "Output") == {n: {n} for n in states}


@each_plant
def test_co_simulation_declares_no_feedthrough_and_model_exchange_all_inputs(name):
    inputs = {a.name for a in variables_of(model_of(name).variables) if a.members[0].causality == "input"}
    held = declared(co_simulation(name), "Output")
    assert all(not depends & inputs for depends in held.values())
    assert set.union(*declared(exchange(name), "ContinuousStateDerivative").values()) >= inputs


@pytest.mark.parametrize(
    "name",
    ["MagneticLevitationReference", "PendulumReference", "QuadrotorReference", "RigidBodyReference", "PendulumSine"],
)
def test_references_depend_on_time(name):
    outputs = declared(co_simulation(name), "Output")
    assert {output for output, depends in outputs.items() if depends != {"time"}} <= {"phi_dot_ref"}
    assert {"time"} in outputs.values()


# -- co-simulation --------------------------------------------------------------------------------------------------


@pytest.mark.full_but("Pendulum", "QuadrotorControllerAdaptive")
@fmu
@each_model
def test_it_computes_bit_for_bit_what_the_fmi_2_fmu_does(built, host, name):
    runs = [
        host(
            "simulate", fmu=built[fmi][name], n_steps=50,
            start=values_of(fmi, name, STARTS.get(name, {})), script=script_of(fmi, name),
        ) for fmi in (2, 3)
    ]  # fmt: skip
    assert runs[0]["rows"] == runs[1]["rows"]
    assert runs[0]["rows"][0] != runs[0]["rows"][-1]


def test_texts_for_the_logger_are_no_formats():
    class Faulty(ReferenceSlave):
        """Always wrong."""

        table = (output("y", "1", "Nothing", depends=()),)

        def outputs(self, time, parameters):
            raise ValueError("100 % wrong")

    model = type("Faulty", (Fmi3CoSimulation,), {"model": Faulty})(instance_name="one")
    with pytest.raises(ValueError, match="100 % wrong"):
        model.get_float64([0])
    (message,) = model._get_log_queue()  # pythonfmu3's loader takes the messages there
    assert message.msg.rstrip().endswith("ValueError: 100 % wrong")


@pytest.mark.parametrize(
    ("vrs", "values", "reason"),
    [
        ([1], [1.0, 2.0], "Quadrotor: 3 values must be set, got 2."),
        ([99], [1.0], "Quadrotor: no variable has the value reference 99."),
        ([-1], [1.0], "Quadrotor: no variable has the value reference -1."),
        ([12], [0.0] * 9, "Quadrotor: R_11 must not be set as Real after initialisation."),
    ],
)
def test_a_wrong_set_is_refused(vrs, values, reason):
    model = co_simulation("Quadrotor")
    model.exit_initialization_mode()
    with pytest.raises(ValueError, match=re.escape(reason)):
        model.set_float64(vrs, values)


def test_time_is_the_communication_point():
    model = co_simulation("Quadrotor")
    vr = len(variables_of(model.table())) - 1
    assert model.get_float64([vr, 0]) == [0.0, 1.25]
    model.exit_initialization_mode()
    model.do_step(0.5, 0.25)
    assert model.get_float64([0, vr]) == [1.25, 0.75]
    saved = model._get_fmu_state()
    model.do_step(0.75, 0.25)
    model._set_fmu_state(saved)
    assert model.get_float64([vr]) == [0.75]


def test_a_step_that_cannot_be_taken_is_an_error_and_the_time_stays():
    model = co_simulation("Quadrotor")
    model.exit_initialization_mode()
    assert model.do_step(0.0, 0.25).status == Fmi3Status.ok
    assert model.do_step(0.0, 0.25).status == Fmi3Status.error
    assert model.time == 0.25
    assert model.do_step(0.25, 0.25).status == Fmi3Status.ok


# -- FMPy -----------------------------------------------------------------------------------------------------------

SIMULATE = """
import json, os, sys, fmpy, numpy as np
path, options = sys.argv[1], json.loads(sys.argv[2])
result = fmpy.simulate_fmu(path, output_interval=0.01, **options)
print(json.dumps({name: result[name].tolist() for name in result.dtype.names}), flush=True)
os._exit(0)
"""


def simulated(path, **options):
    """FMPy's simulate_fmu in a process of its own, which ends before the library's exit handler."""
    command = [sys.executable, "-c", SIMULATE, path, json.dumps(options)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return {name: np.array(values) for name, values in json.loads(done.stdout).items()}


@pytest.mark.full_but("Pendulum", "Quadrotor")
@fmu
@each_model
def test_it_runs_in_fmpy(built, name):
    result = simulated(built[3][name], stop_time=1.0)
    outputs = [a for a in variables_of(model_of(name).variables) if a.members[0].causality == "output"]
    assert {k: v.shape for k, v in result.items()} == {"time": (101,)} | {a.name: (101, *a.shape) for a in outputs}


@fmu
def test_model_exchange_in_fmpy_s_cvode_follows_an_independent_solver(built):
    """The free spin of the quadrotor: Euler's equations and R_dot = R hat(Omega), by DOP853 from matrices.

    CVode keeps its local error below rtol = 1e-10; over 2 s at |Omega| = 3.7 rad/s the global one stays below 1e-7.
    """
    J, Omega_0 = np.diag([1.1, 1.1, 2.2]), np.array([1.0, -2.0, 3.0])

    def spin(_, y):
        R, Omega = y[:9].reshape(3, 3), y[9:]
        p, q, r = Omega
        return np.concatenate(
            [(R @ [[0, -r, q], [r, 0, -p], [-q, p, 0]]).ravel(), np.linalg.solve(J, -np.cross(Omega, J @ Omega))]
        )

    truth = solve_ivp(spin, (0.0, 2.0), [*np.ravel(ROTATION), *Omega_0], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    start = {"Omega": Omega_0.tolist(), "R": np.ravel(ROTATION).tolist()}
    result = simulated(built["me"]["Quadrotor"], stop_time=2.0, start_values=start, relative_tolerance=1e-10)
    np.testing.assert_allclose(result["R"][-1].ravel(), truth[:9], atol=1e-7)
    np.testing.assert_allclose(result["Omega"][-1], truth[9:], atol=1e-7)


# -- model exchange -------------------------------------------------------------------------------------------------


def test_the_derivatives_follow_the_inputs_after_initialisation():
    model = exchange("Pendulum")
    u = [a.name for a in variables_of(model.table())].index("u")
    model.exit_initialization_mode()
    model.set_continuous_states([0.0, 0.0])
    model.set_float64([u], [1.75 * 0.75])
    assert model.get_continuous_state_derivatives() == [0.0, 1.0]
    model.set_float64([u], [2.0 * 1.75 * 0.75])
    assert model.get_continuous_state_derivatives() == [0.0, 2.0]
    assert model.get_number_of_continuous_states() == 2
    assert model.get_nominals_of_continuous_states(2) == [1.0, 1.0]


def test_states_and_fixed_parameters_are_frozen_after_initialisation():
    model = exchange("Pendulum")
    names = [a.name for a in variables_of(model.table())]
    model.set_float64([names.index("phi")], [0.3])
    model.exit_initialization_mode()
    assert model.get_continuous_states() == [0.3, 0.0]
    model.set_float64([names.index("m")], [2.0])
    for name in ("phi", "time"):
        with pytest.raises(ValueError, match=f"Pendulum: {name} must not be set after initialisation"):
            model.set_float64([names.index(name)], [0.1])


@each_plant
def test_model_exchange_has_neither_lag_nor_step_nor_held_inputs(name):
    table = {v.name: v for v in exchange(name).table()}
    assert not [n for n in table if n.endswith("_held") or n in ("tau_u", "max_step")]
    assert {v.causality for v in table.values() if v.derivative} == {"local"}
    assert not [v.description for v in table.values() if "held" in v.description]
