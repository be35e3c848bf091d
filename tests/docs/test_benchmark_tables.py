"""The tables of the guard and of the intervals have the figures that their benchmarks have kept."""

import re
from pathlib import Path

import pytest

from benchmarks import guard
from benchmarks.report import RESULTS, stored

ROOT = Path(__file__).parents[2]


def cells_of(document, begins):
    """Cells of each row of the Markdown table whose header begins so."""
    lines = (ROOT / document).read_text(encoding="utf-8").splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(begins)) + 2
    last = next(i for i, line in enumerate(lines[first:], first) if not line.startswith("|"))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[first:last]]


def test_the_tables_of_the_guard_have_the_figures_kept():
    text = (ROOT / "docs/safety.md").read_text(encoding="utf-8")
    shown = text.partition("<!-- guard -->")[2].partition("<!-- end -->")[0].strip()
    assert shown == guard.markdown(stored(RESULTS, "guard"))


def test_the_table_of_the_intervals_has_the_figures_kept():
    kept = {
        (r["estimator"], r["how"].replace("end of episode", "episodes"), r["scenario"]): r
        for r in stored(RESULTS, "coverage")
    }
    table = cells_of("benchmarks/README.md", "| estimator | how |")
    assert {tuple(cells[:3]) for cells in table} == kept.keys()
    for cells in table:
        row = kept[tuple(cells[:3])]
        counts = [row[key] for key in ("seeds", "intervals", "not identifiable")]
        assert [int(cell.replace(",", "")) for cell in cells[3:6]] == counts
        assert (cells[6], cells[8]) == (row["covered"], row["least"])
        assert float(cells[7]) == pytest.approx(row["rms"], rel=0.05)  # two digits
        assert re.fullmatch(cells[9] or ".*", row["nothing held"])
