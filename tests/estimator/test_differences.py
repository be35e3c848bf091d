"""Central differences against derivatives in closed form."""

import numpy as np
import pytest

from estimator.differences import central_differences


def quadratic(z):
    return [z[0] ** 2 * z[1], 3.0 * z[1]]


def test_slopes_of_a_quadratic_are_exact_but_for_rounding():
    """A central difference has no error of second order: the slope of z^2 is exact for any step."""
    z = np.array([0.4, 0.5])
    found = central_differences(quadratic, z, np.array([0.1, 0.2]))
    np.testing.assert_allclose(found, [[2 * 0.4 * 0.5, 0.16], [0.0, 3.0]], rtol=1e-13)


@pytest.mark.parametrize(("z0", "slope"), [(0.0, 0.1), (1.0, 1.9)], ids=["lower", "upper"])
def test_at_a_bound_the_difference_is_one_sided(z0, slope):
    """(0.1^2 - 0)/0.1 and (1 - 0.9^2)/0.1; no place beyond the bound is evaluated."""
    places = []

    def square(z):
        places.append(z[0])
        return [z[0] ** 2]

    found = central_differences(square, np.array([z0]), np.array([0.1]), 0.0, 1.0)
    np.testing.assert_allclose(found, [[slope]], rtol=1e-12)
    assert min(places) >= 0.0
    assert max(places) <= 1.0


def test_a_place_without_a_value_leaves_no_slope():
    found = central_differences(lambda z: [np.nan if z[0] > 0.5 else z[0], z[0]], np.array([0.5]), np.array([0.1]))
    assert np.isnan(found[0, 0])
    assert found[1, 0] == pytest.approx(1.0)
