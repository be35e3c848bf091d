"""The comparison with other people's optimisers, here with stand-ins for them: none need be installed."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Its child processes import this too, and so have the same stand-ins.
PROGRAM = """
import os
import sys
from pathlib import Path

from benchmarks import report
from benchmarks.estimator_peers import PEERS, Peer
from benchmarks.estimators import main


def breaks(objective, n_evaluations, seed):
    raise ValueError("no such\\n  kernel")


def ends(objective, n_evaluations, seed):
    os._exit(7)


def guesses(objective, n_evaluations, seed):
    for k in range(n_evaluations):
        objective.norm([(k + 0.5) / n_evaluations] * len(objective))


PEERS["emukit"] = Peer("emukit", "no_such_module", breaks)
PEERS["gpyopt"] = Peer("numpy", "numpy", breaks)
PEERS["botorch"] = Peer("numpy", "numpy", ends)
PEERS["optuna-gp"] = Peer("numpy", "numpy", guesses)
report.RESULTS = Path(sys.argv[1])
if __name__ == "__main__":
    main(sys.argv[2:])
"""
PENDULUM = ["--problems", "pendulum", "--evaluations", "20", "--repetitions", "1", "--only"]


@pytest.fixture
def measure(tmp_path):
    """measure(*names) gives what is printed, and the rows of the file by method."""
    (tmp_path / "program.py").write_text(PROGRAM, encoding="utf-8")

    def refuse(constant):
        raise ValueError(f"{constant} is not JSON")

    def program(*names):
        done = subprocess.run(
            [sys.executable, tmp_path / "program.py", tmp_path, *PENDULUM, *names],
            cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True, encoding="utf-8",
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found = json.loads((tmp_path / "estimators.json").read_text(encoding="utf-8"), parse_constant=refuse)
        return done.stdout, {row["method"]: row for row in found["rows"]}

    return program


@pytest.mark.full
@pytest.mark.fmu
def test_ours_and_peers_are_measured_and_those_that_are_absent_or_fail_are_named(measure):
    printed, rows = measure("target", "emukit", "gpyopt", "botorch", "optuna-gp")
    for name in ("target", "optuna-gp"):
        assert (rows[name]["evaluations"], rows[name]["repetitions"], rows[name]["failure"]) == (20, 1, "")
        for column in ("time [ms]", "m error [kg]", "l error [m]"):
            assert math.isfinite(rows[name][column]["median"])
        assert rows[name]["J error [kg.m2]"] is None
    assert rows["target"]["over target"] == 1.0
    assert rows["target"]["m error [kg]"]["median"] < 0.05 * 4.271  # twenty evaluations suffice here
    # The diagonal's best place is known: log m and log l at the same share of their bounds. Six digits are kept.
    shares = [(k + 0.5) / 20 for k in range(20)]
    masses = [0.1 * 50.0**share for share in shares]
    assert min(abs(abs(m - 4.271) - rows["optuna-gp"]["m error [kg]"]["median"]) for m in masses) < 1e-5
    for name, reason in {
        "emukit": "absent: pip install '.[peers]'",
        "gpyopt": "ValueError: no such kernel",
        "botorch": "its process ended with exit code 7",
    }.items():
        assert (rows[name]["repetitions"], rows[name]["failure"]) == (0, reason)
        assert any(name in line and reason in line for line in printed.splitlines())


@pytest.mark.full
@pytest.mark.fmu
def test_a_later_measurement_of_some_keeps_the_rows_of_the_others(measure):
    _, before = measure("optuna-gp")
    printed, rows = measure("bo-scalar", "emukit")
    assert list(rows) == ["bo-scalar", "emukit", "optuna-gp"]
    assert rows["optuna-gp"] == before["optuna-gp"]
    assert "optuna-gp" in printed


@pytest.mark.full_but("arguments0")
@pytest.mark.parametrize("arguments", [["--only", "emukti"], ["--repetitions", "0"], ["--evaluations", "5"]])
def test_what_cannot_be_measured_is_refused(arguments):
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.estimators", *arguments], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
