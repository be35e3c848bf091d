"""`retune new`: from FMUs that nobody has joined to a re-tuned controller, by way of one file to look over."""

import re
import shutil
import tomllib

import pytest

from benchmarks.native_fmus import FOREIGN
from cosim.authoring.check import check
from cosim.authoring.draft import draft
from cosim.cli import main
from cosim.errors import WiringError
from cosim.runs.simulation import run
from cosim.scenarios.scenario import Scenario
from cosim.system.fmu_cache import find_fmu

pytestmark = pytest.mark.fmu


def uncommented(text: str, *keys: str) -> str:
    """The text with the comment signs before these lines taken away."""
    for key in keys:
        text, n = re.subn(rf'^# (?="{re.escape(key)}" = )', "", text, flags=re.M)
        assert n == 1, key
    return text


@pytest.fixture
def ours(tmp_path):
    """Our pendulum, as if it were somebody else's."""
    names = {"plant": "Pendulum", "controller": "PendulumController", "reference": "PendulumReference"}
    return {role: find_fmu(name, tmp_path) for role, name in names.items()}


@pytest.fixture
def theirs(foreign, tmp_path):
    """FMUs compiled from C whose names and units do not agree in every way, and a table of set points."""
    shutil.copy(FOREIGN / "steps.csv", tmp_path)
    return {
        "plant": foreign / "Axis.fmu",
        "controller": foreign / "AxisController.fmu",
        "reference": tmp_path / "steps.csv",
    }


def new(fmus, path, *more):
    """The command's exit code."""
    return main(
        ["new", *(part for role, fmu in fmus.items() for part in (f"--{role}", str(fmu))), "-o", str(path), *more]
    )


@pytest.mark.full
def test_our_pendulum_runs_once_model_and_change_are_filled_in(ours, tmp_path, capsys):
    path = tmp_path / "my.toml"
    assert new(ours, path) == 0
    to_fill = [line for line in capsys.readouterr().out.splitlines() if "to fill in" in line]
    assert len(to_fill) == 2  # and no other line
    assert "[changes]" in to_fill[0]
    assert 'model = "plant_model:derivative"' in to_fill[1]
    assert [f.where for f in check(path) if f.is_error] == ["estimation.model"]
    text = uncommented(path.read_text(), "plant.m", "plant.l")
    path.write_text(text.replace("plant_model:derivative", "fmu_models.pendulum:derivative"))
    assert [str(f) for f in check(path)] == []
    result = run(Scenario.load(path))
    assert result.status == "done"
    held = {name: result[f"controller.{name}"][-1] for name in "mlb"}
    assert held["m"] == pytest.approx(2.625, rel=0.02)  # as [changes] says; noise and b, estimated too, leave some room
    assert held["l"] == pytest.approx(1.125, abs=2.0 * result.final_estimate.std[1])  # 0.06 m
    named = Scenario.load("pendulum")
    drafted = Scenario.load(path)
    assert drafted.connections == named.connections
    assert drafted.tracking == named.tracking
    assert set(drafted.sampling.derivatives) == set(named.sampling.derivatives)


def test_foreign_fmus_run_once_model_and_change_are_filled_in(theirs, tmp_path, capsys):
    path = tmp_path / "axis.toml"
    assert new(theirs, path) == 0
    out = capsys.readouterr().out
    assert out.count("to fill in") == 2
    path.write_text(uncommented(path.read_text(), "plant.mass.m", "plant.spring.c"))
    shutil.copy(FOREIGN / "axis_model.py", tmp_path / "plant_model.py")
    findings = check(path)
    assert not any(f.is_error for f in findings), findings
    result = run(Scenario.load(path))
    assert result["controller.m"][-1] == pytest.approx(3.0, rel=5e-3)
    assert result["controller.c"][-1] == pytest.approx(12.0, rel=5e-3)


@pytest.mark.full
def test_a_plant_without_derivatives_is_drafted_with_a_filter_and_runs(theirs, bare_axis, tmp_path, capsys):
    path = tmp_path / "axis.toml"
    assert new(theirs | {"plant": bare_axis}, path) == 0
    assert capsys.readouterr().out.count("to fill in") == 2  # the model and what changes, as with derivatives
    text = uncommented(path.read_text(), "plant.mass.m", "plant.spring.c")
    path.write_text(text)
    shutil.copy(FOREIGN / "axis_model.py", tmp_path / "plant_model.py")
    tree = tomllib.loads(text)
    assert tree["sampling"]["derivatives"] == {"plant.der(mass.v)": {"of": "plant.mass.v"}}  # der(mass.s) is mass.v
    assert list(tree["sampling"]["states"]) == ["plant.mass.v", "plant.mass.s"]
    assert tree["components"]["plant"]["start"] == {"mass.v": 0.0, "mass.s": 0.0}
    assert not any(f.is_error for f in check(path)), check(path)
    result = run(Scenario.load(path))  # noise of 1e-3 in the states is 0.025 m/s2 in the derivative
    assert result["controller.m"][-1] == pytest.approx(3.0, rel=0.02)
    assert result["controller.c"][-1] == pytest.approx(12.0, rel=0.01)


def test_names_units_and_bounds_are_those_of_the_fmus_and_guesses_are_marked(theirs, tmp_path):
    drafted = draft(theirs, tmp_path)
    tree = tomllib.loads(drafted.text)
    assert tree["connections"] == {
        "controller.s_meas": "plant.mass.s", "controller.v_meas": "plant.mass.v",
        "controller.sRef": "reference.s_ref", "controller.vRef": "reference.v_ref", "plant.f": "controller.f_cmd",
    }  # fmt: skip
    assert tree["components"]["plant"]["start"] == {"mass.v": 0.0, "mass.s": 0.0}
    assert tree["components"]["reference"] == {"table": "steps.csv"}
    assert tree["scenario"] == {"name": "lab-axis", "stop_time": 5.0, "macro_step": 0.01}
    assert tree["tracking"] == {"plant.mass.s": "reference.s_ref"}
    assert list(tree["sampling"]["derivatives"]) == ["plant.der(mass.v)"]  # der(mass.s) is a state
    mass, stiffness = tree["estimation"]["parameters"]
    assert mass == {
        "name": "m", "lower": 0.5, "upper": 10.0, "unit": "kg", "scale": "log", "writes": "controller.m",
        "true": "plant.mass.m",
    }  # fmt: skip
    assert (stiffness["lower"], stiffness["upper"], stiffness["scale"]) == (0.0, 80.0, "linear")
    marked = " ".join(line for _, line in drafted.lines("GUESS"))
    for text in ("controller.s_meas", "controller.v_meas", "upper = 80.0", "der(mass.v)"):
        assert text in marked
    assert '"plant.f"' not in marked  # same words and unit
    assert "def derivative(x, u, m, c):" in drafted.text
    assert (
        drafted.text.index("x[0]: mass.v [m/s]")
        < drafted.text.index("x[1]: mass.s [m]")
        < drafted.text.index("u[0]: f")
    )
    assert {line.split()[0] for _, line in drafted.lines("GUESS")} >= {"true", "upper"}
    assert "# Tunable in the controller too, but not estimated: Kp, Kd" in drafted.text  # nor g, which is a constant


def test_a_plant_and_a_controller_that_are_swapped_are_asked_about(ours, tmp_path, capsys):
    swapped = {"plant": ours["controller"], "controller": ours["plant"], "reference": ours["reference"]}
    path = tmp_path / "swapped.toml"
    assert new(swapped, path) == 0
    asked = "are plant and controller swapped? The plant takes set points, and the controller none"
    assert f"GUESS: {asked}" in capsys.readouterr().out
    assert f"components: warning: {asked}" in [str(f) for f in check(path)]
    assert new(ours, tmp_path / "right.toml") == 0
    assert asked not in capsys.readouterr().out
    assert asked not in [f.what for f in check(tmp_path / "right.toml")]


def test_a_file_that_exists_is_never_overwritten(ours, tmp_path, capsys):
    path = tmp_path / "my.toml"
    path.write_text("mine")
    assert new(ours, path) == 2
    assert path.read_text() == "mine"
    assert capsys.readouterr().err == f"retune: {path} exists; give -o a new file.\n"
    assert new(ours, tmp_path / "no" / "my.toml") == 2
    assert not (tmp_path / "no").exists()


def test_what_is_not_given_is_to_be_filled_in(theirs, tmp_path, capsys):
    path = tmp_path / "axis.toml"
    assert new({"plant": theirs["plant"]}, path) == 0
    out = capsys.readouterr().out
    for text in ("controller = ", "reference = ", '"plant.f"', "writes = ", '"plant.FILL" = "reference.FILL"'):
        assert any(text in line for line in out.splitlines() if "to fill in" in line), text
    found = {f.where for f in check(path) if f.is_error}
    assert {"components.controller", "components.reference", 'tracking."plant.FILL"'} <= found


def test_a_name_of_several_lines_is_drafted_on_one(described, tmp_path):
    variables = """<ScalarVariable name="a b&#10;c" valueReference="0" causality="output" description="two&#10;lines"
    initial="exact"><Real start="0"/></ScalarVariable>
    <ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"/></ScalarVariable>"""
    text = draft({"plant": described(variables, name="Plain")}, tmp_path).text
    assert tomllib.loads(text)["sampling"]["derivatives"] == {"plant.der(a b\nc)": {"of": "plant.a b\nc"}}
    assert tomllib.loads(text)["scenario"]["name"] == "plain"


def test_a_plant_without_outputs_is_refused(described, tmp_path):
    silent = described(
        '<ScalarVariable name="u" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>'
    )
    with pytest.raises(WiringError, match="has no outputs"):
        draft({"plant": silent}, tmp_path)


def test_only_the_reference_can_be_a_table(theirs, tmp_path, capsys):
    assert new({**theirs, "controller": theirs["reference"]}, tmp_path / "axis.toml") == 2
    assert "steps.csv is a table: only the reference can be one" in capsys.readouterr().err
    assert not (tmp_path / "axis.toml").exists()


def test_paths_are_those_from_the_files_folder(theirs, tmp_path):
    folder = tmp_path / "scenarios"
    folder.mkdir()
    assert new(theirs, folder / "axis.toml") == 0
    components = tomllib.loads((folder / "axis.toml").read_text())["components"]
    assert components["reference"]["table"] == "../steps.csv"
    assert (folder / components["plant"]["fmu"]).resolve() == theirs["plant"].resolve()


@pytest.mark.full
def test_a_model_exchange_fmu_as_the_model_leaves_only_the_change_to_fill_in(tmp_path, capsys):
    names = {"plant": "Quadrotor", "controller": "QuadrotorController", "reference": "QuadrotorReference"}
    fmus = {role: find_fmu(name, tmp_path, 3) for role, name in names.items()}
    path = tmp_path / "quadrotor.toml"
    model = find_fmu("Quadrotor", tmp_path, 3, "ModelExchange")
    assert new(fmus, path, "--model", str(model)) == 0
    assert [line.split(":")[3].split()[0] for line in capsys.readouterr().out.splitlines() if "to fill in" in line] == [
        "[changes]"
    ]
    found = check(path)  # the model is called with x, u and J[1] of the FMU
    assert [(f.where, f.is_note) for f in found] == [("changes", False), ("estimation.model", True)]
    disturbances = [line for line in path.read_text().splitlines() if '"plant.F_d' in line or '"plant.M_d' in line]
    assert [line[:11] for line in disturbances] == ['# "plant.F_'] * 3 + ['# "plant.M_'] * 3
    assert all("a disturbance, which may be left unconnected" in line for line in disturbances)
    parameters = Scenario.load(path).estimation.parameters
    assert [p.name for p in parameters] == ["m", "J[1]", "J[2]", "J[3]"]
