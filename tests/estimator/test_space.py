"""Parameters, their bounds, and the map to the unit cube."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimator import Parameter, ParameterSpace

EPS = np.finfo(float).eps


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        pytest.param(("m", 5.0, 0.1, "kg"), r"'m' must have finite lower < upper, got \[5.0, 0.1\] kg", id="reversed"),
        pytest.param(("m", 1.0, 1.0, "kg"), r"lower < upper, got \[1.0, 1.0\] kg", id="empty"),
        pytest.param(("m", float("-inf"), 1.0), r"finite lower < upper, got \[-inf, 1.0\] 1", id="infinite-lower"),
        pytest.param(("m", 0.0, float("inf")), r"finite lower < upper, got \[0.0, inf\] 1", id="infinite-upper"),
        pytest.param(("m", float("nan"), 1.0), "finite lower < upper, got .nan", id="nan"),
        pytest.param(("m", 0.0, 5.0, "kg", "log"), "'m' must have lower > 0 on a log scale, got 0.0 kg", id="log-of-0"),
        pytest.param(("m", -1.0, 5.0, "kg", "log"), r"lower > 0 on a log scale, got -1.0 kg", id="log-of-negative"),
        pytest.param(("m", 0.1, 5.0, "kg", "cubic"), "must have scale 'linear' or 'log', got 'cubic'", id="scale"),
    ],
)  # fmt: skip
def test_a_parameter_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Parameter(*arguments)


def test_a_space_has_a_parameter():
    with pytest.raises(ValueError, match="must have at least one parameter"):
        ParameterSpace(())


def test_a_space_has_no_name_twice():
    m = Parameter("m", 0.1, 5.0)
    with pytest.raises(ValueError, match="names must differ, got 'm' twice"):
        ParameterSpace((m, Parameter("l", 0.1, 3.0), m))


def test_a_space_is_a_sequence_of_parameters_with_names():
    m, l = Parameter("m", 0.1, 5.0, "kg", "log"), Parameter("l", 0.1, 3.0, "m")
    space = ParameterSpace([m, l])
    assert space.names == ("m", "l")
    assert len(space) == 2
    assert list(space) == [m, l]
    assert space == ParameterSpace((m, l))
    assert hash(space) == hash(ParameterSpace((m, l)))


def test_values_go_by_name_and_back():
    space = ParameterSpace((Parameter("m", 0.1, 5.0), Parameter("l", 0.1, 3.0)))
    assert space.named(np.array([1.5, 0.25])) == {"m": 1.5, "l": 0.25}
    assert all(type(v) is float for v in space.named(np.array([1.5, 0.25])).values())
    np.testing.assert_array_equal(space.vector({"l": 0.25, "m": 1.5, "other": 9.0}), [1.5, 0.25])
    with pytest.raises(KeyError, match="l"):
        space.vector({"m": 1.5})


def test_the_middle_is_arithmetic_or_geometric():
    space = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.01, 100.0, "kg", "log")))
    np.testing.assert_allclose(space.from_unit([0.5, 0.5]), [1.0, 1.0], rtol=4 * EPS)
    np.testing.assert_allclose(space.to_unit([0.0, 10.0]), [0.25, 0.75], rtol=4 * EPS)


@st.composite
def parameters(draw, width=1e-6):
    """Parameters of either scale; as narrow as a millionth of the bounds."""
    if draw(st.booleans()):
        lower = 10.0 ** draw(st.floats(-9.0, 6.0))
        return Parameter("p", lower, lower * 10.0 ** draw(st.floats(np.log10(1.0 + width), 6.0)), "kg", "log")
    lower = draw(st.floats(-1e6, 1e6))
    return Parameter("p", lower, lower + max(abs(lower), 1e-6) * 10.0 ** draw(st.floats(np.log10(width), 6.0)))


def _rounding(p):
    """Rounding of a place: that of the bounds over the width, on the scale in use; five operations."""
    ends = np.array([p.lower, p.upper])
    scaled = np.log(ends) if p.scale == "log" else ends
    largest = np.abs(scaled).max() + (1.0 if p.scale == "log" else 0.0)
    return 5.0 * EPS * (1.0 + largest / (scaled[1] - scaled[0]))


@settings(deadline=None)
@given(parameters(), st.floats(0.0, 1.0))
def test_a_place_comes_back_through_its_value(p, z):
    space = ParameterSpace((p,))
    assert abs(space.to_unit(space.from_unit([z]))[0] - z) <= _rounding(p)


@settings(deadline=None)
@given(parameters(), st.floats(0.0, 1.0))
def test_a_value_comes_back_through_its_place(p, share):
    space = ParameterSpace((p,))
    theta = min(max(p.lower + share * (p.upper - p.lower), p.lower), p.upper)
    tolerance = _rounding(p) * float(space.slope([theta])[0])
    assert abs(space.from_unit(space.to_unit([theta]))[0] - theta) <= tolerance


@settings(deadline=None)
@given(parameters(), st.floats(-1e3, 1e3))
def test_a_value_is_never_outside_the_bounds(p, z):
    with np.errstate(over="ignore"):  # 1e3 widths outside the cube
        theta = ParameterSpace((p,)).from_unit([z])[0]
    assert p.lower <= theta <= p.upper


@settings(deadline=None)
@given(parameters(), st.floats(allow_nan=False, allow_infinity=False, width=32))
def test_a_place_is_never_outside_the_cube_but_for_rounding(p, theta):
    z = ParameterSpace((p,)).to_unit([theta])[0]
    assert -_rounding(p) <= z <= 1.0 + _rounding(p)


@settings(deadline=None)
@given(parameters())
def test_the_bounds_are_the_faces_of_the_cube(p):
    space = ParameterSpace((p,))
    np.testing.assert_array_equal(space.to_unit([[p.lower], [p.upper]]), [[0.0], [1.0]])
    np.testing.assert_allclose(space.from_unit([[0.0], [1.0]])[:, 0], [p.lower, p.upper],
                               rtol=40 * EPS, atol=EPS * max(abs(p.lower), abs(p.upper)))  # fmt: skip


@settings(deadline=None)
@given(parameters(width=1e-3), st.floats(0.01, 0.99))
def test_slope_is_the_derivative_of_the_value(p, z):
    """Differences with h = 1e-4: (14 h)^2/6 of truncation for six decades and 1e-16/(1e-3 h) of rounding."""
    space, h = ParameterSpace((p,)), 1e-4
    difference = (space.from_unit([z + h])[0] - space.from_unit([z - h])[0]) / (2.0 * h)
    np.testing.assert_allclose(space.slope(space.from_unit([z]))[0], difference, rtol=1e-6)


def test_maps_take_whole_tables_and_leave_them_alone():
    space = ParameterSpace((Parameter("a", -1.0, 3.0), Parameter("b", 0.01, 100.0, "kg", "log")))
    theta = np.array([[0.0, 1.0], [-5.0, 1e4], [3.0, 0.01]])
    before = theta.copy()
    z = space.to_unit(theta)
    np.testing.assert_array_equal(theta, before)
    np.testing.assert_allclose(z, [[0.25, 0.5], [0.0, 1.0], [1.0, 0.0]], atol=4 * EPS)
    np.testing.assert_allclose(space.from_unit(z), [[0.0, 1.0], [-1.0, 100.0], [3.0, 0.01]], atol=1e-13)


def test_bounds_that_are_whole_numbers_are_as_exact_as_others():
    """On a log scale: the logarithms of an array of integers are not integers."""
    whole, floating = (ParameterSpace((Parameter("C", kind(200), kind(20000), "J/K", "log"),)) for kind in (int, float))
    assert whole.from_unit([0.5]) == pytest.approx([2000.0])
    assert whole.to_unit([700.0]) == floating.to_unit([700.0])
