"""The command, as a user types it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cosim.record import read_series

RETUNE = Path(sys.executable).with_name("retune")
KEYS = {
    "scenario", "estimator", "seed", "mse", "max_error", "parameters", "instants", "evaluations", "episodes",
    "latency_ms", "deadline_ms", "missed_deadlines", "wall_s", "status", "diverged_at", "error", "run",
}  # fmt: skip
SHORT = ("--set", "scenario.stop_time=0.3")


def retune(folder, *arguments):
    return subprocess.run([RETUNE, *arguments], cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.fmu
def test_json_is_one_object_with_the_documented_keys_and_nothing_else(tmp_path):
    done = retune(tmp_path, "run", "pendulum", "--only", "--json", "--seed", "3", *SHORT)
    assert (done.returncode, done.stderr) == (0, "")
    figures = json.loads(done.stdout)
    assert set(figures) == KEYS
    assert (figures["scenario"], figures["estimator"], figures["seed"]) == ("pendulum", "target", 3)
    assert set(figures["parameters"][0]) == {"name", "unit", "true", "estimated"}
    assert set(figures["latency_ms"]) == {"p50", "p99", "max"}
    assert figures["run"] == "runs/pendulum-1"


@pytest.mark.fmu
def test_a_run_draws_its_pictures_and_simulates_what_it_is_compared_with(tmp_path):
    change = ("--set", 'changes."plant.m"=[[0.0, 1.75], [0.05, 4.0]]')
    done = retune(tmp_path, "run", "pendulum", "--out", "here", *SHORT, *change)
    assert (done.returncode, done.stderr) == (0, "")
    names = {path.name for path in (tmp_path / "here").iterdir()}
    assert {"tracking.png", "parameters.png", "error.png", "response.png", "none", "true"} <= names
    assert "nominal controller" in done.stdout


@pytest.mark.fmu
def test_build_makes_six_fmus_and_overwrites_nothing_of_the_users(tmp_path):
    assert retune(tmp_path, "build", "--out", "fmus").returncode == 0
    assert len(list((tmp_path / "fmus").glob("*.fmu"))) == 6
    assert retune(tmp_path, "build", "--out", "fmus").stdout.count("unchanged") == 6
    mine = tmp_path / "fmus" / "Pendulum.fmu"
    mine.write_text("mine")
    refused = retune(tmp_path, "build", "--out", "fmus")
    assert refused.returncode == 2
    assert "differs" in refused.stderr
    assert mine.read_text() == "mine"
    assert retune(tmp_path, "build", "--out", "fmus", "--force").returncode == 0


@pytest.mark.fmu
def test_a_diverged_run_exits_with_1_and_says_so_in_one_line(tmp_path):
    done = retune(tmp_path, "run", "pendulum", "--only", "--estimator", "none", "--set", "limits.divergence=0.01",
                  "--set", 'changes."plant.m"=4.0')  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("retune: diverged at t = ")
    assert done.stderr.count("\n") == 1


@pytest.mark.fmu
def test_an_interrupted_run_exits_with_130_and_keeps_its_rows(tmp_path):
    process = subprocess.Popen(
        [RETUNE, "run", "quadrotor", "--only", "--estimator", "none", "--set", "scenario.stop_time=200.0"],
        cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    series = tmp_path / "runs" / "quadrotor-1" / "series.arrow"
    until = time.monotonic() + 60.0
    while not (series.exists() and series.stat().st_size > 200_000) and time.monotonic() < until:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors.count("\n") == 1
    assert len(read_series(series.parent)["time"]) > 50


BAD = {
    "no command": [],
    "unknown command": ["tune"],
    "unknown scenario": ["run", "pendulun"],
    "missing file": ["run", "missing.toml"],
    "not a scenario": ["run", "text.toml"],
    "unknown estimator": ["run", "pendulum", "--estimator", "taget"],
    "macro step 0": ["run", "pendulum", "--set", "scenario.macro_step=0"],
    "unknown key": ["run", "pendulum", "--set", "estimation.budgt=3"],
    "reversed bounds": ["run", "reversed.toml"],
    "not key=value": ["run", "pendulum", "--set", "budget"],
    "negative seed": ["run", "pendulum", "--seed", "-1"],
    "folder in use": ["run", "pendulum", "--out", "full"],
    "folder under a file": ["run", "pendulum", "--out", "text.toml/run"],
    "missing FMU": ["run", "pendulum", "--set", "components.plant.fmu=missing.fmu"],
    "no such variable": ["run", "pendulum", "--set", 'changes."plant.q"=1'],
    "start out of bounds": ["run", "pendulum", "--set", "components.plant.start.m=99"],
    "model without a function": ["run", "pendulum", "--set", "estimation.model=math:nothing"],
    "model that cannot be called": ["run", "pendulum", "--set", "estimation.model=math:sin"],
    "build under a file": ["build", "--out", "text.toml/fmus"],
    "illustration in the way": ["illustrate", "--out", "text.toml"],
}


@pytest.mark.fmu
@pytest.mark.parametrize("arguments", BAD.values(), ids=BAD)
def test_bad_input_gets_one_line_and_exit_code_2(tmp_path, arguments):
    (tmp_path / "text.toml").write_text("not = [a scenario")
    scenarios = Path(__file__).parents[2] / "cosim" / "scenarios"
    good = (scenarios / "pendulum.toml").read_text()
    (tmp_path / "reversed.toml").write_text(good.replace("lower = 0.1", "lower = 7.0", 1))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").write_text("mine")
    before = {path.name for path in tmp_path.iterdir()}
    done = retune(tmp_path, *arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    assert {path.name for path in tmp_path.iterdir()} <= before | {"runs"}
    assert not list(tmp_path.glob("runs/*"))
    assert (tmp_path / "full" / "precious").read_text() == "mine"
