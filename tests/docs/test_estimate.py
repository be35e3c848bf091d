"""docs/estimate.md shows what its commands print."""

import csv
import re
import runpy
import shlex
from pathlib import Path

import pytest

from cosim import System
from cosim.cli import main
from cosim.ssv.document import read_ssv

DOCUMENT = Path(__file__).parents[2] / "docs" / "estimate.md"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")
BLOCKS = re.findall(r"```\w*\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)

pytestmark = [pytest.mark.full, pytest.mark.fmu]


def run_as_told(command, shown, line_of_time, capsys):
    """Run it; the printed lines, which are those shown but for the time that it took."""
    capsys.readouterr()
    assert main(shlex.split(command.replace("\\\n", ""))[1:]) == 0
    printed, expected = capsys.readouterr().out.rstrip().splitlines(), shown.rstrip().splitlines()
    for lines in (printed, expected):
        lines[line_of_time] = re.sub(r", [\d.]+ s$", "", lines[line_of_time])
    for line, told in zip(printed, expected, strict=True):
        assert NUMBER.sub("#", line).split() == NUMBER.sub("#", told).split()
        numbers = [float(n) for n in NUMBER.findall(told)]
        assert [float(n) for n in NUMBER.findall(line)] == pytest.approx(numbers, rel=0.05, abs=1e-9)
    return printed, expected


def test_the_example_prints_what_the_document_shows(tmp_path, monkeypatch, capsys):
    program, commands, shown, afterwards = BLOCKS[:4]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "make_log.py").write_text(program)
    runpy.run_path("make_log.py")
    _, estimate = commands.replace("\\\n", "").splitlines()
    assert main(["build"]) == 0
    printed, expected = run_as_told(estimate, shown, 1, capsys)
    for name in ("m", "l", "b"):  # as closely as they are told
        mine, theirs = (
            next(NUMBER.search(r)[0] for r in rows if r.startswith(f"{name} ")) for rows in (printed, expected)
        )
        assert float(mine) == pytest.approx(float(theirs), rel=5e-5)
    run, export = afterwards.splitlines()
    found = {p.name: p.value for p in read_ssv(Path("runs/Pendulum-estimate-1/estimates.ssv")).values}
    assert main([*shlex.split(run)[1:], "--out", "next", "--set", "scenario.stop_time=0.1"]) == 0
    with open("next/series.csv", newline="") as file:
        first = next(csv.DictReader(file))
    assert all(float(first[f"controller.{name}"]) == found[name] for name in ("m", "l"))
    assert main(shlex.split(export)[1:]) == 0
    start = System.from_ssp(Path("pendulum.ssp")).start["controller"]
    assert {name: start[name] for name in found} == found


def test_the_log_taken_as_if_online_prints_what_the_document_shows(tmp_path, monkeypatch, capsys):
    changed, command, shown = BLOCKS[5:8]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "make_log.py").write_text(BLOCKS[0] + changed)
    runpy.run_path("make_log.py")
    assert main(["build"]) == 0
    run_as_told(command, shown, 1, capsys)
    end = {p.name: p.value for p in read_ssv(Path("runs/Pendulum-online-1/estimates.ssv")).values}
    assert end == pytest.approx({"m": 2.1, "l": 0.75}, rel=0.01)
