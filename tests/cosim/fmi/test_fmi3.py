"""FMI 3.0 FMUs in the master: alone, and mixed with those of FMI 2.0."""

import math
import re

import numpy as np
import pytest

from cosim import ModelDescriptionError, Scenario, SlaveError, WiringError, open_slave, run
from cosim.fmi.archive import read_description
from cosim.fmi.elements import handle
from cosim.fmi.value_buffers import ScalarVariable
from cosim.fmi.value_buffers3 import buffers3_of, overlaid
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu


@pytest.fixture
def quadrotor(tmp_path):
    """An FMI 3.0 quadrotor with some elements bound, initialised; and the same in FMI 2.0."""
    opened = []

    def slave(fmi=3, isolation="process", start=None):
        path = find_fmu("Quadrotor", tmp_path, fmi)
        opened.append(open_slave(path, "plant", isolation=isolation))
        names = (["F", "M[2]"], ["m", "J[3]"], ["r[3]", "R[1,3]", "Omega[2]", "der(Omega[2])"])
        plain = (["F", "M_y"], ["m", "J_z"], ["r_z", "R_13", "Omega_y", "der(Omega_y)"])
        opened[-1].bind(*(names if fmi == 3 else plain))
        opened[-1].initialize(start or {}, 0.0, 1.0)
        return opened[-1]

    yield slave
    for one in opened:
        one.close()


def steps(slave, n):
    return [slave.step([13.0 + k, 0.1], 0.01 * k, 0.01, [1.5, 3.0] if k == 2 else None) for k in range(n)]


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_elements_are_set_and_got_as_the_scalars_of_fmi_2(quadrotor, isolation):
    starts = {"R[1,1]": 0.6, "R[1,2]": -0.8, "R[2,1]": 0.8, "R[2,2]": 0.6, "Omega[1]": 1.0, "max_step": 0.002}
    flat = {"R_11": 0.6, "R_12": -0.8, "R_21": 0.8, "R_22": 0.6, "Omega_x": 1.0, "max_step": 0.002}
    three, two = quadrotor(3, isolation, starts), quadrotor(2, start=flat)
    assert three.get() == two.get()
    assert steps(three, 5) == steps(two, 5)


def test_elements_that_nobody_names_keep_their_values(quadrotor):
    """J = (5, 1.1, 2.2) at the start; J[3] = 3 is written later: J[1] is still 5, and gyrates."""
    three = quadrotor(3, start={"J[1]": 5.0, "Omega[1]": 1.0, "Omega[3]": 1.0})
    two = quadrotor(2, start={"J_x": 5.0, "Omega_x": 1.0, "Omega_z": 1.0})
    assert steps(three, 5) == steps(two, 5)
    # Euler: J_y Omega_y' = M_y - (J_x - J_z) Omega_x Omega_z, at first with J_z = 2.2 and no moment
    assert quadrotor(3, start={"J[1]": 5.0, "Omega[1]": 1.0, "Omega[3]": 1.0}).get()[3] == pytest.approx(-2.8 / 1.1)


def test_inputs_reach_the_outputs_in_initialization_mode(tmp_path):
    """The controller of a hovering quadrotor asks for m (g - a_d_z): F = -A . R e3, with no error of position."""
    path = find_fmu("QuadrotorController", tmp_path, 3)
    with open_slave(path, "controller") as slave:
        slave.bind(["a_d[3]"], [], ["F"])
        slave.enter_initialization({}, 0.0, 1.0)
        for a_d in (0.0, 1.0):
            assert slave.propagate([a_d]) == (pytest.approx(1.25 * (9.81 - a_d)),)
        slave.exit_initialization()
        assert slave.step([2.0], 0.0, 0.01) == (pytest.approx(1.25 * 7.81),)


def test_a_state_is_gone_back_to(quadrotor):
    slave = quadrotor()
    steps(slave, 3)
    state = slave.get_state()
    after = slave.step([20.0, 0.5], 0.03, 0.01)
    slave.step([1.0, -0.5], 0.04, 0.01)
    slave.set_state(state)
    assert slave.step([20.0, 0.5], 0.03, 0.01) == after


@pytest.mark.parametrize("isolation", ["process", "none"])
def test_a_fault_names_function_and_reason_and_harms_nothing_else(tmp_path, isolation):
    controller = find_fmu("QuadrotorController", tmp_path, 3)
    for _ in range(3):
        with open_slave(controller, "controller", isolation=isolation) as slave:
            slave.bind(["a_d[3]"], [], ["F"])
            slave.initialize({})
            reason = "controller: do_step at t = 0.000 s returned error: ValueError: desired attitude undefined"
            with pytest.raises(SlaveError, match=re.escape(reason)):
                slave.step([9.81], 0.0, 0.01)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((["r[1]"], [], []), "'r[1]' of Quadrotor.fmu is an output, not an input"),
        ((["M"], [], []), "no variable 'M' in Quadrotor.fmu"),
        (([], ["max_step"], []), "'max_step' of Quadrotor.fmu is a fixed parameter, not a tunable parameter"),
    ],
)
def test_wrong_names_are_refused(quadrotor, arguments, reason):
    slave = quadrotor()
    with pytest.raises(WiringError, match=re.escape(reason)):
        slave.bind(*arguments)


def test_a_value_outside_its_bounds_does_not_reach_the_fmu(quadrotor):
    slave = quadrotor()
    with pytest.raises(SlaveError, match=re.escape("parameter 'J[3]' must be within [0.1, 12] kg.m2, got 13")):
        slave.step([1.0, 0.0], 0.0, 0.01, [1.0, 13.0])
    assert slave.step([13.0, 0.0], 0.0, 0.01, [1.0, 3.0])[0] != 0.0


def test_a_co_simulation_fmu_is_no_model(tmp_path):
    with pytest.raises(ModelDescriptionError, match=r"is an FMI 2.0 co-simulation FMU, not FMI 2.0 or 3.0 model"):
        read_description(find_fmu("Pendulum", tmp_path), "model-exchange")


# -- whole runs -----------------------------------------------------------------------------------------------------

ALL = ("plant", "controller", "reference")


def versions(*components):
    return {f"components.{component}.fmi": "3" for component in components}


@pytest.mark.full
@pytest.mark.parametrize("three", [("plant",), ("controller", "reference"), ALL], ids="-".join)
def test_a_re_tuned_pendulum_is_the_same_bit_for_bit(pendulum, three):
    at_once = {"estimation.trigger": '{ kind = "always" }'}
    two = run(pendulum(at_once), seed=1)
    mixed = run(pendulum(at_once | versions(*three)), seed=1)
    assert mixed.status == "done"
    assert len(two.latencies) > 0
    for name in ("plant.phi", "controller.u", "controller.m", "controller.l"):
        np.testing.assert_array_equal(mixed[name], two[name])


@pytest.mark.full_but("plant-none")
@pytest.mark.parametrize("isolation", ["process", "none"])
@pytest.mark.parametrize("three", [("plant",), ("controller",), ALL], ids="-".join)
def test_the_quadrotor_scenario_runs_on_either_version_mixed(three, isolation):
    short = {"scenario.stop_time": "0.5", "scenario.isolation": f'"{isolation}"'}
    two = run(Scenario.load("quadrotor", short), "true")
    mixed = run(Scenario.load("quadrotor", short | versions(*three)), "true")
    assert mixed.status == "done"
    for axis, i in zip("xyz", (1, 2, 3), strict=True):
        name = f"plant.r[{i}]" if "plant" in three else f"plant.r_{axis}"
        np.testing.assert_array_equal(mixed[name], two[f"plant.r_{axis}"])
    assert mixed.mse == two.mse


# -- arrays of values -----------------------------------------------------------------------------------------------


def test_a_buffer_sets_whole_arrays_and_reads_single_elements():
    arrays = {1: [0.0, 10.0, 20.0], 2: [5.0]}
    variables = [ScalarVariable("b", "Float64", 2), ScalarVariable("a[3]", "Float64", handle(1, 2))]
    (buffer,) = buffers3_of(variables, arrays)
    buffer.start(arrays)
    buffer.fill([6.0, 22.0])
    references, n, values, total = buffer.arguments
    assert (list(references), n, list(values), total) == ([2, 1], 2, [6.0, 0.0, 10.0, 22.0], 4)
    assert list(buffer.read()) == [6.0, 22.0]
    buffer.clear()
    assert all(math.isnan(value) for value in buffer.read())


def test_variables_of_different_types_are_different_buffers():
    variables = [ScalarVariable("a", "Float64", 0), ScalarVariable("n", "Int32", 1), ScalarVariable("b", "Float64", 2)]
    buffers = buffers3_of(variables, {0: [0.0], 1: [0.0], 2: [0.0]})
    assert [(b.setter, b.positions) for b in buffers] == [
        ("fmi3SetFloat64", (0, 2)),
        ("fmi3SetInt32", (1,)),
    ]


def test_values_overlay_single_elements():
    assert overlaid({1: [0.0, 1.0], 2: [3.0]}, {handle(1, 1): 7.0}) == {1: [0.0, 7.0], 2: [3.0]}
