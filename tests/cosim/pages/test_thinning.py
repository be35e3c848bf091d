"""Thinning of long series: no peak is lost, and little is left."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cosim.pages.thinning import kept_rows


@given(st.integers(1, 30_000), st.integers(0, 10**9), st.sampled_from([1.0, -1.0]))
def test_no_peak_is_lost_wherever_it_is(m, place, sign):
    values = np.zeros(m)
    values[place % m] = sign
    rows = kept_rows(values)
    assert place % m in rows
    assert {0, m - 1} <= {*rows.tolist()}
    assert len(rows) <= 4100
    assert np.all(np.diff(rows) > 0)


def test_a_short_series_is_whole():
    assert kept_rows(np.zeros(4000)).tolist() == list(range(4000))


def test_a_million_rows_keep_the_peaks_of_all_series_beside_missing_and_infinite_values():
    a, b = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 1_000_000))
    a[123_456], b[654_321], a[777_777:800_000], b[5] = 7.0, -7.0, np.nan, np.inf
    rows = kept_rows(a, b)
    assert {123_456, 654_321, 5} <= {*rows.tolist()}
    assert len(rows) <= 4100


@pytest.mark.parametrize("values", [np.full(9000, np.nan), np.full(9000, -np.inf)], ids=["nan", "infinite"])
def test_a_series_of_nothing_is_thinned_too(values):
    assert 2 <= len(kept_rows(values)) <= 4100
