"""Arrays as their elements, and the two spellings of a name."""

import fmpy
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.errors import WiringError
from cosim.fmi.archive import read_description
from cosim.fmi.elements import element_names, handle, of_handle, plain, resolved
from cosim.scenarios.scenario import Scenario
from cosim.slaves.slave import open_slave
from cosim.system.aliases import as_the_fmus_have_it
from cosim.system.fmu_cache import find_fmu


@given(reference=st.integers(0, 2**32 - 1), place=st.integers(0, 2**20))
def test_a_handle_is_a_value_reference_and_a_place(reference, place):
    assert of_handle(handle(reference, place)) == (reference, place)
    assert handle(reference, 0) == reference


@pytest.mark.parametrize(
    ("name", "shape", "names"),
    [
        ("r", (3,), ["r[1]", "r[2]", "r[3]"]),
        ("R", (2, 2), ["R[1,1]", "R[1,2]", "R[2,1]", "R[2,2]"]),
        ("der(r)", (2,), ["der(r[1])", "der(r[2])"]),
        ("body.r", (1,), ["body.r[1]"]),
    ],
)
def test_elements_are_named_as_fmi_names_them(name, shape, names):
    assert element_names(name, shape) == names


@pytest.mark.parametrize(
    ("element", "name"),
    [
        ("r[1]", "r_x"), ("r_d[3]", "r_d_z"), ("R[1,2]", "R_12"), ("der(v[2])", "der(v_y)"),
        ("der(R[3,1])", "der(R_31)"),
        ("M_held[1]", "M_x_held"), ("m", "m"), ("J_xx", "J_xx"), ("T[4]", "T[4]"), ("pipe[2].T", "pipe[2].T"),
    ],
)  # fmt: skip
def test_an_element_has_the_name_of_the_scalar(element, name):
    assert plain(element) == name
    assert resolved(name, {element: 0, "other": 1}) == element
    assert resolved(element, {name: 0, "other": 1}) == name


def test_a_variable_s_own_name_comes_first():
    assert resolved("r_x", {"r[1]": 0, "r_x": 1}) == "r_x"
    assert resolved("r_x", {"s[1]": 0}) == "r_x"


@pytest.mark.fmu
@pytest.mark.parametrize("name", ["Quadrotor", "RigidBodyController", "QuadrotorReference", "FrictionPendulum"])
def test_the_elements_of_fmi_3_are_the_scalars_of_fmi_2(tmp_path, name):
    """In the same order, with the same start, unit, bounds and derivative; time is there in FMI 3.0 always."""
    two, three = (
        [v for v in read_description(find_fmu(name, tmp_path, fmi)).modelVariables if v.name != "time"]
        for fmi in (2, 3)
    )

    def facts(v):
        numbers = [None if x is None or v.type == "Boolean" else float(x) for x in (v.start, v.min, v.max, v.nominal)]
        return (plain(v.name), v.unit, *numbers, v.causality, v.variability, v.derivative and plain(v.derivative.name))

    assert [facts(v) for v in three] == [facts(v) for v in two]
    assert len({v.valueReference for v in three}) == len(three)


@pytest.mark.fmu
def test_fmpy_s_description_is_left_as_it_was(tmp_path):
    path = find_fmu("Quadrotor", tmp_path, 3)
    before = [(v.name, v.shape) for v in fmpy.read_model_description(str(path)).modelVariables]
    read_description(path)
    assert [(v.name, v.shape) for v in fmpy.read_model_description(str(path)).modelVariables] == before


@pytest.fixture
def slaves(tmp_path):
    """The quadrotor's FMUs, all of one FMI version."""
    opened = []

    def of(fmi, **others):
        names = {"plant": "Quadrotor", "controller": "QuadrotorController", "reference": "QuadrotorReference"}
        for component, name in names.items():
            opened.append(open_slave(find_fmu(name, tmp_path, others.get(component, fmi)), component))
        return dict(zip(names, opened[-3:], strict=True))

    yield of
    for slave in opened:
        slave.close()


@pytest.mark.fmu
def test_a_scenario_is_unchanged_where_the_fmus_have_its_names(slaves):
    scenario = Scenario.load("quadrotor")
    assert as_the_fmus_have_it(scenario, slaves(2)) == scenario


@pytest.mark.fmu
def test_every_name_of_a_scenario_is_found_in_fmi_3(slaves):
    scenario = as_the_fmus_have_it(Scenario.load("quadrotor"), slaves(3, controller=2))
    assert scenario.connections["controller.R_12"] == "plant.R[1,2]"
    assert scenario.connections["plant.M[2]"] == "controller.M_y"
    assert list(scenario.tracking) == ["plant.r[1]", "plant.r[2]", "plant.r[3]"]
    assert "plant.der(v[1])" in scenario.sampling.derivatives
    assert {"plant.J[1]", "plant.J[2]", "plant.J[3]", "plant.m"} <= set(scenario.changes)
    assert [(p.name, p.writes, scenario.true_reference(p)) for p in scenario.estimation.parameters][1] == (
        "J_x", "controller.J_x", "plant.J[1]",
    )  # fmt: skip
    assert set(scenario.components["plant"].start) <= {"v[1]", "v[2]", "v[3]", "r[1]", "r[2]", "r[3]"}


@pytest.mark.fmu
def test_arrays_are_connected_element_by_element(slaves):
    scenario = Scenario.load("quadrotor", {"connections": '{"controller.R" = "plant.R", "controller.r" = "plant.r"}'})
    connections = as_the_fmus_have_it(scenario, slaves(3)).connections
    assert len(connections) == 12
    assert connections["controller.R[2,3]"] == "plant.R[2,3]"
    assert connections["controller.r[1]"] == "plant.r[1]"


@pytest.mark.fmu
def test_arrays_of_different_sizes_are_refused(slaves):
    scenario = Scenario.load("quadrotor", {"connections": '{"controller.R" = "plant.r"}'})
    with pytest.raises(
        WiringError, match=r"'controller.R' has 3 x 3 elements and 'plant.r' 3 elements: they cannot be connected"
    ):
        as_the_fmus_have_it(scenario, slaves(3))
