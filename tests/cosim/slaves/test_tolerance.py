"""The tolerance of an FMU's own solver: its default experiment's, or the scenario's."""

import pytest

from benchmarks.native_fmus import FOREIGN, build_c
from cosim import Scenario, open_slave, run
from cosim.errors import ScenarioError

NONE = -1.0  # what the FMU says where it is given none


@pytest.fixture
def fmu(foreign, tmp_path):
    """fmu(description, tolerance): an FMU whose position is at first the tolerance that it is given."""

    def build(name, declared):
        text = (FOREIGN / f"{name}.xml").read_text()
        attribute = "" if declared is None else f' tolerance="{declared}"'
        assert text.count("<DefaultExperiment ") == 1
        text = text.replace("<DefaultExperiment", f"<DefaultExperiment{attribute}")
        return build_c(FOREIGN / "Axis.c", text, tmp_path / "Tolerant.fmu", "-DTOLERANCE=S")

    return build


def given(path, **options):
    with open_slave(path, "axis", **options) as slave:
        slave.bind(outputs=["mass.s"])
        slave.initialize({})
        return slave.get()[0]


@pytest.mark.full_but("Axis-none", "Axis-3-none")
@pytest.mark.parametrize("isolation", ["process", "none"])
@pytest.mark.parametrize("name", ["Axis", "Axis-3"])
def test_the_default_experiment_s_is_given_and_an_own_one_instead(fmu, name, isolation):
    path = fmu(name, "1e-9")
    assert given(path, isolation=isolation) == 1e-9
    assert given(path, isolation=isolation, tolerance=1e-3) == 1e-3


@pytest.mark.full
@pytest.mark.parametrize("name", ["Axis", "Axis-3"])
@pytest.mark.parametrize("declared", [None, "0", "-1e-6", "INF"])
def test_without_a_usable_one_none_is_given(fmu, name, declared):
    assert given(fmu(name, declared)) == NONE


@pytest.mark.full
@pytest.mark.parametrize(("of_the_scenario", "expected"), [("", 1e-9), (", tolerance = 1e-4", 1e-4)])
def test_a_scenario_sets_a_component_s(fmu, axis, of_the_scenario, expected):
    fmu("Axis", "1e-9").rename(axis().with_name("With.fmu"))
    path = axis(('plant = { fmu = "Axis.fmu" }', f'plant = {{ fmu = "With.fmu"{of_the_scenario} }}'))
    scenario = Scenario.load(path, {"scenario.stop_time": "0.05"})
    assert run(scenario, estimator="none").series["plant.mass.s"][0] == expected


@pytest.mark.parametrize("tolerance", ["0.0", "-1e-6", "nan", "inf"])
def test_a_tolerance_is_a_positive_number(axis, tolerance):
    path = axis(('plant = { fmu = "Axis.fmu" }', f'plant = {{ fmu = "Axis.fmu", tolerance = {tolerance} }}'))
    with pytest.raises(ScenarioError, match=r"components\.plant\.tolerance"):
        Scenario.load(path)
