"""The examples do what their READMEs say."""

import importlib.util
import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from cosim import read_run
from cosim.authoring.draft import draft

_spec = importlib.util.spec_from_file_location("run_examples", Path(__file__).parents[2] / "examples" / "run.py")
examples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(examples)

pytestmark = [
    pytest.mark.full,
    pytest.mark.fmu,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@pytest.fixture
def carried_out(tmp_path, monkeypatch, capfd):
    """carried_out(name): the folder in which an example was carried out, and what it printed."""

    def carry_out(name):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["run.py", name])
        assert examples.main() == 0
        return tmp_path / name, capfd.readouterr().out

    return carry_out


def shown(name):
    """Lines of the README's blocks of output, `...` for any number of others."""
    text = (examples.FOLDER / name / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [line for language, block in blocks if language == "text" for line in block.splitlines()]


def agrees(name, printed):
    """Assert that the lines of the README are printed, their words as they are and their numbers to 5 %."""
    found = [
        ([*NUMBER.sub("#", line).split()], [float(n) for n in NUMBER.findall(line)]) for line in printed.splitlines()
    ]
    for line in shown(name):
        words, numbers = NUMBER.sub("#", line).split(), [float(n) for n in NUMBER.findall(line)]
        if line != "...":
            assert any(words == w and numbers == pytest.approx(n, rel=0.05) for w, n in found), line


def test_a_pi_controller_gets_its_gains_from_an_inertia(carried_out):
    folder, printed = carried_out("pi-speed-drive")
    agrees("pi-speed-drive", printed)
    result = read_run(folder / "runs" / "drive-1")
    J, d = 0.08, 0.05
    assert result["controller.PI.k"][-1] == pytest.approx(32.0 * J - d, rel=0.01)  # 2 * 0.8 * 20 rad/s
    assert result["controller.PI.Ti"][-1] == pytest.approx((32.0 * J - d) / (400.0 * J), rel=0.01)
    nominal, true = (read_run(folder / "runs" / "drive-1" / name) for name in ("none", "true"))
    assert result.mse[0] < 1.5 * true.mse[0] < 0.2 * nominal.mse[0]
    assert (folder / "runs" / "drive-1" / "parameters.png").is_file()


def test_a_plant_that_hides_its_states_is_re_tuned_by_roll_outs(carried_out):
    folder, printed = carried_out("outputs-only")
    agrees("outputs-only", printed)
    result = read_run(folder / "runs" / "lab-stage-1")
    assert "saved state" in result.objective
    assert result["controller.m"][-1] == pytest.approx(5.0, rel=0.05)
    nominal, true = (read_run(folder / "runs" / "lab-stage-1" / name) for name in ("none", "true"))
    assert result.mse[0] < 1.2 * true.mse[0] < 0.5 * nominal.mse[0]


def test_its_scenario_is_what_new_writes_but_for_what_changes(carried_out, tmp_path):
    folder, _ = carried_out("outputs-only")
    parts = {"plant": "Stage.fmu", "controller": "PositionController.fmu", "reference": "way.csv"}
    drafted = draft({role: folder / name for role, name in parts.items()}, folder).text.splitlines()
    kept = (folder / "stage.toml").read_text(encoding="utf-8").splitlines()
    different = [(a, b) for a, b in zip(drafted, kept, strict=True) if a != b]
    assert [b for _, b in different] == ['"plant.stage.m" = [[0.0, 2.0], [2.0, 5.0]]']


def test_a_room_is_found_in_its_log(carried_out):
    folder, printed = carried_out("thermal-zone")
    agrees("thermal-zone", printed)
    found = json.loads((folder / "runs" / "Zone-estimate-1" / "estimate.json").read_text())["parameters"]
    for name, value in (("air.C", 5e6), ("wall.R", 0.006)):  # of make_log.py
        assert abs(found[name]["value"] - value) < 4.0 * found[name]["std"]


def test_an_input_that_the_command_forgets_is_told(carried_out, capfd):
    _, printed = carried_out("thermal-zone")
    assert "has no column" not in printed
    (command,) = examples.commands("thermal-zone")
    words = shlex.split(command.replace("--input heater.Q_flow=heat", ""))[1:]
    assert examples.retune([*words, "--evaluations", "5"]) == 0
    assert "input 'heater.Q_flow' of Zone.fmu has no column and stays 0" in capfd.readouterr().out


def test_the_estimator_re_tunes_in_another_tools_ssp(carried_out):
    folder, printed = carried_out("estimator-in-ssp")
    lines = printed.splitlines()
    figures = {line.split(".")[0]: [float(n) for n in NUMBER.findall(line)] for line in lines if ".ssp: mean" in line}
    assert figures["retuned"][0] < 0.1 * figures["nominal"][0]
    assert figures["retuned"][-3:] == pytest.approx([0.08, 2.51, 2.51 / 32.0], rel=0.01)
    assert [figures[name][0] for name in ("nominal", "retuned")] == pytest.approx([98.3, 5.99], rel=0.05)
    assert (folder / "retuned.ssp").is_file()
