"""`retune new` for FMUs as Dymola and 20-sim export them, and for controllers that have gains: what it writes runs."""

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from benchmarks.native_fmus import FOREIGN, SOURCES, build_c
from cosim.authoring.check import check
from cosim.authoring.draft import draft
from cosim.authoring.guess_tracking import guess_tracking
from cosim.cli import main
from cosim.fmi.archive import needs_its_tool
from cosim.fmi.component import read_component
from cosim.runs.simulation import run
from cosim.scenarios.json_schema import URL
from cosim.scenarios.scenario import Scenario

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")]
DRIVE = Path(__file__).parents[3] / "examples" / "pi-speed-drive"


def hidden(xml: str) -> str:
    """Axis.xml with its states local, and calculated outputs that take no start value."""
    for name in ("mass.s", "mass.v", "der(mass.s)", "der(mass.v)"):
        xml, n = re.subn(rf'(name="{re.escape(name)}" valueReference="\d" causality=)"output"', r'\1"local"', xml)
        assert n == 1
    sensors = "".join(
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="output" initial="calculated">'
        f'<Real unit="{unit}"/></ScalarVariable>'
        for name, place, unit in (("s", 1, "m"), ("v", 2, "m/s"))
    )
    structure = "<Outputs>{}</Outputs><Derivatives>{}</Derivatives><InitialUnknowns>{}</InitialUnknowns>".format(
        *("".join(f'<Unknown index="{i}"/>' for i in known) for known in ((10, 11), (4, 5), (4, 5, 10, 11)))
    )
    xml = xml.replace("</ModelVariables>", f"{sensors}</ModelVariables>")
    return re.sub(
        "<ModelStructure>.*</ModelStructure>", f"<ModelStructure>{structure}</ModelStructure>", xml, flags=re.S
    )


@pytest.fixture(scope="session")
def built(made_once):
    """A folder with HiddenAxis.fmu, UnitlessController.fmu, Drive.fmu and SpeedController.fmu."""

    def make(folder):
        build_c(FOREIGN / "Axis.c", hidden((FOREIGN / "Axis.xml").read_text()), folder / "HiddenAxis.fmu")
        bare = re.sub(r' unit="[^"]*"', "", (FOREIGN / "AxisController.xml").read_text())
        build_c(FOREIGN / "AxisController.c", bare, folder / "UnitlessController.fmu")
        for name in ("Drive", "SpeedController"):
            build_c(DRIVE / f"{name}.c", (DRIVE / f"{name}.xml").read_text(), folder / f"{name}.fmu")

    return made_once(make, SOURCES, FOREIGN, DRIVE, Path(__file__))


def new(path, plant, controller, reference):
    return main(
        ["new", "--plant", str(plant), "--controller", str(controller), "--reference", str(reference), "-o", str(path)]
    )


@pytest.fixture
def axis_draft(built, foreign, tmp_path, capsys):
    """The scenario that `new` writes for the hidden axis."""
    path = tmp_path / "axis.toml"
    assert new(path, built / "HiddenAxis.fmu", foreign / "AxisController.fmu", FOREIGN / "steps.csv") == 0
    assert capsys.readouterr().out.count("to fill in") == 1  # what changes
    return path


def test_a_plant_that_hides_its_states_gets_roll_outs_that_check_and_run_take(axis_draft):
    tree = tomllib.loads(axis_draft.read_text())
    assert axis_draft.read_text().startswith(f"#:schema {URL}\n")
    assert tree["estimation"]["objective"] == "rollout"
    assert set(tree["sampling"]["outputs"]) == {"plant.s", "plant.v"}
    assert "start" not in tree["components"]["plant"]
    assert main(["check", str(axis_draft)]) == 0
    assert run(Scenario.load(axis_draft, {"scenario.stop_time": "0.05"})).status == "done"


@pytest.mark.full
def test_its_mass_is_found_by_them(axis_draft):
    axis_draft.write_text(axis_draft.read_text().replace('# "plant.mass.m"', '"plant.mass.m"'))
    result = run(Scenario.load(axis_draft))
    assert result["controller.m"][-1] == pytest.approx(3.0, rel=5e-3)
    assert result["controller.c"][-1] == pytest.approx(8.0, rel=5e-3)


def test_a_model_for_hidden_starts_is_checked_and_run_alike(axis_draft, tmp_path):
    """The filter takes outputs for states; `check` asked for start values that the FMU refuses."""
    text = axis_draft.read_text()
    sampling = """[sampling]
filter = { kind = "savitzky-golay" }
derivatives = { "plant.der(v)" = { of = "plant.v", noise = 0.02 } }
states = { "plant.s" = { noise = 1e-3 }, "plant.v" = { noise = 1e-3 } }

"""
    text = re.sub(r"\[sampling.outputs\].*?\n\n", sampling, text, flags=re.DOTALL)
    text = re.sub(r'objective = "rollout".*', 'model = "hidden_model:derivative"', text)
    axis_draft.write_text(text.replace("evaluations_per_step = 3", ""))
    (tmp_path / "hidden_model.py").write_text(
        "def derivative(x, u, m, c):\n    s, v = x\n    return v, (u[0] - c * s - v) / m\n"
    )
    found = check(axis_draft)
    assert [str(f) for f in found if f.is_error] == []
    assert any("zero for s, v, which the FMU starts itself" in f.what for f in found)
    assert run(Scenario.load(axis_draft, {"scenario.stop_time": "0.05"})).status == "done"


def test_units_are_the_plant_s_where_the_controller_declares_none(built, foreign, tmp_path):
    path = tmp_path / "axis.toml"
    assert new(path, foreign / "Axis.fmu", built / "UnitlessController.fmu", FOREIGN / "steps.csv") == 0
    mass, stiffness = tomllib.loads(path.read_text())["estimation"]["parameters"]
    assert (mass["unit"], stiffness["unit"]) == ("kg", "N/m")
    shutil.copy(FOREIGN / "axis_model.py", tmp_path / "plant_model.py")
    assert [str(f) for f in check(path) if f.is_error] == []
    path.write_text(path.read_text().replace('unit = "kg"', 'unit = "1"'))
    assert any("has the unit kg, but 'm' 1" in f.what and not f.is_error for f in check(path))
    assert run(Scenario.load(path, {"scenario.stop_time": "0.05"})).status == "done"


@pytest.mark.full
def test_a_controller_without_the_plant_s_parameters_gets_formulas(built, tmp_path, capsys):
    path = tmp_path / "drive.toml"
    assert new(path, built / "Drive.fmu", built / "SpeedController.fmu", DRIVE / "steps.csv") == 0
    assert capsys.readouterr().out.count("to fill in") == 2  # the model, and what changes
    (parameter,) = tomllib.loads(path.read_text())["estimation"]["parameters"]
    assert parameter["writes"] == {"controller.PI.k": "0.59 * J / 0.02"}
    assert (parameter["name"], parameter["unit"], parameter["start"]) == ("J", "kg.m2", 0.02)
    assert parameter["true"] == "plant.inertia.J"
    (tmp_path / "plant_model.py").write_text("def derivative(x, u, J):\n    return ((u[0] - 0.05 * x[0]) / J,)\n")
    text = path.read_text()
    assert '# "plant.inertia.J" = [[0.0, 0.02]' in text
    path.write_text(text.replace('# "plant.inertia.J" = ', '"plant.inertia.J" = '))
    assert [str(f) for f in check(path) if f.is_error] == []
    result = run(Scenario.load(path, {"scenario.stop_time": "5.0"}))  # from 0.02 to 0.03 kg m2
    assert result["controller.PI.k"][-1] == pytest.approx(0.59 * 1.5, rel=0.01)


def variable(name, unit, place):
    return (
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="output" initial="exact">'
        f'<Real start="0" unit="{unit}"/></ScalarVariable>'
    )


@pytest.mark.parametrize(
    ("outputs", "reference", "tracked"),
    [
        ([("force1", "N"), ("temperature", "K")], ("force", "N"), "plant.force1"),  # a similar name
        ([("y1", "N"), ("y2", "K")], ("T_set", "K"), "plant.y2"),  # the only one in the unit
        ([("speed", "m/s"), ("way", "m")], ("speed", "m"), "plant.way"),  # a name in another unit is none
        ([("y1", "K"), ("y2", "K")], ("T_set", "K"), None),
    ],
    ids=["a similar name", "only the unit", "another unit", "ambiguous"],
)
def test_what_is_tracked_is_matched_by_name_and_unit(described, outputs, reference, tracked):
    plant = described("".join(variable(*o, i) for i, o in enumerate(outputs)), name="P")
    wanted = described(variable(*reference, 0), name="R")
    components = {"plant": read_component(plant), "reference": read_component(wanted)}
    assert [g.target for g in guess_tracking(components)] == ([tracked] if tracked else [])
    text = draft({"plant": plant, "reference": wanted}, plant.parent).text
    assert tomllib.loads(text)["tracking"] == (
        {tracked: f"reference.{reference[0]}"} if tracked else {"plant.FILL": f"reference.{reference[0]}"}
    )


def pin(name, causality, place, unit="", start=' start="0"'):
    attribute = f' unit="{unit}"' if unit else ""
    return (
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="{causality}">'
        f"<Real{start if causality == 'input' else ''}{attribute}/></ScalarVariable>"
    )


def test_the_words_of_process_control_are_joined_where_one_output_is_left(described):
    """SP, PV and OUT without units: no name is like another, and there is no choice."""
    plant = described(pin("pump", "input", 0, "W") + pin("level", "output", 1, "m"), name="P")
    controller = described(pin("SP", "input", 0) + pin("PV", "input", 1) + pin("OUT", "output", 2), name="C")
    reference = described(pin("wanted", "output", 0, "m"), name="R")
    text = draft({"plant": plant, "controller": controller, "reference": reference}, plant.parent).text
    assert tomllib.loads(text)["connections"] == {
        "controller.SP": "reference.wanted", "controller.PV": "plant.level", "plant.pump": "controller.OUT",
    }  # fmt: skip
    assert text.count("GUESS: the only output left, no unit to compare") == 2
    two = described(pin("pump", "input", 0, "W") + pin("y1", "output", 1, "m") + pin("y2", "output", 2, "m"), name="Q")
    text = draft({"plant": two, "controller": controller, "reference": reference}, plant.parent).text
    assert "controller.PV" not in tomllib.loads(text)["connections"]  # either of two


@pytest.mark.parametrize(
    ("offered", "window"),
    [("", 100), ('canGetAndSetFMUstate="true"', 100), ('canGetAndSetFMUstate="true" canSerializeFMUstate="true"', 20)],
    ids=["none", "not as bytes", "saved"],
)
def test_roll_outs_from_the_start_are_longer_than_from_a_saved_state(described, offered, window):
    plant = described(pin("u", "input", 0) + pin("y", "output", 1), name="P", interface=offered)
    assert tomllib.loads(draft({"plant": plant}, plant.parent).text)["estimation"]["window"] == window


def test_a_measurement_is_not_fed_with_the_set_point_and_what_the_controller_compares_is_tracked(described):
    plant = described(pin("T_thermocouple", "output", 0) + pin("P", "input", 1), name="P")
    controller = described(pin("T_set", "input", 0) + pin("T_meas", "input", 1) + pin("power", "output", 2), name="C")
    wanted = described(pin("T_set", "output", 0), name="R")
    text = draft({"plant": plant, "controller": controller, "reference": wanted}, plant.parent).text
    written = tomllib.loads(text)
    assert written["connections"] == {
        "controller.T_set": "reference.T_set",
        "controller.T_meas": "plant.T_thermocouple",
        "plant.P": "controller.power",
    }
    assert written["tracking"] == {"plant.T_thermocouple": "reference.T_set"}


def test_a_disturbance_beside_a_plants_input_stays_at_its_start_and_the_weather_comes_from_the_table(described):
    """`dU` took `controller.U` as well as `U`, so that the plant got its input twice, and `To` nothing."""
    plant = described("".join(pin(name, "input", i) for i, name in enumerate(("U", "To", "dU", "w"))) +
                      pin("T", "output", 9), name="P")  # fmt: skip
    controller = described(pin("T", "input", 0) + pin("To", "input", 1) + pin("U", "output", 2), name="C")
    wanted = described(pin("To", "output", 0), name="R")
    text = draft({"plant": plant, "controller": controller, "reference": wanted}, plant.parent).text
    assert tomllib.loads(text)["connections"] == {
        "controller.T": "plant.T", "controller.To": "reference.To", "plant.U": "controller.U",
        "plant.To": "reference.To",
    }  # fmt: skip
    (line,) = [line for line in text.splitlines() if line.startswith('# "plant.dU" = ""')]
    assert "GUESS: a disturbance: the output with a name like it, controller.U, goes to plant.U; it stays at" in line
    (line,) = [line for line in text.splitlines() if line.startswith('# "plant.w" = ""')]
    assert line.endswith("; controller's outputs: U; as it is it stays at its start, unless [changes] names it")


def test_outputs_with_the_name_of_a_derivative_are_sampled_where_there_is_a_model(described):
    plant = described("".join(pin(name, "output", i) for i, name in enumerate(("i", "w", "phi", "di", "dw"))), name="P")
    written = tomllib.loads(draft({"plant": plant}, plant.parent, "plant_model:derivative").text)["sampling"]
    assert {name: source["of"] for name, source in written["derivatives"].items()} == {
        "plant.di": "plant.i",
        "plant.dw": "plant.w",
    }
    assert list(written["states"]) == ["plant.i", "plant.w", "plant.phi"]
    wanted = described(pin("dw_ref", "output", 0), name="R")
    tracking = tomllib.loads(draft({"plant": plant, "reference": wanted}, plant.parent).text)["tracking"]
    assert tracking == {"plant.FILL": "reference.dw_ref"}
    assert (
        "# By their names these outputs are derivatives: di of i, dw of w."
        in draft({"plant": plant}, plant.parent).text
    )


def test_a_model_that_is_given_has_its_signature_in_the_draft_and_a_disturbance_its_end(described):
    plant = described(pin("dU", "input", 0) + pin("U", "input", 1) + pin("i", "output", 2), name="P")
    controller = described(pin("i", "input", 0) + pin("U", "output", 1), name="C")
    text = draft({"plant": plant, "controller": controller}, plant.parent, "mine:Coil.slope").text
    signature = """# The plant's equations, the function:
#   def slope(x, u):
#       # x[0]: i [1]
#       # u[0]: dU [1], until [changes] names it
#       # u[1]: U [1]
#       return (der_i,)
model = "mine:Coil.slope"
"""
    assert signature in text
    assert "#   def derivative(x, u):" in draft({"plant": described(variable("i", "N", 0))}, plant.parent).text


@pytest.mark.parametrize(
    ("declared", "noise", "reason"),
    [
        ('start="8000"', 8.0, "a thousandth of the start value"),
        ('start="-1e-4"', 1e-7, "a thousandth of the start value"),
        ('start="8000" nominal="50"', 0.05, "a thousandth of the nominal value"),
        ('start="0"', 1e-3, "as nothing tells the size"),
        ('start="1e-300"', 1e-3, "as nothing tells the size"),
    ],
    ids=["a large start", "a small one", "nominal", "zero", "next to zero"],
)
@pytest.mark.parametrize("rate", ["", "dM"], ids=["filtered", "by name"])
def test_the_noise_goes_with_the_size_of_what_is_measured(described, declared, noise, reason, rate):
    outputs = variable("M", "kg", 0) + (variable("dM", "W", 1) if rate else "")
    name = rate or "M"
    outputs = re.sub(rf'(name="{name}".*?<Real )start="0"', rf"\1{declared}", outputs)
    text = draft({"plant": described(outputs, name="P")}, Path(), "m:derivative").text
    sampling = tomllib.loads(text)["sampling"]
    (line,) = (line for line in text.splitlines() if line.startswith(f'"plant.{name}" = {{ noise'))
    assert sampling["derivatives" if rate else "states"][f"plant.{name}"]["noise"] == pytest.approx(noise)
    assert f"GUESS of the noise, {reason}" in line


def test_an_output_that_tells_an_input_again_is_no_state_and_not_tracked(described):
    """`tau1_held`, the echo of `tau1`, has a name like `a1`, and seemed to be a state as all outputs do."""
    outputs = ("q1", "w1", "der_w1", "tau1_held", "bar_held")
    pins = "".join(variable(name, "N", i) for i, name in enumerate(outputs)) + pin("tau1", "input", 9)
    plant, wanted = described(pins, name="P"), described(pin("a1", "output", 0, "N"), name="R")
    written = tomllib.loads(draft({"plant": plant, "reference": wanted}, plant.parent, "m:derivative").text)
    assert list(written["sampling"]["states"]) == ["plant.q1", "plant.w1", "plant.bar_held"]  # no input is called bar
    assert set(written["components"]["plant"]["start"]) == {"q1", "w1", "bar_held"}
    assert written["tracking"] == {"plant.FILL": "reference.a1"}


def test_an_output_that_tells_an_input_again_is_not_compared_in_roll_outs(described):
    plant = described(pin("V", "input", 0) + pin("w", "output", 1) + pin("V_held", "output", 2), name="P")
    assert set(tomllib.loads(draft({"plant": plant}, plant.parent).text)["sampling"]["outputs"]) == {"plant.w"}


@pytest.mark.parametrize(("stop", "step"), [(1200.0, 1.0), (9000.0, 5.0), (10.0, 0.01), (0.3, 0.0002)])
def test_the_macro_step_goes_with_the_length_of_the_run(described, tmp_path, stop, step):
    plant = described(pin("y", "output", 0), name="P")
    table = tmp_path / "sp.csv"
    table.write_text(f"time,y_ref\n0,1\n{stop},1\n")
    written = tomllib.loads(draft({"plant": plant, "reference": table}, tmp_path).text)["scenario"]
    assert (written["stop_time"], written["macro_step"]) == (stop, step)


def test_what_is_left_to_fill_in_is_told_once(described, tmp_path):
    plant = described(pin("y1", "output", 0) + pin("y2", "output", 1), name="P")
    wanted = described(pin("SP", "output", 0), name="R")
    path = tmp_path / "my.toml"
    path.write_text(draft({"plant": plant, "controller": wanted, "reference": wanted}, tmp_path).text)
    found = [str(f) for f in check(path) if "FILL" in str(f)]
    assert 'tracking."plant.FILL": error: FILL is still there: it is to be filled in' in found
    assert len(found) == len({line.split(": ")[0] for line in found})


@pytest.mark.parametrize(("tool", "yes"), [("PythonFMU 0.7.0", False), ("Dymola", True), (None, True)])
def test_an_fmu_in_python_needs_no_other_tool(described, tool, yes):
    plant = described(pin("y", "output", 0), name="P", interface='needsExecutionTool="true"')
    description = read_component(plant).description
    description.generationTool = tool
    assert needs_its_tool(description) is yes


def test_a_set_point_in_another_unit_is_connected_as_a_run_converts_it(described):
    plant = described(pin("s", "output", 0, "m") + pin("u", "input", 1, "kg"), name="P")
    controller = described(
        pin("levelSetpoint", "input", 0, "m") + pin("s", "input", 1, "m") + pin("out", "output", 2, "kg"), name="C"
    )
    for unit, source in (("mm", "reference.levelSetpoint"), ("kg", None)):
        wanted = described(pin("levelSetpoint", "output", 0, unit), name="R")
        text = draft({"plant": plant, "controller": controller, "reference": wanted}, plant.parent).text
        assert tomllib.loads(text)["connections"].get("controller.levelSetpoint") == source
    assert "# FILL [m]: no output has a name like it; reference's outputs: levelSetpoint;" in text


@pytest.mark.parametrize(
    ("rows", "divergence"),
    [
        ("0,50\n10,100\n", 500.0),
        ("0,-0.2\n5,0.1\n", 3.0),
        ("0,7\n10,7\n", 70.0),
        ("0,0\n", None),
        ("0,1e300\n10,1.7e308\n", None),
        ("0,-1.7e308\n10,1.7e308\n", None),
        ("0,0\n10,1.79767e307\n", None),
    ],
)
def test_the_limit_of_the_tracking_error_goes_with_the_size_of_the_set_points(described, tmp_path, rows, divergence):
    plant = described(pin("y", "output", 0), name="P")
    table = tmp_path / "sp.csv"
    table.write_text(f"time,y_ref\n{rows}")
    written = tomllib.loads(draft({"plant": plant, "reference": table}, tmp_path).text)
    assert written.get("limits") == (None if divergence is None else {"divergence": divergence})


def tunable(name, place, start):
    return (
        f'<ScalarVariable name="{name}" valueReference="{place}" causality="parameter" variability="tunable">'
        f'<Real start="{start}"/></ScalarVariable>'
    )


def test_parameters_belong_together_by_a_word_and_the_value_that_they_start_with(described):
    own = [("L", 100e-6), ("C", 47e-6), ("R1", 2.0), ("gain", 0.5)]
    its = [("L_choke", 100e-6), ("C_filter", 48e-6), ("load_R", 3.0), ("half", 0.5), ("ESR", 0.01)]
    controller = described("".join(tunable(n, i, v) for i, (n, v) in enumerate(own)), name="C")
    parameters = "".join(tunable(n, i + 1, v) for i, (n, v) in enumerate(its))
    plant = described(pin("v", "output", 0) + parameters, name="P")
    text = draft({"plant": plant, "controller": controller}, plant.parent).text
    written = tomllib.loads(text)["estimation"]["parameters"]
    assert [(p["writes"], p["true"]) for p in written] == [("controller.L", "plant.L_choke")]
    assert "GUESS: a word of the name, and the start value" in text
    offered = re.findall(r'^# "plant.(\w+)" = \[\[', text, flags=re.MULTILINE)
    assert offered == ["L_choke", "C_filter", "load_R", "half", "ESR"]  # what is estimated comes first


def test_an_actuator_s_limit_is_no_parameter_that_changes(described):
    """The controller has gains, and the plant's limit: formulas in the plant's inertia are offered."""
    controller = described(
        "".join(tunable(n, i, v) for i, (n, v) in enumerate([("Kp", 2.0), ("i_lim", 20.0)])), name="C"
    )
    parameters = "".join(tunable(n, i + 1, v) for i, (n, v) in enumerate([("J", 0.02), ("i_max", 20.0)]))
    plant = described(pin("v", "output", 0) + parameters, name="P")
    (parameter,) = tomllib.loads(draft({"plant": plant, "controller": controller}, plant.parent).text)["estimation"][
        "parameters"
    ]
    assert parameter["true"] == "plant.J"
    assert parameter["writes"]["controller.Kp"] == "2.0 * J / 0.02"


def test_what_is_not_filled_in_ends_a_run_in_a_line_that_says_so(described, tmp_path, capsys):
    path = tmp_path / "my.toml"
    path.write_text(draft({"plant": described(pin("y", "output", 0), name="P")}, tmp_path).text)
    assert main(["run", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "is still to be filled in: name a file, relative to the scenario's folder" in capsys.readouterr().err
