"""The measurement of growth and endurance, on problems so small that nothing of it can be asserted of time."""

import math
from pathlib import Path

import pytest

from benchmarks import report, scaling


@pytest.fixture(autouse=True)
def results(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    return tmp_path


@pytest.mark.full
def test_growth_finds_the_known_parameters_and_fits_an_exponent_to_each_size(results, capsys):
    sizes = {"observations": (20, 30), "dimensions": (2, 3), "window": (1, 4)}
    scaling.growth(["target", "bo-scalar"], 1, sizes)
    rows = report.stored(results, "scaling")
    assert [(r["estimator"], r[r["varied"]]) for r in rows] == [
        (name, value) for name in ("target", "bo-scalar") for values in sizes.values() for value in values
    ]
    assert all(r["ms"]["n"] > 0 and r["memory [KiB]"] > 0 for r in rows)
    # noise of 1e-3 on 6 channels and more: its share in theta is a few thousandths
    assert all(r["error"]["median"] < 0.02 for r in rows if r["estimator"] == "target")
    assert capsys.readouterr().out.count(" at the end") == 6


def test_the_exponent_is_the_slope_of_log_cost_over_log_size():
    sizes = (10, 40, 90)
    costs = [{"ms": {"median": 3.0 * n**1.5}} for n in sizes]
    assert scaling.exponents("n", sizes, costs) == "n 1.50, 1.50 at the end"


@pytest.mark.full
@pytest.mark.fmu
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="reads /proc")
@pytest.mark.parametrize(("limit", "steps"), [(math.inf, [15, 30, 45, 60]), (0.0, [15])], ids=["whole", "limited"])
def test_endurance_looks_at_the_memory_of_all_processes_after_each_block(results, limit, steps, capsys):
    scaling.endurance(60, limit)
    rows = report.stored(results, "endurance")
    assert [r["steps"] for r in rows] == steps
    assert all(r["this process [MiB]"] > 10.0 and r["the FMUs' [MiB]"] > 30.0 for r in rows)
    assert ("stopped early" in capsys.readouterr().out) == (limit == 0.0)
