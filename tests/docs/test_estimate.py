"""docs/estimate.md shows what its commands print."""

import csv
import re
import runpy
import shlex
from pathlib import Path

import pytest

from cosim import System
from cosim.cli import main
from cosim.ssp.ssv import read_ssv

DOCUMENT = Path(__file__).parents[2] / "docs" / "estimate.md"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")

pytestmark = pytest.mark.fmu


def test_the_example_prints_what_the_document_shows(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```\w*\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    program, commands, shown, afterwards = blocks[:4]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "make_log.py").write_text(program)
    runpy.run_path("make_log.py")
    _, estimate = commands.replace("\\\n", "").splitlines()
    assert main(["build"]) == 0
    capsys.readouterr()
    assert main(shlex.split(estimate)[1:]) == 0
    printed, expected = capsys.readouterr().out.rstrip().splitlines(), shown.rstrip().splitlines()
    del printed[1], expected[1]  # the time it took
    for line, told in zip(printed, expected, strict=True):
        assert NUMBER.sub("#", line).split() == NUMBER.sub("#", told).split()
        numbers = [float(n) for n in NUMBER.findall(told)]
        assert [float(n) for n in NUMBER.findall(line)] == pytest.approx(numbers, rel=0.05, abs=1e-9)
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
