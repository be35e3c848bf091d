"""Medians against NumPy's."""

import numpy as np
import pytest

from cosim.sampling.medians import column_medians


@pytest.mark.parametrize("n", [1, 2, 5, 20, 31])
def test_they_are_numpys_to_the_bit(n):
    rows = np.random.default_rng(n).standard_normal((n, 6))
    np.testing.assert_array_equal(column_medians(rows), np.median(rows, axis=0))


def test_a_column_without_a_number_has_none():
    rows = np.array([[1.0, np.nan, 3.0], [2.0, 5.0, np.inf], [4.0, 6.0, -np.inf]])
    np.testing.assert_array_equal(column_medians(rows), [2.0, np.nan, 3.0])
