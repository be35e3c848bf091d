"""The examples do what their READMEs say."""

import importlib.util
import re
import shutil
import sys
from pathlib import Path

import pytest

from cosim import read_run

_spec = importlib.util.spec_from_file_location("run_examples", Path(__file__).parents[2] / "examples" / "run.py")
examples = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(examples)

pytestmark = [
    pytest.mark.full,
    pytest.mark.fmu,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]


@pytest.fixture
def carried_out(tmp_path, monkeypatch, capsys):
    """carried_out(name): the folder in which an example was carried out, and what it printed."""

    def carry_out(name):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["run.py", name])
        assert examples.main() == 0
        return tmp_path / name, capsys.readouterr().out

    return carry_out


def shown(name):
    """Lines of the README's blocks of output, `...` for any number of others."""
    text = (examples.FOLDER / name / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [line for language, block in blocks if not language for line in block.splitlines()]


def agrees(name, printed):
    """Assert that the lines of the README are printed, their words as they are and their numbers to 5 %."""
    number = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?")
    found = [
        ([*number.sub("#", line).split()], [float(n) for n in number.findall(line)]) for line in printed.splitlines()
    ]
    for line in shown(name):
        words, numbers = number.sub("#", line).split(), [float(n) for n in number.findall(line)]
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
