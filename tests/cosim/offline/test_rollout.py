"""Communication points and noise of a log's windows."""

import numpy as np
import pytest

from cosim.offline.log_windows import LogWindow
from cosim.offline.rollout import grid_of, noise_of


def window(time, inputs, measured):
    """A window of one input and one output that is fitted to as a whole."""
    columns = (np.asarray(column, dtype=float)[:, None] for column in (inputs, measured))
    return LogWindow("log.csv", time, float(time[0]), *columns, {}, np.empty((len(time), 0)), len(time))


@pytest.mark.parametrize(
    "stamps",
    [
        lambda t: t,
        lambda t: np.array([float(f"{s:.9g}") for s in t]),
        lambda t: t.astype(np.float32).astype(float),
        lambda t: np.round(t, 3),
        lambda t: 1.7e9 + t,
    ],
    ids=["exact", "nine-digits", "float32", "milliseconds", "since-1970"],
)
@pytest.mark.parametrize("n_parts", [1, 2])
def test_a_communication_point_at_a_row_has_its_input_however_the_time_stamps_are_rounded(stamps, n_parts):
    n = 600
    grid = grid_of(window(stamps(np.arange(n) / 60.0), np.arange(n), np.zeros(n)), 1.0 / 60.0 / n_parts, False)
    held = np.repeat(np.arange(n - 1), n_parts)
    assert [u for (u,) in grid.inputs[: len(held)]] == held.tolist()


@pytest.mark.parametrize(
    "is_missing",
    [
        lambda k: k < 0,
        lambda k: k % 10 == 0,
        lambda k: k % 5 == 0,
        lambda k: np.random.default_rng(1).random(len(k)) < 0.2,
        lambda k: k % 4 > 0,
    ],
    ids=["none", "every-tenth", "every-fifth", "a-fifth-at-random", "slower-raster"],
)
def test_noise_is_told_whatever_values_are_missing(is_missing):
    k = np.arange(4000)
    y = np.sin(0.12 * k / 4.0) + 3e-3 * np.random.default_rng(0).standard_normal(len(k))
    measured = np.where(is_missing(k), np.nan, y)
    assert noise_of([window(k / 100.0, k, measured)]) == pytest.approx([3e-3], rel=0.15)  # of 1000 differences: to 5 %
