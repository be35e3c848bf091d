"""Differences against derivatives in closed form."""

import numpy as np
import pytest

from estimator.differences import OfMany, central_differences, forward_differences


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


def test_slopes_to_the_cubes_middle_of_a_linear_function_are_its_matrix():
    A = np.array([[2.0, -1.0, 0.5], [0.0, 3.0, 4.0]])
    z, places = np.array([0.1, 0.5, 0.9]), []

    def linear(z):
        places.append(z)
        return A @ z

    found = forward_differences(linear, z, A @ z, 0.25)
    np.testing.assert_allclose(found, A, rtol=1e-12)
    np.testing.assert_array_equal(places, [[0.35, 0.5, 0.9], [0.1, 0.25, 0.9], [0.1, 0.5, 0.65]])


def test_a_function_of_many_places_is_called_once_and_gives_the_same_slopes():
    shapes = []

    def bent(z):
        shapes.append(z.shape)
        return np.stack([z[..., 0] ** 2 * z[..., 1], np.sin(z[..., 1])], axis=-1)

    z, steps = np.array([0.4, 0.7]), np.array([0.1, 0.2])
    one_by_one = central_differences(bent, z, steps), forward_differences(bent, z, bent(z), 1e-3)
    shapes.clear()
    at_once = central_differences(OfMany(bent), z, steps), forward_differences(OfMany(bent), z, bent(z), 1e-3)
    assert shapes == [(2, 2, 2), (2,), (2, 2)]
    np.testing.assert_allclose(at_once[0], one_by_one[0], rtol=1e-12)
    np.testing.assert_allclose(at_once[1], one_by_one[1], rtol=1e-9)
