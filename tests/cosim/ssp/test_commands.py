"""`retune export`, and `retune run` on packages."""

import json
from pathlib import Path

import pytest
from fmpy.ssp.ssd import read_ssv

import cosim
from cosim.runs.series import read_series
from cosim.system.fmu_cache import find_fmu

pytestmark = [pytest.mark.fmu, pytest.mark.usefixtures("leaves_nothing", "workplace")]
SHORT = ["--set", "scenario.stop_time=0.2", "--only", "--json"]
SCENARIOS = Path(cosim.__file__).parent / "scenarios"
CHANGE = ["--set", 'changes."plant.m"=[[0.0, 1.75], [0.05, 4.271]]']


NEXT = "next: retune run p.ssp\n"


def test_an_export_is_not_overwritten(called, workplace):
    assert called("export", "pendulum", "--ssp", "p.ssp") == (0, f"p.ssp  written\n{NEXT}", "")
    assert called("export", "pendulum", "--ssp", "p.ssp") == (0, f"p.ssp  unchanged\n{NEXT}", "")
    before = (workplace / "p.ssp").read_bytes()
    shorter = ["export", "pendulum", "--set", "scenario.stop_time=1.0", "--ssp", "p.ssp"]
    assert called(*shorter) == (2, "", "retune: p.ssp exists and differs; give --force or another --ssp.\n")
    assert (workplace / "p.ssp").read_bytes() == before
    assert called(*shorter, "--force") == (0, f"p.ssp  replaced\n{NEXT}", "")


def test_an_export_runs_as_the_scenario_does(called, workplace):
    assert called("export", "pendulum", *CHANGE, "--ssp", "p.ssp")[0] == 0
    assert called("run", "p.ssp", *SHORT, "--out", "one")[0] == 0
    assert called("run", "pendulum", *CHANGE, *SHORT, "--out", "other")[0] == 0
    for name in ("series.arrow", "events.jsonl", "estimates.ssv"):
        assert (workplace / "one" / name).read_bytes() == (workplace / "other" / name).read_bytes(), name
    assert (workplace / "one" / "events.jsonl").stat().st_size > 0


ROLLOUT = ["estimation.objective=rollout", 'sampling.outputs."plant.phi".noise=1e-4', "estimation.rollout.fmu=own.fmu"]


@pytest.mark.full
@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ((3, "ModelExchange"), ["estimation.model=own.fmu"]),
        ((2, "CoSimulation"), ROLLOUT),
        ((2, "CoSimulation"), [*ROLLOUT, "components.plant.fmu=own.fmu", "estimation.rollout.start=state"]),
    ],
    ids=["model", "rollout", "rollout-of-the-plant"],
)
def test_the_fmus_of_model_and_roll_outs_go_along(called, workplace, kind, settings):
    (workplace / "own.toml").write_text((SCENARIOS / "pendulum.toml").read_text())
    (workplace / "own.fmu").write_bytes(find_fmu("Pendulum", workplace, *kind).read_bytes())
    arguments = ["own.toml", *CHANGE, *(part for setting in settings for part in ("--set", setting))]
    assert called("export", *arguments, "--ssp", "p.ssp")[0] == 0
    assert called("run", *arguments, *SHORT, "--out", "other")[0] == 0
    (workplace / "own.fmu").unlink()
    assert called("run", "p.ssp", *SHORT, "--out", "one")[0] == 0
    for name in ("series.arrow", "events.jsonl", "estimates.ssv"):
        assert (workplace / "one" / name).read_bytes() == (workplace / "other" / name).read_bytes(), name
    assert (workplace / "one" / "events.jsonl").stat().st_size > 0


@pytest.mark.parametrize(
    ("key", "value", "asks"),
    [
        pytest.param("environment", '["*"]', "give its FMUs more of the environment", marks=pytest.mark.full),
        ("isolation", '"none"', "load its FMUs into retune's own process"),
        pytest.param("most_components", "70", "start more FMUs than usual", marks=pytest.mark.full),
    ],
)
def test_a_package_cannot_ask_for_trust(called, package, workplace, key, value, asks):
    """An export leaves it out; a package made by hand that has it is refused, unless the user asks for the same."""
    text = (SCENARIOS / "pendulum.toml").read_text()
    tables = text.replace("[scenario]\n", f"[scenario]\n{key} = {value}\n")
    assert tables != text
    path = package(files={"extra/org.fmu-retune/scenario.toml": tables}, name="asks.ssp")
    message = f"retune: {path} would {asks}, which only --trust allows: look at it first.\n"
    assert called("run", path, *SHORT) == (2, "", message)
    assert asks in called("check", path)[1]
    assert called("run", path, *SHORT, "--set", f"scenario.{key}={value}")[0] == 0
    (workplace / "asks.toml").write_text(tables)
    assert called("export", "asks.toml", "--ssp", "own.ssp")[0] == 0
    assert called("run", "own.ssp", *SHORT)[0] == 0


@pytest.mark.full
def test_estimates_leave_as_ssv_and_start_another_run(called, workplace):
    _, out, _ = called("run", "pendulum", *CHANGE, *SHORT, "--ssv", "found.ssv")
    held = json.loads(out)["parameters"]
    found = read_ssv("found.ssv")  # validates
    assert [(p.name, float(p.value), p.unit) for p in found.parameters] == [
        (f"controller.{p['name']}", p["estimated"], p["unit"]) for p in held
    ]
    arguments = ["run", "pendulum", *SHORT, "--estimator", "none", "--out", "next", "--start-values", "found.ssv"]
    assert called(*arguments)[0] == 0
    assert read_series(workplace / "next")["controller.m"][0] == held[0]["estimated"]
    refused = called("run", "pendulum", *SHORT, "--ssv", "found.ssv")
    assert refused == (2, "", "retune: found.ssv exists; give --ssv a new file.\n")


def test_a_package_from_elsewhere_is_simulated_plainly(called, package, workplace):
    code, out, err = called("run", package(), "--set", "components.plant.start.phi=0.4", "--out", "plain")
    assert (code, err) == (0, "")
    for part in ("hand made: 0.2 s simulated", "no estimator", "plant.phi", "run folder plain"):
        assert part in out
    series = read_series(workplace / "plain")
    assert len(series["time"]) == 21
    assert series["plant.phi"][0] == 0.4
    result = json.loads((workplace / "plain" / "result.json").read_text())
    assert result["outputs"]["plant.phi"]["last"] == series["plant.phi"][-1]
    assert json.loads((workplace / "plain" / "manifest.json").read_text())["status"] == "done"


def test_start_values_of_a_package_from_elsewhere(called, package, workplace):
    (workplace / "start.ssv").write_text(
        '<ParameterSet xmlns="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="s">'
        '<Parameters><Parameter name="plant.phi"><Real value="0.3"/></Parameter></Parameters></ParameterSet>'
    )
    code, out, _ = called("run", package(), "--start-values", "start.ssv", "--json")
    assert code == 0
    assert json.loads(out)["outputs"]["plant.phi"]["first"] == 0.3


def ssv(name, unit=""):
    return (
        '<ParameterSet xmlns="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="s">'
        f'<Parameters><Parameter name="{name}"><Real value="1.0" {unit}/></Parameter></Parameters></ParameterSet>'
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (ssv("m"), "'m' is no COMPONENT.VARIABLE; of plant alone? --start-values plant=start.ssv"),
        (ssv("mm"), "start.ssv: parameter 'mm' is no COMPONENT.VARIABLE."),
        (ssv("plant.mm"), "start.ssv: no variable 'mm' in plant; did you mean 'm'?"),
        (ssv("plant.m", 'unit="lb"'), "start.ssv: parameter 'plant.m': 'lb' cannot be converted to 'kg'"),
        ("<a>", "start.ssv is not readable XML"),
    ],
)
def test_bad_start_values_are_refused_in_one_line(called, workplace, content, message):
    (workplace / "start.ssv").write_text(content)
    code, out, err = called("run", "pendulum", *SHORT, "--start-values", "start.ssv")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert list(workplace.iterdir()) == [workplace / "start.ssv"]


@pytest.mark.full_but("one")
@pytest.mark.parametrize(
    ("files", "m"),
    [(["controller=m.ssv"], 1.0), (["controller=m.ssv", "all.ssv"], 3.0), (["all.ssv", "controller=m.ssv"], 1.0)],
    ids=["one", "a later one counts", "the other way round"],
)
def test_start_values_of_one_component_are_named_as_it_names_them(called, workplace, files, m):
    (workplace / "m.ssv").write_text(ssv("m"))
    (workplace / "all.ssv").write_text(ssv("controller.m").replace('value="1.0"', 'value="3.0"'))
    options = [part for file in files for part in ("--start-values", file)]
    code, _, err = called("run", "pendulum", *SHORT, "--estimator", "none", "--out", "out", *options)
    assert (code, err) == (0, "")
    assert read_series(workplace / "out")["controller.m"][0] == m


@pytest.mark.parametrize(
    ("component", "told"),
    [
        ("contoller", "no component 'contoller'; did you mean 'controller'"),
        ("reference", "no variable 'm' in reference"),
    ],
)
def test_start_values_that_the_component_does_not_have_are_refused(called, workplace, component, told):
    (workplace / "m.ssv").write_text(ssv("m"))
    code, _, err = called("run", "pendulum", *SHORT, "--start-values", f"{component}=m.ssv")
    assert (code, err.count("\n")) == (2, 1)
    assert told in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--estimator", "ukf"], "holds no scenario: nothing is estimated in it; give --scenario FILE."),
        (["--ssv", "a.ssv"], "holds no scenario: nothing is estimated in it"),
        (["--set", "components.plane.start.phi=1"], "no component 'plane'; did you mean 'plant'?"),
        (["--set", "scenario.coupling=sequential"], "without an estimator coupling is 'parallel', got 'sequential'"),
        (["--set", "estimation.budget=3"], "estimation: unknown key"),
        (["--set", "scenario.stop_time=-1"], "stop_time"),
        (["--set", f"components.plant.start.phi=1{'0' * 400}"], "start.phi: must be a number that a double can hold"),
        (["--set", "components.plant.start.u_held=1"], "'u_held' of Pendulum.fmu takes no start value"),
    ],
)
def test_what_a_plain_run_cannot_do_is_refused_in_one_line(called, package, workplace, arguments, message):
    code, out, err = called("run", package(), *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert err.startswith("retune: ")
    assert message in err
    assert not (workplace / "runs").exists() or not list((workplace / "runs").iterdir())


def test_a_fault_keeps_the_rows_so_far(called, package, workplace):
    start = "components.reference.start"  # from the step on the controller's output is infinite
    settings = ["--set", f"{start}.phi_final=1e308", "--set", f"{start}.step_time=0.1"]
    code, _, err = called("run", package(), *settings, "--out", "plain")
    assert (code, err.count("\n")) == (1, 1)
    assert err.startswith("retune: controller: ")
    assert "the rows so far are in plain" in err
    assert json.loads((workplace / "plain" / "result.json").read_text())["status"] == "faulted"
    assert json.loads((workplace / "plain" / "events.jsonl").read_text())["kind"] == "fault"
    assert 10 <= len(read_series(workplace / "plain")["time"]) <= 12


def test_a_scenario_file_goes_with_a_package(called, workplace):
    refused = called("run", "pendulum", "--scenario", "tuning.toml")
    assert refused == (2, "", "retune: --scenario goes with an SSP package, got 'pendulum'.\n")
    assert called("run", "none.ssp")[2].startswith("retune: no scenario 'none.ssp': neither a file nor one of")


def test_an_export_needs_a_file(called):
    code, _, err = called("export", "pendulum")
    assert (code, err.count("\n")) == (2, 1)
    assert "--ssp" in err
