"""docs/your-own-fmu.md: its commands, carried out in its order in an empty folder, print what it shows."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from benchmarks.native_fmus import build_foreign
from cosim.cli import main

DOCUMENT = Path(__file__).parents[2] / "docs" / "your-own-fmu.md"
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?")
NEW_LINE = '"plant.mass.m" = '

pytestmark = [pytest.mark.fmu, pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")]


def steps():
    """What is in the blocks of the numbered sections: (command, lines shown) or (None, lines of a file)."""
    text = re.split(r"^## (?!\d)", DOCUMENT.read_text(encoding="utf-8"), flags=re.MULTILINE)[0]
    for block in re.findall(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        first, *rest = block.splitlines()
        yield (first[2:], rest) if first.startswith("$ ") else (None, [first, *rest])


def agree(printed, shown):
    """Whether the lines are the shown ones, of which `...` stands for any number; numbers to 2 %."""
    if not shown or shown[0] == "...":
        rest = shown[1:]
        return not rest or any(agree(printed[i:], rest) for i in range(len(printed)))
    if not printed or NUMBER.sub("#", printed[0]).split() != NUMBER.sub("#", shown[0]).split():
        return False
    numbers = [[float(n) for n in NUMBER.findall(line)] for line in (printed[0], shown[0])]
    return numbers[0] == pytest.approx(numbers[1], rel=0.02) and agree(printed[1:], shown[1:])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """As the document's first command leaves it."""
    build_foreign(tmp_path / "walk")
    monkeypatch.chdir(tmp_path / "walk")


@pytest.mark.full
def test_a_new_user_gets_to_a_re_tuned_controller(folder, capsys):
    n_commands = 0
    for command, lines in steps():
        if command is None and lines[0].startswith("time [s]"):
            Path("steps.csv").write_text("\n".join([*lines, ""]))
        elif command is None and lines[0].startswith("def derivative"):
            Path("plant_model.py").write_text("\n".join([*lines, ""]))
        elif command is None and lines[0].startswith(NEW_LINE):
            text, n = re.subn(f"^# {NEW_LINE}.*", lines[0], Path("axis.toml").read_text(), flags=re.MULTILINE)
            assert n == 1
            Path("axis.toml").write_text(text)
        elif command and command.startswith("retune "):
            assert main(shlex.split(command)[1:]) == 0
            printed = capsys.readouterr().out.rstrip().splitlines()
            assert agree(printed, lines), "\n".join(printed)
            n_commands += 1
    assert n_commands == 4  # info, new, check, run


def test_the_comparison_can_fail():
    assert agree(["a 1.00", "b", "c 2"], ["a 1.01", "...", "c 2"])
    assert not agree(["a 1.00", "c 2"], ["a 1.10", "c 2"])
    assert not agree(["a 1", "b", "c 2"], ["a 1", "c 2"])
