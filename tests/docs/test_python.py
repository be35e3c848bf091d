"""docs/python.md: its programs run, in its order, in one session in an empty folder."""

import re
from pathlib import Path

import pytest

import cosim
from cosim.system.fmu_cache import build_into

DOCUMENT = (Path(__file__).parents[2] / "docs" / "python.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.fmu


@pytest.mark.full
def test_its_programs_run_and_find_what_they_claim(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    build_into(tmp_path / "fmus", is_forced=False)
    names = {}
    for program in re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL):
        exec(program, names)
    assert names["found"].estimates == pytest.approx({"m": 1.75, "l": 0.75}, rel=1e-3)
    assert names["estimator"].estimate().theta == pytest.approx([4.16, 0.8], rel=2e-3)


def test_it_names_everything_that_is_public():
    table = "\n".join(line for line in DOCUMENT.splitlines() if line.startswith("|"))
    assert [name for name in dir(cosim) if not name.startswith("_") and f"`{name}" not in table] == []
