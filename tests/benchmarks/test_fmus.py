"""The benchmark of a plant step runs, and its ways to the same slave give the same numbers. No time is looked at."""

import json

import pytest

from benchmarks import fmus, native_fmus, report

pytestmark = [pytest.mark.full, pytest.mark.fmu]


def test_every_way_has_a_row_and_they_agree(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    fmus.main(["--steps", "5", "--blocks", "2"])  # raises where the outputs differ
    rows = json.loads((tmp_path / "fmus.json").read_text())["rows"]
    assert {"slave called directly", "FMI, FMPy low level", "FMI, C importer"} <= {row["way"] for row in rows}
    assert all("skipped" in row or row["us a step"]["n"] == 2 for row in rows)


def test_without_gcc_the_c_importer_is_skipped_by_name(tmp_path, monkeypatch):
    monkeypatch.setattr(report, "RESULTS", tmp_path)
    monkeypatch.setattr(native_fmus.shutil, "which", lambda name: None)
    fmus.main(["--steps", "5", "--blocks", "1"])
    rows = json.loads((tmp_path / "fmus.json").read_text())["rows"]
    assert {"way": "FMI, C importer", "skipped": "gcc is not installed"} in rows
