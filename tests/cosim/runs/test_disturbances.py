"""Inputs that a scenario changes and nobody measures: they act on the plant, and the estimator does not have them."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.native_fmus import FOREIGN, SOURCES, build_c
from cosim.authoring.check import check
from cosim.errors import WiringError
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario, find_scenario, read_tables

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

PUSHED_C = ("v[F] - v[C]", "v[F] + v[G] - v[C]"), ("9.81}", "0.0}")
PUSHED = {
    "Axis": (
        '<ScalarVariable name="g" valueReference="8" causality="parameter" variability="tunable" '
        'description="Gravity">\n      <Real start="9.81" unit="m/s2"/>',
        '<ScalarVariable name="push" valueReference="8" causality="input"><Real min="-5" max="5" start="0" unit="N"/>',
    ),
    "Axis-3": (
        '<Float64 name="g" valueReference="8" causality="parameter" variability="tunable" start="9.81" unit="m/s2"\n'
        '      description="Gravity"/>',
        '<Float64 name="push" valueReference="8" causality="input" min="-5" max="5" start="0" unit="N"/>',
    ),
}
"""In place of gravity, which does nothing there, a second force on the mass."""
SHOVE = {'changes."plant.push"': "[[0, 0], [0.2, 0.8], [0.25, 0]]"}
H = 0.01


def replaced(text, *pairs):
    for old, new in pairs:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


@pytest.fixture(scope="module")
def pushed_axes(made_once):
    """A folder with Axis.fmu and Axis-3.fmu that have a second force on the mass, `push` [N]."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")

    def make(folder):
        source = folder / "Axis.c"
        source.write_text(replaced((FOREIGN / "Axis.c").read_text(), *PUSHED_C))
        for name, pair in PUSHED.items():
            build_c(source, replaced((FOREIGN / f"{name}.xml").read_text(), pair), folder / f"{name}.fmu")

    return made_once(make, SOURCES, FOREIGN, PUSHED_C, PUSHED)


@pytest.fixture
def pushed(axis, pushed_axes):
    """pushed(overrides, name, *replacements): tests/foreign/axis.toml with such a plant."""

    def load(overrides, name="Axis", *replacements):
        path = axis(('"Axis.fmu"', f'"{(pushed_axes / name).as_posix()}.fmu"'), *replacements)
        return Scenario.load(path, {"scenario.isolation": '"none"'} | overrides)

    return load


def independent_position(result, push):
    """s at every communication point, both forces held over each step, by DOP853."""
    x, found = np.zeros(2), [0.0]
    for k, t in enumerate(result.time[:-1]):
        m, f = result["plant.mass.m"][k], result["controller.f_cmd"][k] + push(t)

        def slope(t, y, m=m, f=f):
            return [y[1], (f - 8.0 * y[0] - 1.0 * y[1]) / m]

        x = solve_ivp(slope, (0.0, H), x, method="DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
        found.append(x[0])
    return np.array(found)


CASES = {
    "rows": ("[[0, 0], [0.2, 0.8], [0.25, 0]]", lambda t: 0.8 if 0.1999 < t < 0.2499 else 0.0),
    "a constant": ("-1.5", lambda t: -1.5),
    "a formula": ("3*sin(9*t)", lambda t: 3.0 * math.sin(9.0 * t)),
}


@pytest.mark.parametrize("name", PUSHED)
@pytest.mark.parametrize(("change", "push"), CASES.values(), ids=CASES)
def test_it_acts_on_the_plant_from_each_change_on_and_is_recorded(pushed, name, change, push):
    result = run(pushed({'changes."plant.push"': change}, name), "none")
    assert result.status == "done", result.error
    np.testing.assert_allclose(result["plant.push"], [push(t) for t in result.time], atol=1e-12)
    # the FMU's own rule, steps of half a millisecond, errs so much; a step late makes 2e-4
    still = run(pushed({}, name), "none")
    added = result["plant.mass.s"] - still["plant.mass.s"]
    expected = independent_position(result, push) - independent_position(still, lambda t: 0.0)
    np.testing.assert_allclose(added, expected, atol=4e-5)
    assert np.max(np.abs(expected)) > 1e-3


@pytest.mark.full
def test_an_element_of_an_array_changes_and_the_others_stay_connected():
    """FMI 3.0 sets an array as a whole; the moment M_z of FMI 2.0 is its element M[3] there."""

    def ran(fmi):
        tables = read_tables(find_scenario("rigid-body"))
        tables["scenario"] |= {"stop_time": 0.1, "isolation": "none"}
        for component in tables["components"].values():
            component["fmi"] = fmi
        del tables["connections"]["plant.M_z"]
        tables["changes"]["plant.M_z"] = "0.5*sin(20*t)"
        return run(Scenario.from_tables(tables, {}, Path(), Path("rigid-body")), "none")

    plain, arrays = ran(2), ran(3)
    assert abs(plain["plant.Omega_z"][-1]) > 1e-3
    for i, axis in enumerate("xyz", 1):
        np.testing.assert_array_equal(arrays[f"plant.Omega[{i}]"], plain[f"plant.Omega_{axis}"])
    assert [n for n in arrays.series if n.startswith("held.plant.M[")] == ["held.plant.M[1]", "held.plant.M[2]"]


def test_the_estimator_has_no_such_input(pushed):
    """Its model is called with the force of the controller alone, which takes the second force for another mass."""
    result = run(pushed(SHOVE), "target")
    assert result.status == "done", result.error
    assert [name for name in result.series if name.startswith("held.")] == ["held.plant.f"]
    assert "held.plant.push" in run(pushed({}), "none").series


def test_an_input_that_is_connected_as_well_is_refused_in_one_line(pushed, axis):
    told = "'plant.f' is connected to 'controller.f_cmd': an input is either changed or connected"
    overrides = {'changes."plant.f"': "1.0"}
    with pytest.raises(WiringError) as refusal:
        run(pushed(overrides), "none")
    assert str(refusal.value) == f'changes."plant.f": {told}.'
    (found,) = [f for f in check(axis(), overrides) if f.is_error]
    assert str(found) == f'changes."plant.f": error: {told}'


def test_a_changed_input_is_not_told_as_an_unconnected_one(pushed, pushed_axes, axis):
    path = axis(('"Axis.fmu"', f'"{(pushed_axes / "Axis").as_posix()}.fmu"'))
    assert [f for f in check(path, SHOVE) if not f.is_note] == []
    assert [f.where for f in check(path) if not f.is_note] == ['connections."plant.push"']


@pytest.mark.parametrize(
    ("change", "status", "told"),
    [
        ("[[0, 0], [0.2, 6.0]]", "faulted", "plant: set at t = 0.200 s: input 'push' must be within [-5, 5] N, got 6"),
        ("0.01/(t - 0.2)", "faulted", 'changes."plant.push" has no value at t = 0.2'),
    ],
)
def test_a_value_that_it_cannot_have_ends_the_run_in_one_line(pushed, change, status, told):
    result = run(pushed({'changes."plant.push"': change}), "none")
    assert (result.status, result.error[: len(told)]) == (status, told)
    assert "\n" not in result.error


def test_what_is_no_input_and_no_tunable_parameter_is_refused(pushed):
    with pytest.raises(WiringError, match=r"'mass\.s' of Axis\.fmu is an output, not a tunable parameter"):
        run(pushed({'changes."plant.mass.s"': "1.0"}), "none")


@pytest.mark.parametrize(("name", "force"), [("quadrotor", "F_d_x"), ("rigid-body", "F_d_z"), ("pendulum", "F_d")])
def test_a_model_that_has_more_inputs_than_are_sampled_ends_no_run(name, force):
    """One of a vector of forces is changed, and left out of the samples: the model takes all six of them or none."""
    settings = {"scenario.isolation": '"none"', "scenario.checkpoint": "0", "scenario.stop_time": "0.5"}
    scenario = Scenario.load(name, settings | {f'changes."plant.{force}"': "[[0.0, 0.0], [0.4, 1.0]]"})
    assert run(scenario, "target").status == "done"


@pytest.mark.full
@pytest.mark.parametrize("seed", [4, 12])
def test_the_onset_of_a_gust_is_not_taken_for_a_limit_of_the_input_that_acts_against_it(seed):
    gust = '[[0.0, 0.0], [0.5, "0.15*(1 - cos(2*pi*(t - 0.5)/0.05))"], [0.55, 0.0]]'
    settings = {"scenario.isolation": '"none"', "scenario.checkpoint": "0", "scenario.stop_time": "0.7"}
    changes = {'changes."plant.m"': "0.1", 'changes."plant.z_0"': "0.004", 'changes."plant.F_d"': gust}
    scenario = Scenario.load("magnetic-levitation", settings | changes)
    retuned, nominal = (run(scenario, estimator, seed) for estimator in ("target", "none"))
    assert retuned.diagnosis["lag"] == 0
    assert retuned.mse[0] < nominal.mse[0]
