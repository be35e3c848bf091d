"""The measurement of growth and endurance, on problems so small that nothing of it can be asserted of time."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def results(program, tmp_path, name):
    """What the program, with all of benchmarks.scaling at hand, has written as NAME.json."""
    head = "from pathlib import Path\nfrom benchmarks import report, scaling\n"
    place = f"report.RESULTS = Path({str(tmp_path)!r})\n"
    command = [sys.executable, "-c", head + place + program]
    subprocess.run(command, cwd=ROOT, env=os.environ, check=True, capture_output=True, text=True, timeout=120)
    return json.loads((tmp_path / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.full
def test_growth_finds_the_known_parameters_and_fits_an_exponent_to_each_size(tmp_path):
    sizes = {"observations": (20, 30), "dimensions": (2, 3), "window": (1, 4)}
    written = results(f"scaling.growth(['target', 'paper'], 1, {sizes})", tmp_path, "scaling")
    assert [(r["estimator"], r[r["varied"]]) for r in written["rows"]] == [
        (name, value) for name in ("target", "paper") for values in sizes.values() for value in values
    ]
    assert all(r["ms"]["n"] > 0 and r["memory [KiB]"] > 0 for r in written["rows"])
    # noise of 1e-3 on 6 channels and more: its share in theta is a few thousandths
    assert all(r["error"]["median"] < 0.02 for r in written["rows"] if r["estimator"] == "target")
    assert written["notes"].count(" at the end") == 6


def test_the_exponent_is_the_slope_of_log_cost_over_log_size(tmp_path):
    program = """
costs = [{"ms": {"median": 3.0 * n**1.5}} for n in (10, 40, 90)]
text = scaling._exponents("n", (10, 40, 90), costs)
report.write("exponent", [{"text": text}])
"""
    (row,) = results(program, tmp_path, "exponent")["rows"]
    assert row["text"] == "n 1.50, 1.50 at the end"


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.parametrize(
    ("limit", "steps"), [("float('inf')", [15, 30, 45, 60]), ("0.0", [15])], ids=["whole", "limited"]
)
def test_endurance_looks_at_the_memory_of_all_processes_after_each_block(tmp_path, limit, steps):
    written = results(f"scaling.endurance(60, {limit})", tmp_path, "endurance")
    assert [r["steps"] for r in written["rows"]] == steps
    assert all(r["this process [MiB]"] > 10.0 and r["the FMUs' [MiB]"] > 30.0 for r in written["rows"])
    assert ("stopped early" in written["notes"]) == (limit == "0.0")
