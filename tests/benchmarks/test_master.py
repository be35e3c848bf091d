"""The masters' benchmark runs, and what it compares are the same numbers. No time is looked at."""

import json
import math
import shutil
from pathlib import Path

import pytest

from benchmarks import master, report

pytestmark = [
    pytest.mark.full,
    pytest.mark.fmu,
    pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed"),
]


@pytest.fixture(scope="module")
def systems(tmp_path_factory) -> dict[str, master.System]:
    return {s.name: s for s in master.systems(tmp_path_factory.mktemp("fmus"))}


def test_every_master_has_a_row_or_a_reason(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    master.main(["--systems", "oscillator, native", "--steps", "10", "--blocks", "2"])
    rows = json.loads((tmp_path / "master.json").read_text())["rows"]
    assert [row["master"] for row in rows] == list(master.MASTERS)
    assert all("skipped" in row or row["us a macro step"]["n"] == 2 for row in rows)
    assert "ours, isolated" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["native", "pythonfmu"])
def test_the_oscillator_follows_its_difference_equation(systems, kind):
    x, v = 1.0, 0.0
    for _ in range(20):
        a = -4.0 * x - 0.5 * v + 0.1
        v += 0.01 * a
        x += 0.01 * v
    with master.ours(systems[f"oscillator, {kind}"], "none") as steps:
        assert steps(0, 20) == (x, v, a)


def test_a_ring_of_equal_oscillators_is_one_that_drives_itself(systems):
    with master.ours(systems["3 oscillators, native"], "process") as steps:
        values = steps(0, 20)
    x, v = 1.0, 0.0
    for _ in range(20):
        v += 0.01 * (-4.0 * x - 0.5 * v + x)
        x += 0.01 * v
    assert values[0] == values[3] == values[6] == pytest.approx(x, rel=1e-14)


def test_a_master_that_computes_something_else_is_found_out(systems, monkeypatch):
    other = lambda system: master.ours(systems["oscillator, pythonfmu"], "none")  # noqa: E731
    monkeypatch.setitem(master.MASTERS, "ours, isolated", other)
    with pytest.raises(RuntimeError, match=r"pendulum: ours, isolated gave .*, FMPy's loop"):
        master.measure(systems["pendulum"], 5, 1)


def test_the_pendulum_loop_is_finite_and_moves(systems):
    with master.ours(systems["pendulum loop"], "process") as steps:
        first, later = list(steps(0, 1)), list(steps(1, 20))
    assert all(math.isfinite(x) for x in later)
    assert first != later


def test_fmus_are_built_where_they_are_asked_for(systems, tmp_path):
    assert master.build_native(tmp_path) == Path(tmp_path, "native", "Oscillator.fmu")
