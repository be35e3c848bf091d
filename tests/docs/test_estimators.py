"""docs/estimators.md: the estimator of one's own that it shows works."""

import json
import re
from pathlib import Path

import pytest

from cosim.cli import main

DOCUMENT = Path(__file__).parents[2] / "docs" / "estimators.md"

pytestmark = pytest.mark.fmu


@pytest.mark.full
def test_the_estimator_of_ones_own_works(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(import numpy.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    Path("shown_estimator.py").write_text(example)
    settings = ["scenario.stop_time=1.0", 'changes."plant.m"=[[0.0, 1.75], [0.05, 4.271]]']
    command = ["run", "pendulum", "--only", "--json", "--estimator", "shown_estimator:Evolution", "--out", "out"]
    assert main([*command, *(part for setting in settings for part in ("--set", setting))]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["evaluations"] > 100
    (m, *_) = result["parameters"]
    assert abs(m["estimated"] - m["true"]) < 0.2 * m["true"]
