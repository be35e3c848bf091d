"""The tables of the benchmarks have the figures that were kept."""

from pathlib import Path

from benchmarks import guard, readme
from benchmarks.report import RESULTS, replaced, stored

ROOT = Path(__file__).parents[2]


def test_the_tables_of_the_guard_have_the_figures_kept():
    text = (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    assert text == replaced(text, "guard", guard.markdown(stored(RESULTS, "guard")))


def test_the_tables_of_the_readme_have_the_figures_kept():
    text = readme.README.read_text(encoding="utf-8")
    assert text == readme.written(text)
