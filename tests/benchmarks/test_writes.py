"""The count of writes that make a parameter worse, of a run by hand."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from benchmarks.writes import errors, summary

TRUTH = np.where(np.arange(16) < 8, 2.0, 4.0)
"""A parameter [kg] that jumps at the ninth communication point."""
HELD = np.array([1.0, 1.5, 2.2, 2.2, 2.2, 2.1, 2.3, 2.3, 2.3, 3.0, 5.0, 3.5, 3.9, 3.9, 4.9, 4.9])


def test_moves_after_the_third_sample_are_counted_and_those_that_are_worse():
    constant = np.full(16, 1.0)
    moves = errors(
        SimpleNamespace(true_parameters={"m": TRUTH, "c": constant}, estimates={"m": HELD, "c": constant})  # type: ignore[arg-type]
    )
    assert_allclose(moves, [[0.1, 0.05], [0.05, 0.15], [0.125, 0.025], [0.025, 0.225]], rtol=1e-9)
    assert summary([moves]) == {
        "seeds": 1,
        "moves": 4,
        "worse by a fifth": 2,
        "by 0.001 of the truth": 2,
        "by 0.01": 2,
        "by 0.2": 1,
        "largest": moves[3, 1] - moves[3, 0],
    }
