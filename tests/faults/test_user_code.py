"""Code of the user's that fails in the middle of a run: the run faults, with what failed, when, and its rows."""

import json
import re
import subprocess
import sys

import pytest

from cosim.runs.series import read_series

pytestmark = pytest.mark.fmu

MODEL = """
import sys
from fmu_models.pendulum import derivative as good

n = 0

def model(x, u, m, l):
    global n
    n += 1
    return good(x, u, m=m, l=l) if n < 300 else fail()

def at_once(x, u, m, l):
    fail()

def fail():
    {statement}
"""
ESTIMATOR = """
class Leaving:
    is_whitened = True

    def __init__(self, *_):
        pass

    def restart(self, start):
        pass

    def solve(self, objective):
        raise SystemExit(0)

    def estimate(self):
        raise SystemExit(0)
"""
RUN = ["--only", "--set", "scenario.isolation=none", "--set", "scenario.stop_time=1.0"]
CHANGE = ["--set", 'changes."plant.m"=[[0.0, 1.75], [0.1, 4.271]]']


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes the user's module where the command works; its name, which no other test has."""

    def write(text: str) -> str:
        folder = tmp_path / "user"
        folder.mkdir()
        monkeypatch.chdir(folder)
        name = f"user_{tmp_path.name}"
        (folder / f"{name}.py").write_text(text)
        return name

    return write


@pytest.mark.full_but("return (1.0,)-IndexError: .*")
@pytest.mark.parametrize(
    ("statement", "told"),
    [
        ("sys.exit(0)", "SystemExit: 0"),
        ("raise GeneratorExit", "GeneratorExit: "),
        ("raise KeyError('k')", "KeyError: 'k'"),
        ("return 'ab'", "(TypeError|ValueError): .*"),
        ("return (1.0,)", "IndexError: .*"),
    ],
)
def test_a_model_that_raises_in_mid_run_faults_it(command, module, tmp_path, statement, told):
    name, out = module(MODEL.format(statement=statement)), tmp_path / "out"
    code, printed, err = command(
        "run", "pendulum", "--out", out, "--set", f"estimation.model={name}:model", *RUN, *CHANGE
    )
    assert code == 1
    by_whom = r"estimation\.model" if statement != "return 'ab'" else r"(estimator 'target'|estimation\.model)"
    assert re.match(rf"retune: {by_whom} failed at t = 0\.\d+ s: {told}", err), err
    assert (err.count("\n"), "Traceback" in printed + err) == (1, False)
    assert json.loads((out / "manifest.json").read_text())["status"] == "faulted"
    time = read_series(out)["time"]
    assert 5 < len(time) < 100
    (fault,) = [e for e in map(json.loads, (out / "events.jsonl").read_text().splitlines()) if e["kind"] == "fault"]
    assert fault["t"] >= time[-1]


@pytest.mark.full_but("1 / 0")
@pytest.mark.parametrize("statement", ["raise ValueError('no value here')", "1 / 0", "return (float('nan'),) * 2"])
def test_a_model_without_a_value_somewhere_is_a_bad_candidate_there_and_no_fault(command, module, tmp_path, statement):
    name, out = module(MODEL.format(statement=statement)), tmp_path / "out"
    code, _, err = command("run", "pendulum", "--out", out, "--set", f"estimation.model={name}:model", *RUN, *CHANGE)
    assert (code, err) == (0, "")
    assert len(read_series(out)["time"]) == 101


@pytest.mark.parametrize("words", [["run", "pendulum", "--only", "--out", "out"], ["check", "pendulum"]])
def test_a_module_that_exits_while_it_is_loaded_is_refused(command, module, words):
    name = module("import sys\nsys.exit(0)\n")
    code, out, err = command(*words, "--set", f"estimation.model={name}:model")
    assert code == 2
    assert re.search(rf"cannot load '{name}:model': SystemExit: 0", out + err)


def test_a_model_that_exits_in_its_first_call_is_refused(command, module, tmp_path):
    name = module(MODEL.format(statement="sys.exit(0)"))
    code, _, err = command("run", "pendulum", *RUN, "--out", "out", "--set", f"estimation.model={name}:at_once")
    assert code == 2
    assert "SystemExit: 0" in err


def test_an_estimator_that_exits_faults_the_run(command, module, tmp_path):
    name, out = module(ESTIMATOR), tmp_path / "out"
    code, _, err = command("run", "pendulum", "--estimator", f"{name}:Leaving", *RUN, *CHANGE, "--out", out)
    assert code == 1
    assert re.match(rf"retune: estimator '{name}:Leaving' failed at t = 0\.\d+ s: SystemExit: 0", err), err
    assert json.loads((out / "manifest.json").read_text())["status"] == "faulted"


OVERFLOWING = """
import numpy as np
from fmu_models.pendulum import derivative as good

def model(x, u, m, l):
    np.exp(np.float64(1e4)), np.log(np.float64(-1.0))
    return good(x, u, m=m, l=l)
"""


@pytest.mark.parametrize(
    "arguments",
    [["check"], ["run", *RUN, "--out", "run"], ["compare", *RUN[1:], "--estimators", "target", "--seeds", "1"]],
    ids=lambda arguments: arguments[0],
)
@pytest.mark.full
def test_a_warning_of_numpys_reaches_no_terminal(tmp_path, temporary, arguments):
    (tmp_path / "overflowing.py").write_text(OVERFLOWING)
    name, *options = arguments
    command = [sys.executable, "-m", "cosim.cli", name, "pendulum", "--set", "estimation.model=overflowing:model"]
    short = ["--set", "scenario.stop_time=0.2", *CHANGE] if name != "check" else []
    done = subprocess.run([*command, *options, *short], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    if name == "check":
        debug = subprocess.run([*command, "--debug"], capture_output=True, text=True, cwd=tmp_path)
        assert "RuntimeWarning: overflow encountered in exp" in debug.stderr
