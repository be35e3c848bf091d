"""`retune check`: each thing that is wrong or risky is found where it is, and a sound scenario has none."""

import re

import pytest

from cosim.authoring.check import check
from cosim.cli import main
from cosim.errors import ScenarioError
from cosim.runs.simulation import run
from cosim.scenarios.named import named_scenarios
from cosim.scenarios.scenario import Scenario

pytestmark = pytest.mark.fmu


CALLED = "estimation.model: note: 'axis_model:derivative' was called, at the start values"


def findings(path):
    """What `check` finds, but for what it says of itself, and of the empty libraries of `described`."""
    return [f for f in check(path) if str(f) != CALLED and "is not a valid shared library" not in f.what]


@pytest.mark.parametrize("name", named_scenarios())
def test_nothing_is_found_in_the_named_scenarios(name):
    assert [str(f) for f in check(name)] == []


def test_nothing_is_found_in_a_sound_scenario_of_foreign_fmus(axis, capsys):
    assert [str(f) for f in check(axis())] == [CALLED]
    assert main(["check", str(axis())]) == 0
    *_, summary, following = capsys.readouterr().out.splitlines()
    assert summary.endswith("axis.toml: 0 errors, 0 warnings")
    assert following.startswith("next: retune run /")


def test_a_value_that_is_none_of_the_types_it_may_have_is_one_error(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text('[changes]\n"plant.m" = [[0.0, 1.75], [0.05, nan]]\n"plant.l" = nan\n')
    found = [str(f) for f in check(path) if f.where.startswith("changes")]
    assert found == [
        "changes.plant.m.1.1: error: input should be a finite number, got nan",
        "changes.plant.l: error: input should be a finite number, got nan",
    ]


REMOVED = "nothing is said"
FAULT = '[[sampling.faults]]\nkind = "dropout"\n'
CASES = {
    "no such input": (('"controller.sRef" =', '"controller.s_ref" ='), "connections.controller.s_ref",
        "error: no variable 's_ref' in AxisController.fmu"),
    "an output as an input": (('"plant.f" =', '"plant.mass.s" ='), 'connections."plant.mass.s"',
        "error: 'mass.s' of Axis.fmu is an output, not an input"),
    "no such output": (('"controller.f_cmd"', '"controller.f_cmt"'), 'connections."plant.f"',
        "error: no variable 'f_cmt' in AxisController.fmu; did you mean 'f_cmd' (an output)?"),
    "a parameter as an output": (('"controller.f_cmd"', '"controller.m"'), 'connections."plant.f"',
        "error: 'm' is no output of AxisController.fmu"),
    "other dimensions": (('"plant.mass.v"', '"plant.der(mass.v)"'), 'connections."controller.v_meas"',
        "error: 'plant.der(mass.v)' to 'controller.v_meas': 'm/s2' cannot be converted to 'm/s': the dimensions"),
    "not connected": (('"plant.f" = "controller.f_cmd"\n', ""), 'connections."plant.f"',
        "warning: the input is not connected: it stays 0"),
    "a fixed parameter changes": (('"plant.mass.m" = [[', '"plant.damper.d" = [['), 'changes."plant.damper.d"',
        "error: 'damper.d' of Axis.fmu is a fixed parameter, not a tunable parameter"),
    "a change beyond the limits": (("[0.3, 3.0]", "[0.3, 30.0]"), 'changes."plant.mass.m"',
        "error: parameter 'mass.m' must be within [0.5, 20] kg, got 30, at t = 0.300 s"),
    "a formula beyond the limits": (("[[0.0, 2.0], [0.3, 3.0]]", '"2 + 40*t"'), 'changes."plant.mass.m"',
        "error: parameter 'mass.m' must be within [0.5, 20] kg, got 20.4, at t = 0.460 s"),
    "a formula below the limits": (("[[0.0, 2.0], [0.3, 3.0]]", '"2 + 1/(t - 0.5)"'), 'changes."plant.mass.m"',
        "error: parameter 'mass.m' must be within [0.5, 20] kg, got 0, at t = 0.000 s"),
    "a root of a negative number": (("[[0.0, 2.0], [0.3, 3.0]]", '"2 + sqrt(0.5 - t)"'), 'changes."plant.mass.m"',
        "error: has no value at t = 0.510 s: "),
    "nothing changes": (('"plant.mass.m" = [[0.0, 2.0], [0.3, 3.0]]\n', ""), "changes",
        "warning: nothing changes in the plant"),
    "tracked in another unit": (('"plant.mass.s" = "reference.s_ref"\n[sampling',
        '"plant.mass.s" = "reference.v_ref"\n[sampling'), 'tracking."plant.mass.s"',
        "error: 'reference.v_ref' to 'plant.mass.s': 'm/s' cannot be converted to 'm': the dimensions differ"),
    "no derivative": (('"plant.der(mass.v)"', '"plant.mass.v"'), 'sampling.derivatives."plant.mass.v"',
        "error: 'mass.v' is not declared as a state's derivative; did you mean 'der(mass.v)'?"),
    "no state": (("noise = 1e-3 }\n", 'noise = 1e-3 }\n[sampling.states]\n"plant.f" = { noise = 1.0 }\n'),
        'sampling.states."plant.f"', "error: no state with a declared derivative"),
    "a fixed parameter is written": (('writes = "controller.m"', 'writes = "controller.d"'),
        "estimation.parameters.0 (m)", "error: 'd' of AxisController.fmu is a fixed parameter, not a tunable"),
    "another unit": (('unit = "kg"', 'unit = "g"'), "estimation.parameters.0 (m)",
        "error: 'controller.m' has the unit kg, but 'm' g"),
    "bounds beyond the FMU's": (("upper = 10.0", "upper = 11.0"), "estimation.parameters.0 (m)",
        "error: 'controller.m' takes 0.1 to 10.0 kg; 'm' has [0.5, 11] kg"),
    "changed and written": (('"plant.mass.m" = [[', '"controller.m" = 2.0\n"plant.mass.m" = [['), "scenario",
        "error: estimation.parameters 'm': 'controller.m' is set twice: a parameter is either changed, or written"),
    "written and true": (('true = "plant.mass.m"', 'true = "controller.m"'), "scenario",
        "error: estimation.parameters 'm': 'controller.m' is written: 'true' of 'm' must name the plant's parameter"),
    "no bounds": (("lower = 0.5\n", ""), "estimation.parameters.0.lower", "error: is missing"),
    "no limits in the FMU": (('unit = "kg"\nwrites = "controller.m"', 'unit = "N/m"\nwrites = "controller.c"'),
        "estimation.parameters", "warning: AxisController.fmu declares neither min nor max of m: only lower"),
    "a guard that takes nothing back": (("[estimation]\n", "[guard]\ntolerance = 1.0\n[estimation]\n"),
        "guard.tolerance", "warning: 1 is as large as all the set points of the tracked outputs (1)"),
    "starts outside": (("lower = 0.5", "lower = 2.5"), "estimation.parameters.0 (m)",
        "warning: 'controller.m' starts at 2, outside [2.5, 10]"),
    "not in the plant": (('true = "plant.mass.m"\n', ""), "estimation.parameters.0 (m)",
        "error: no variable 'm' in Axis.fmu; give the one it stands for with true = ..."),
    "takes no start": (('"Axis.fmu" }', '"Axis.fmu", start = { "der(mass.s)" = 1.0 } }'),
        "components.plant.start.der(mass.s)", "error: 'der(mass.s)' of Axis.fmu takes no start value"),
    "starts beyond the FMU's limits": (('"Axis.fmu" }', '"Axis.fmu", start = { "mass.m" = 30.0 } }'),
        "components.plant.start.mass.m", "error: tunable parameter 'mass.m' must be within [0.5, 20] kg, got 30"),
    "no such FMU": (('"Axis.fmu"', '"Axle.fmu"'), "components.plant", "error: no FMU 'Axle.fmu'"),
    "a table that ends": (("stop_time = 1.0", "stop_time = 2.0"), "components.reference",
        "warning: its rows cover 0 to 1 s"),
    "a change after the end": (("[0.3, 3.0]]", "[1.3, 3.0]]"), 'changes."plant.mass.m"',
        "warning: changes at 1.300 s, but the run ends at 1.000 s"),
    "only a change after the end": (("[[0.0, 2.0], [0.3, 3.0]]", "[[1.3, 3.0]]"), 'changes."plant.mass.m"',
        "warning: its first row, at 1.300 s, holds from the start on: the run ends at 1.000 s"),
    "a change whose first row is late": (("[[0.0, 2.0], [0.3, 3.0]]", "[[0.3, 3.0]]"), 'changes."plant.mass.m"',
        "warning: its first row, at 0.300 s, holds from the start on: begin with one at 0.000 s"),
    "a change beyond the bounds": (("lower = 0.5\nupper = 10.0", "lower = 0.5\nupper = 2.5"),
        "estimation.parameters.0 (m)", "warning: 'plant.mass.m' changes to 3, outside [0.5, 2.5]"),
    "a set point that is a measurement": (('Ref" = "reference.s_ref"', 'Ref" = "plant.mass.s"'),
        "connections.controller.sRef",
        "warning: 'sRef' is a set point by its name, and 'plant.mass.s' a measurement"),
    "a long macro step": (("macro_step = 0.01", "macro_step = 1.0"), "scenario.macro_step",
        "warning: 100 times the step that Axis.fmu is made for, 0.01 s"),
    "a small part of the table": (("stop_time = 1.0\nmacro_step = 0.01", "stop_time = 0.005\nmacro_step = 0.0001"),
        "components.reference",
        "warning: the run is a small part of its rows, which end at 1 s: are their times in s?"),
    "escape sequences": (("macro_step = 0.01", 'macro_step = 0.01\n"\\u001b[31mX" = 1'), "scenario. [31mX",
        "error: unknown key"),
    "a key of a table below": (("[scenario]\n", "budget = 3\n[scenario]\n"), "budget",
        "error: unknown key; there is estimation.budget"),
    "a fault after the end": (("[estimation]\n", f"{FAULT}start = 1.0\n[estimation]\n"), "sampling.faults.0",
        "warning: starts at 1.000 s, but the run ends at 1.000 s"),
    "a fault before the start": (("[estimation]\n", f"{FAULT}start = -2.0\nstop = 0.0\n[estimation]\n"),
        "sampling.faults.0", "warning: stops at 0.000 s, before the run starts"),
    "instants outside of the run": (("[estimation]\n", "[estimation]\ninstants = [-1.0, 0.5, 2.0]\n"),
        "estimation.instants", "warning: -1.000, 2.000 s: the run is from 0.000 to 1.000 s"),
    "no loop through a state": (('"plant.mass.v"', '"plant.der(mass.s)"'), REMOVED, ""),
    "no module": (('"axis_model:derivative"', '"axle_model:derivative"'), "estimation.model",
        "error: cannot load 'axle_model:derivative': ModuleNotFoundError"),
    "an unknown key": (("macro_step = 0.01", "macro_step = 0.01\nmakro = 1"), "scenario.makro", "error: unknown key"),
    "an unknown component": (('"reference.s_ref"\n[sampling', '"referenz.s_ref"\n[sampling'), "tracking",
        "error: 'referenz.s_ref': no component 'referenz'; did you mean 'reference'?"),
}  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("replacement", "where", "what"), CASES.values(), ids=CASES)
def test_what_is_wrong_or_risky_is_found_where_it_is(axis, replacement, where, what):
    found = [str(f) for f in check(axis(replacement))]
    if where == REMOVED:
        assert found == [CALLED]
        return
    hits = [f for f in found if f.replace('"', "").startswith(f"{where}: {what}".replace('"', ""))]
    assert len(hits) == 1, found
    assert all("\n" not in f for f in found)


def test_several_findings_are_told_one_a_line_with_the_file_and_errors_refuse(axis, capsys):
    path = axis(('"Axis.fmu"', '"Axle.fmu"'), ('unit = "kg"', 'unit = "g"'), ("stop_time = 1.0", "stop_time = 2.0"))
    assert main(["check", str(path)]) == 2
    out, err = capsys.readouterr()
    lines = out.splitlines()
    assert err == ""
    assert [line.split(": ")[1:3] for line in lines[:-1]] == [
        ["components.plant", "error"], ["estimation.parameters.0 (m)", "error"], ["components.reference", "warning"],
    ]  # fmt: skip
    assert all(line.startswith(f"{path}: ") for line in lines)
    assert lines[-1] == f"{path}: 2 errors, 1 warning"


def test_every_error_of_the_schema_is_told(axis):
    found = check(axis(("macro_step = 0.01", "macro_step = 0"), ("lower = 0.5\n", ""), ('name = "axis"', 'name = ""')))
    assert {f.where for f in found} == {"scenario.macro_step", "scenario.name", "estimation.parameters.0.lower"}


@pytest.mark.parametrize(("start", "n_errors"), [("-5.0", 0), ("-1.0", 1), ("0.0", 1)])
def test_a_run_may_end_before_time_0_but_not_before_its_start(axis, start, n_errors):
    times = ("stop_time = 1.0", f"start_time = {start}\nstop_time = -1.0")
    found = check(axis(times, ("[[0.0, 2.0], [0.3, 3.0]]", "[[-5.0, 2.0], [-3.0, 3.0]]")))
    assert sum(f.is_error for f in found) == n_errors


@pytest.mark.parametrize(
    ("model", "message"),
    [
        ("def derivative(x, u, mass):\n    return (0.0, x[0])\n", "unexpected keyword argument 'm'"),
        (
            "def derivative(x, u, m):\n    return x[2] / m\n",
            "IndexError: tuple index out of range; x is (mass.v, mass.s), u is (f)",
        ),
        ("def derivate(x, u, m):\n    return (0.0, x[0])\n", "has no attribute 'derivative'"),
    ],
)
def test_a_model_that_does_not_fit_is_found(axis, tmp_path, model, message):
    (tmp_path / f"m{abs(hash(model))}.py").write_text(model)
    (found,) = check(axis(("axis_model", f"m{abs(hash(model))}")))
    assert (found.where, found.is_error) == ("estimation.model", True)
    assert message in found.what


def test_feedthrough_that_closes_a_loop_is_a_warning_and_the_plants_inertia_none(axis, described):
    gain = """<ScalarVariable name="u" valueReference="0" causality="input"><Real start="0" unit="N"/></ScalarVariable>
    <ScalarVariable name="y" valueReference="1" causality="output"><Real unit="m/s"/></ScalarVariable>"""
    described(gain, '<Outputs><Unknown index="2" dependencies="1"/></Outputs>', "Filter", 'needsExecutionTool="true"')
    new = 'reference = { table = "steps.csv" }\nfilter = { fmu = "Filter.fmu" }'
    wired = '"controller.v_meas" = "filter.y"\n"filter.u" = "controller.f_cmd"'
    path = axis(
        ('reference = { table = "steps.csv" }', new), ('"controller.v_meas" = "plant.mass.v"', wired)
    )  # f_cmd depends on v_meas, that on f_cmd
    found = {f.where: f for f in findings(path)}
    assert not any(f.is_error for f in found.values()), list(map(str, found.values()))
    assert "as AxisController.fmu declares no dependencies" in found["connections"].what
    assert "controller.f_cmd" in found["connections"].what
    assert "filter.y" in found["connections"].what
    assert "Filter.fmu needs the tool that made it" in found["components.filter"].what


def test_units_that_are_not_given_not_defined_or_to_be_converted_are_warnings(axis, described):
    outputs = "".join(
        f'<ScalarVariable name="{name}" valueReference="{i}" causality="output"><Real {unit}/></ScalarVariable>'
        for i, (name, unit) in enumerate({"a": "", "b": 'unit="tick"', "c": 'unit="mm"', "n": ""}.items())
    ).replace('name="n" valueReference="3" causality="output"><Real />',
              'name="n" valueReference="3" causality="output" variability="discrete"><Integer/>')  # fmt: skip
    described(outputs, "", "Sensor", "")
    new = (
        'reference = { table = "steps.csv" }',
        'reference = { table = "steps.csv" }\nsensor = { fmu = "Sensor.fmu" }',
    )
    found = {}
    for output in "abc":
        (found[output],) = findings(
            axis(new, ('"plant.mass.s"\n"controller.v_meas"', f'"sensor.{output}"\n"controller.v_meas"'))
        )
    assert [f.is_error for f in found.values()] == [False, False, False]
    assert "'sensor.a' has no unit, the other end m" in found["a"].what
    assert "'tick' is not defined" in found["b"].what
    assert found["c"].what == "'sensor.c' is in mm, 'controller.s_meas' in m (x mm = 0.001 x m), and is converted"


def test_a_step_that_an_fmu_does_not_take_is_a_warning(axis, described):
    import zipfile

    path = described(
        '<ScalarVariable name="y" valueReference="0" causality="output"><Real/></ScalarVariable>', "", "Fixed"
    )
    with zipfile.ZipFile(path) as fmu:
        files = {name: fmu.read(name) for name in fmu.namelist()}
    xml = files["modelDescription.xml"].decode()
    files["modelDescription.xml"] = xml.replace(
        "<ModelVariables>", '<DefaultExperiment stepSize="0.002"/><ModelVariables>'
    )
    with zipfile.ZipFile(path, "w") as fmu:
        for name, content in files.items():
            fmu.writestr(name, content)
    new = ('reference = { table = "steps.csv" }', 'reference = { table = "steps.csv" }\nf = { fmu = "Fixed.fmu" }')
    (found,) = findings(axis(new))
    assert str(found) == "scenario.macro_step: warning: Fixed.fmu supports no other steps than 0.002 s"
    assert findings(axis(new, ("macro_step = 0.01", "macro_step = 0.002"))) == []


def test_what_is_no_scenario_is_refused_in_one_line(axis, capsys, tmp_path):
    (tmp_path / "no.toml").write_text("[scenario\n")
    with pytest.raises(ScenarioError, match="not a readable TOML file"):
        check(tmp_path / "no.toml")
    assert main(["check", str(tmp_path / "no.fmu")]) == 2
    assert re.fullmatch(r"retune: .*no\.fmu cannot be read: No such file or directory\n", capsys.readouterr().err)


@pytest.mark.parametrize(
    ("replacement", "found"),
    [
        (("[changes]\n", "[changes]\n"), 'connections."tank.FILL": warning: the input is not connected: it stays 0'),
        (("[changes]\n", '"tank.FILL" = "plant.mass"\n[changes]\n'),
         "connections.\"tank.FILL\": error: no variable 'mass' in Axis.fmu"),
        (('"plant.mass.s" = "reference.s_ref"\n[s', '"tank.FILL" = "reference.s_ref"\n[s'),
         "tracking.\"tank.FILL\": error: 'FILL' is no output of Tank.fmu"),
        (('"reference.s_ref"\n[s', '"reference.FILL"\n[s'),
         'tracking."plant.mass.s": error: FILL is still there: it is to be filled in'),
        (('"controller.m"', '"controller.FILL"'),
         "estimation.parameters.0 (m): error: FILL is still there: it is to be filled in"),
        (('"AxisController.fmu"', '"FILL.fmu"'),
         "components.controller: error: FILL is still there: it is to be filled in"),
    ],
    ids=["a warning", "an error", "an error of its own", "in a value", "in a parameter", "a file"],
)  # fmt: skip
def test_a_variable_called_fill_is_not_what_is_to_be_filled_in(axis, described, replacement, found):
    described(
        '<ScalarVariable name="FILL" valueReference="0" causality="input"><Real start="0"/></ScalarVariable>',
        name="Tank",
    )
    tank = ("reference = {", 'tank = { fmu = "Tank.fmu" }\nreference = {')
    told = [str(f) for f in findings(axis(tank, replacement))]
    assert len([text for text in told if text.startswith(found)]) == 1, told
    assert len([text for text in told if "still there" in text]) == ("still there" in found)


@pytest.mark.full
def test_a_run_of_the_scenario_tells_which_noise_to_declare(tmp_path, monkeypatch):
    """The sensor's noise is 0.05 and 0.001, drawn independently: 0.05001 in all, where 0.001 is declared."""
    monkeypatch.chdir(tmp_path)
    noisy = {"sampling.faults": '[{ sensor = "plant.der(phi_dot)", kind = "noise", size = 0.05 }]'}
    assert check("pendulum", noisy) == []
    run(Scenario.load("pendulum", noisy), "target", out=tmp_path / "runs" / "pendulum-2")
    (found,) = check("pendulum", noisy)
    assert found.where == 'sampling.derivatives."plant.der(phi_dot)"'
    assert found.is_note
    assert 0.04 < float(found.what.rpartition("noise = ")[2]) < 0.0625
    assert check("pendulum") == []  # a run with other sensors tells nothing
    (tmp_path / "runs" / "pendulum-2" / "manifest.json").write_text("{")
    assert check("pendulum", noisy) == []
