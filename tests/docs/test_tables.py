"""The tables of docs/scenario.md and docs/estimators.md are those of the schema, and the README stays short."""

import re
import tomllib
from pathlib import Path

import pytest

from cosim.scenarios.reference import rendered, scenario_tables
from cosim.scenarios.scenario import Scenario
from cosim.scenarios.schema.guard import GuardSettings

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["scenario.md", "estimators.md"])
def test_the_committed_page_is_fresh(name):
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert "<!-- tables: " in page
    assert rendered(page) == page, "run `make docs-tables`"


def test_a_key_stands_with_its_range_its_default_and_its_docstring():
    text = GuardSettings.model_fields["rate"].default
    row = next(line for line in scenario_tables().splitlines() if line.startswith("| `rate` |"))
    assert row.startswith(f"| `rate` | number > 0, ≤ 1 | `{text}` | Largest change of a parameter")


def test_a_page_is_left_as_it_is_but_for_its_tables():
    page = "before\n<!-- tables: scenario -->\nold\n<!-- end of tables -->\nafter\n"
    new = rendered(page)
    assert new.startswith("before\n<!-- tables: scenario -->\n\n### The file")
    assert new.endswith("\n\n<!-- end of tables -->\nafter\n")
    assert "\nold\n" not in new


def test_the_example_on_the_page_is_a_scenario():
    page = (ROOT / "docs" / "scenario.md").read_text(encoding="utf-8")
    example, *_ = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    scenario = Scenario.from_tables(tomllib.loads(example), None, ROOT, Path("example.toml"))
    assert (scenario.plant, scenario.estimation.space.names) == ("plant", ("m",))


def test_the_readme_is_short_and_its_links_work_on_the_package_page():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.encode()) <= 6000
    prefix = "https://github.com/fmu-retune/fmu-retune/blob/main/"
    links = [part.split(")")[0].replace("\n", "") for part in readme.split("](")[1:]]
    assert all(link.startswith("https://") for link in links)
    assert [link for link in links if link.startswith(prefix) and not (ROOT / link.removeprefix(prefix)).exists()] == []
