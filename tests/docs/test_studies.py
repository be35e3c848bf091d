"""The studies that docs/studies.md shows: all their runs can be planned."""

import re
import tomllib
from pathlib import Path

import pytest

from cosim.scenarios.scenario import Scenario
from cosim.studies.definition import checked_definition
from cosim.studies.plan import Study

TEXT = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
SHOWN = [tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)]
COUNTS = (768, 945, 141)


@pytest.mark.full
@pytest.mark.parametrize(("tables", "n"), list(zip(SHOWN, COUNTS, strict=True)), ids=["payloads", "faults", "cases"])
def test_a_study_that_is_shown_can_be_planned(tables, n):
    definition = checked_definition(tables, "docs/studies.md")
    sources = tuple(map(Scenario.load, definition.study.scenarios))
    assert len({run.key for run in Study(definition, sources, definition.study.scenarios).runs()}) == n
    assert len(SHOWN) == 3
