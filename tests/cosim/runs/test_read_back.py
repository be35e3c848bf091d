"""Changed parameters of an FMU are read back: one that does not take them ends the run in one line."""

import shutil

import numpy as np
import pytest

from benchmarks.native_fmus import FOREIGN, SOURCES, build_c
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing")]

MODELS = {
    "ignores the mass": "v[M] = 2.0;",
    "ignores the stiffness": "v[C] = 8.0;",
    "is of single precision": "v[M] = (float)v[M]; v[C] = (float)v[C];",
}


@pytest.fixture(scope="module")
def models(made_once):
    """A folder with variants of Axis, FMI 2.0 and 3.0, that do so in every step; the mass is at least 0.7 kg."""
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler: gcc is not installed")

    def make(folder):
        code = (FOREIGN / "Axis.c").read_text()
        for name in ("Axis", "Axis-3"):
            description = (FOREIGN / f"{name}.xml").read_text().replace('min="0.5"', 'min="0.7"')
            for model, line in MODELS.items():
                source = folder / "Axis.c"
                source.write_text(code.replace("    const int n = 20;", f"    const int n = 20;\n    {line}"))
                build_c(source, description, folder / f"{name} {model}.fmu")

    return made_once(make, SOURCES, FOREIGN, MODELS)


@pytest.fixture
def changed(axis, models):
    """changed(model, change): the run of tests/foreign/axis.toml with a variant of Axis, its mass and stiffness."""

    def ran(model, mass, stiffness="8.0"):
        path = axis(('"Axis.fmu"', f'"{(models / model).as_posix()}.fmu"'))
        changes = {'changes."plant.spring.c"': stiffness, 'changes."plant.mass.m"': mass}
        return run(Scenario.load(path, {"scenario.isolation": '"none"'} | changes), "none")

    return ran


@pytest.mark.parametrize("name", ["Axis", "Axis-3"], ids=["FMI 2", "FMI 3"])
def test_a_parameter_that_is_not_taken_ends_the_run_where_it_is_first_set(changed, name):
    result = changed(f"{name} ignores the mass", "[[0, 2.0], [0.3, 3.25]]")
    told = "plant.mass.m reads back as 2, but 3.25 was set: the FMU does not take it"
    assert (result.status, result.error) == ("faulted", told)
    assert result.time[-1] == pytest.approx(0.3)
    assert result["plant.mass.m"][-2:].tolist() == [2.0, 3.25]  # the scenario's, not what was read


def test_each_of_several_is_looked_at(changed):
    result = changed("Axis ignores the stiffness", "[[0, 2.0], [0.3, 3.0]]", "8 if t < 0.5 else 9")
    assert result.error == "plant.spring.c reads back as 8, but 9 was set: the FMU does not take it"
    assert result.time[-1] == pytest.approx(0.5)


def test_single_precision_is_taken_as_such_also_at_a_limit(changed):
    assert float(np.float32(0.7)) < 0.7
    result = changed("Axis is of single precision", "[[0, 2.1], [0.3, 0.7]]", "8 + 0.1*sin(t)")
    assert result.status == "done", result.error


def test_what_is_taken_is_recorded_once(changed, axis):
    result = run(Scenario.load(axis(), {"scenario.isolation": '"none"'}), "none")
    assert result.status == "done", result.error
    assert list(result.series).count("plant.mass.m") == 1
