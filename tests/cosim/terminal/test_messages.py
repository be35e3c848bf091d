"""What the command says where something is wrong, and what it says is to be done next."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from cosim.cli import main
from cosim.names import did_you_mean
from cosim.terminal.run_output import telling_how_to_resume

ROOT = Path(__file__).parents[3]
SHORT = ["--set", "scenario.stop_time=0.05", "--only"]


def test_a_misspelt_table_is_told_before_what_is_missing_for_it(axis):
    path = axis(("[tracking]", "[traking]"))
    assert main(["check", str(path)]) == 2
    assert main(["run", str(path)]) == 2


def test_a_misspelt_table_brings_its_name(axis, capsys):
    main(["run", str(axis(("[tracking]", "[traking]")))])
    assert "axis.toml: traking: unknown key; did you mean 'tracking'? (and 1 more)\n" in capsys.readouterr().err


def test_a_misspelt_command_brings_its_name(called):
    code, out, err = called("rum", "pendulum")
    assert (code, out) == (2, "")
    assert err == "retune: no command 'rum'; did you mean 'run'?; see retune --help\n"


@pytest.mark.parametrize(
    ("name", "known", "meant"),
    [
        ("inertia1.j", ["inertia1.phi", "inertia2.j", "inertia1.J"], "inertia1.J"),
        ("KP", ["Kq", "kp", "Kd"], "kp"),
        ("thata", ["phi", "theta"], "theta"),
    ],
)
def test_a_name_in_other_letters_is_found_first(name, known, meant):
    assert did_you_mean(name, known) == f"; did you mean '{meant}'?"


@pytest.mark.parametrize("command", ["run", "compare", "export"])
def test_an_fmu_in_place_of_a_scenario_is_told_what_it_is(foreign, workplace, called, command):
    more = ["--ssp", "x.ssp"] if command == "export" else []
    code, out, err = called(command, foreign / "Axis.fmu", *more)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "Axis.fmu is an FMU, not a scenario: retune info " in err
    assert re.search(r"retune new --plant \S+Axis.fmu -o FILE.toml writes a scenario for it", err)


def test_a_run_folder_in_place_of_a_scenario_is_told_what_it_is(workplace, called):
    assert called("run", "pendulum", *SHORT, "--estimator", "none", "--out", "mine")[0] == 0
    code, _, err = called("run", "mine")
    assert (code, err.count("\n")) == (2, 1)
    assert "mine is a folder, not a scenario: a run's goes on with retune resume mine" in err


@pytest.mark.fmu
@pytest.mark.parametrize(("estimator", "following"), [("target", "ukf"), ("ukf", "target"), ("none", "ukf")])
@pytest.mark.full_but("none-ukf")
def test_a_run_ends_with_the_line_that_replays_it(workplace, called, estimator, following):
    code, out, _ = called("run", "pendulum", *SHORT, "--estimator", estimator)
    assert code == 0
    last = out.splitlines()[-1]
    assert last == f"next: retune replay runs/pendulum-1 --estimator {following}"
    code, out, err = called(*shlex.split(last)[2:])
    assert (code, err) == (0, "")
    assert out.splitlines()[-1].startswith("next: retune compare pendulum --estimators ")


@pytest.mark.fmu
def test_a_run_that_cannot_be_signed_proposes_trust(workplace, called, tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    code, out, _ = called("run", "pendulum", *SHORT, "--estimator", "none")
    assert (code, out.splitlines()[-1]) == (0, "next: retune replay runs/pendulum-1 --estimator ukf --trust")


@pytest.mark.fmu
def test_json_is_followed_by_nothing(workplace, called):
    for arguments in (["run", "pendulum", *SHORT, "--estimator", "none"], ["compare", "pendulum", "--help"]):
        assert "next:" not in called(*arguments, "--json")[1]


@pytest.mark.fmu
def test_an_interrupt_says_why_a_run_cannot_be_resumed(workplace, called):
    assert called("run", "pendulum", *SHORT, "--estimator", "none", "--only", "--out", "run")[0] == 0
    with pytest.raises(KeyboardInterrupt) as e, telling_how_to_resume(Path("run")):
        raise KeyboardInterrupt
    assert str(e.value) == "what was recorded is in run; it cannot be resumed: it is done"


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_an_interrupt_names_the_folder_and_the_line_that_resumes(workplace, becomes_true):
    command = [sys.executable, "-m", "cosim.cli", "run", "pendulum", "--only", "--out", "mine folder"]
    more = ["--estimator", "none", "--set", "scenario.stop_time=3600.0"]
    process = subprocess.Popen([*command, *more], stderr=subprocess.PIPE, text=True, env=os.environ)
    series = workplace / "mine folder" / "series.arrow"
    assert becomes_true(lambda: series.exists() and series.stat().st_size > 20_000)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines()[-1] == (
        "retune: interrupted; what was recorded is in mine folder; retune resume 'mine folder' goes on"
    )


# -- docs/messages.md -------------------------------------------------------------------------------------------------

LISTED = re.findall(r"^\| `(.*?)` \|", (ROOT / "docs" / "messages.md").read_text(encoding="utf-8"), re.MULTILINE)
SOURCES = "".join(
    re.sub(r'"\s*\n\s*f?"', "", path.read_text(encoding="utf-8"))
    for folder in ("cosim", "estimator")
    for path in sorted((ROOT / folder).rglob("*.py"))
)


def test_the_list_is_long_enough_to_be_one():
    assert len(LISTED) > 40


@pytest.mark.parametrize("message", LISTED)
def test_each_listed_message_is_one_that_the_code_has(message):
    """Its literal parts, between the dots that stand for names and numbers."""
    for part in (part.strip() for part in message.split("...")):
        assert part in SOURCES, part


def test_what_is_nearly_a_scenario_is_told(called, workplace):
    (workplace / "d2.toml").write_text("")
    (workplace / "steps.csv").write_text("time,y\n0,1\n")
    code, _, err = called("run", "d2")
    assert (code, err.rstrip()[-len("did you mean 'd2.toml'?") :]) == (2, "did you mean 'd2.toml'?")
    code, _, err = called("check", "steps.csv")
    assert code == 2
    assert "steps.csv is a table, not a scenario: retune new --plant FMU --reference steps.csv takes one." in err


def test_an_fmu_in_the_working_directory_is_not_taken_for_one_beside_the_scenario(called, workplace):
    (workplace / "Mine.fmu").write_bytes(b"")
    code, _, err = called("run", "pendulum", "--set", "components.plant.fmu=Mine.fmu")
    assert code == 2
    assert f"the one here is {workplace / 'Mine.fmu'}" in err


def test_start_values_of_a_component_need_a_file(called, workplace):
    code, _, err = called("run", "pendulum", "--start-values", "controller=")
    assert code == 2
    assert "must be [COMPONENT=]SSV, got 'controller='" in err


@pytest.mark.parametrize("model", ["nowhere.fmu", "plant_model", "a b:c"])
def test_a_draft_needs_a_model_that_can_be_one(foreign, workplace, called, model):
    code, out, err = called("new", "--plant", foreign / "Axis.fmu", "--model", model, "-o", "axis.toml")
    assert (code, out) == (2, "")
    assert f"{model} is no model: it must be module:function, or an FMU's file." in err
    assert not (workplace / "axis.toml").exists()
