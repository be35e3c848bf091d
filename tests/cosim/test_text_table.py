"""Counts as an English speaker says them."""

import pytest

from cosim.text_table import counted


@pytest.mark.parametrize(("n", "text"), [(0, "0 episodes"), (1, "1 episode"), (2, "2 episodes")])
def test_a_noun_is_singular_with_one_only(n, text):
    assert counted(n, "episode") == text
