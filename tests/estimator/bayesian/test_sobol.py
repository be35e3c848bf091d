"""Sobol points: SciPy's, bit for bit, though scipy.stats is not loaded."""

import numpy as np
import pytest
import scipy

from estimator.bayesian.sobol import sobol_points


@pytest.mark.parametrize("d", [1, 2, 4, 7, 16, 17])
@pytest.mark.parametrize("n", [1, 2, 128, 256, 512])
def test_points_and_the_use_of_random_numbers_are_scipys(n, d):
    ours, theirs = np.random.default_rng(d), np.random.default_rng(d)
    for _ in range(2):  # the second time with the next child of the generator's seed
        np.testing.assert_array_equal(sobol_points(n, d, ours), scipy.stats.qmc.Sobol(d, rng=theirs).random(n))
    assert ours.random() == theirs.random()
