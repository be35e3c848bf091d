"""The comparison of two versions, bit for bit."""

import json
import sys

import pytest

from benchmarks import bits


@pytest.mark.parametrize(
    ("seed_1", "code", "last"),
    [
        ({"pendulum 1": "b"}, 0, "2 of 2 runs are the same bits"),
        ({"pendulum 1": "x"}, 1, "pendulum 1 differs"),
        ({}, 1, "pendulum 1 was not run before"),
    ],
    ids=["same", "other", "absent"],
)
def test_runs_that_differ_or_are_absent_are_named(tmp_path, monkeypatch, capsys, seed_1, code, last):
    before = tmp_path / "before.json"
    before.write_text(json.dumps({"pendulum 0": "a"} | seed_1), encoding="utf-8")
    monkeypatch.setattr(bits, "all_digests", lambda n_seeds, jobs: {"pendulum 0": "a", "pendulum 1": "b"})
    monkeypatch.setattr(sys, "argv", ["bits", str(before)])
    assert bits.main() == code
    assert capsys.readouterr().out.splitlines()[-1] == last
