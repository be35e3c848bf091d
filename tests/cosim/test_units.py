"""Conversion of units against values of everyday."""

import math

import pytest

from cosim.units import IDENTITY, Linear, Unit, conversion, make_unit

RAD = make_unit("rad", {"rad": "1"})
DEG = make_unit("deg", {"rad": "1", "factor": repr(math.pi / 180)})
KELVIN = make_unit("K", {"K": "1"})
CELSIUS = make_unit("degC", {"K": "1", "offset": "273.15"})
FAHRENHEIT = make_unit("degF", {"K": "1", "factor": repr(5 / 9), "offset": repr(273.15 - 32 * 5 / 9)})


@pytest.mark.parametrize(
    ("source", "target", "number", "converted"),
    [
        (DEG, RAD, 180.0, math.pi), (RAD, DEG, math.pi / 2, 90.0), (CELSIUS, KELVIN, 25.0, 298.15),
        (CELSIUS, FAHRENHEIT, 100.0, 212.0), (FAHRENHEIT, CELSIUS, -40.0, -40.0),
        (make_unit("g", {"kg": 1, "factor": 1e-3}), make_unit("kg", {"kg": 1}), 2500.0, 2.5),
    ],
    ids=lambda x: getattr(x, "name", None),
)  # fmt: skip
def test_numbers_are_converted(source, target, number, converted):
    assert conversion(source, target)(number) == pytest.approx(converted, rel=1e-14)


def test_equal_units_leave_every_bit():
    assert conversion(RAD, make_unit("radian", {"rad": 1})) is IDENTITY
    assert conversion(None, RAD) is IDENTITY
    assert conversion(Unit("Nm"), Unit("Nm")) is IDENTITY


def test_the_radian_is_no_dimension():
    assert conversion(make_unit("rad/s", {"rad": 1, "s": -1}), make_unit("1/s", {"s": -1})) == IDENTITY


def test_other_dimensions_are_refused():
    with pytest.raises(ValueError, match="'K' cannot be converted to 'rad': the dimensions differ"):
        conversion(KELVIN, RAD)
    with pytest.raises(ValueError, match="'Nm' is not defined"):
        conversion(Unit("Nm"), RAD)
    with pytest.raises(ValueError, match="unit 'x' has the factor 0"):
        make_unit("x", {"kg": 1, "factor": "0"})


def test_functions_follow_one_another():
    first, second = Linear(2.0, 1.0), Linear(10.0, -3.0)
    assert first.then(second)(5.0) == 10.0 * (2.0 * 5.0 + 1.0) - 3.0
