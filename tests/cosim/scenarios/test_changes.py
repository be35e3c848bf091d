"""Values, formulas and rows over time, against integers and plain functions."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cosim.scenarios.changes import change_functions


def change(rows, definitions=None):
    return change_functions(definitions or {}, {"plant.m": rows})["plant.m"]


def test_a_number_is_a_constant():
    m = change(1.75)
    assert [m(t) for t in (-1.0, 0.0, 9.0)] == [1.75] * 3


def test_a_text_is_a_formula():
    assert change("2*t + 1")(3.0) == 7.0


def test_a_row_holds_from_its_time_on():
    m = change(((0.0, 1.75), (3.0, 4.271)))
    assert [m(t) for t in (0.0, 2.999, 3.0, 3.001, 100.0)] == [1.75, 1.75, 4.271, 4.271, 4.271]


def test_before_the_first_row_its_value_holds_too():
    assert change(((1.0, 5.0), (2.0, 6.0)))(0.0) == 5.0


def test_a_row_may_be_a_formula_in_t():
    m = change(((0.0, "t"), (2.0, "10*t")))
    assert [m(t) for t in (1.0, 2.0, 3.0)] == [1.0, 20.0, 30.0]


@settings(max_examples=200, deadline=None)
@example(3, 0.3)  # 3 * 0.3 is an ulp below 0.9
@given(st.integers(1, 100_000), st.sampled_from([0.01, 0.001, 0.015, 0.03, 0.3]))
def test_a_row_begins_at_its_communication_point_however_the_product_is_rounded(k, step):
    since = float(f"{k * step:.3f}")  # as a file says it; k * step may be an ulp below
    m = change(((-1.0, 0.0), (since, 1.0)))
    assert [m((k - 1) * step), m(k * step), m((k + 1) * step)] == [0.0, 1.0, 1.0]


@pytest.mark.parametrize(
    "rows", [((0.0, 1.0), (0.0, 2.0)), ((3.0, 1.0), (1.0, 2.0))], ids=["equal times", "falling times"]
)
def test_the_times_of_rows_must_rise(rows):
    with pytest.raises(ValueError, match=r"plant\.m: the times of a change must rise"):
        change(rows)


def test_a_change_without_rows_is_refused():
    with pytest.raises(ValueError, match=r"plant\.m: has no rows"):
        change(())


def test_a_definition_may_use_those_before_it():
    definitions = {"a": "t + 1", "b": "a*a", "c": "b - a"}
    m = change("c + 100*a", definitions)
    assert [m(t) for t in (0.0, 1.0, 2.0)] == [100.0, 202.0, 306.0]


def test_a_definition_may_not_use_those_after_it():
    with pytest.raises(ValueError, match="'b'"):
        change_functions({"a": "b + 1", "b": 1.0}, {})


def test_a_definition_may_be_a_number():
    assert change("2*m0", {"m0": 1.25})(0.0) == 2.5


@pytest.mark.parametrize("name", ["t", "sin", "pi", "not a name", "if"])
def test_a_definition_needs_a_name_of_its_own(name):
    with pytest.raises(ValueError, match=name):
        change_functions({name: 3.0}, {})


def test_a_formula_that_is_none_is_refused_with_the_name_of_what_it_was_to_change():
    with pytest.raises(ValueError, match=r"plant\.m.*sinn"):
        change("sinn(t)")
    with pytest.raises(ValueError, match=r"plant\.m.*sinn"):
        change(((0.0, 1.0), (1.0, "sinn(t)")))
    with pytest.raises(ValueError, match=r"bad.*sinn"):
        change_functions({"bad": "sinn(t)"}, {})


def test_definitions_that_name_those_before_them_twice_take_no_longer():
    """Each is evaluated once for a time; 2^99 evaluations would take for ever."""
    definitions = {"d0": "t"} | {f"d{i}": f"d{i - 1} + d{i - 2}" if i > 1 else "d0 + 1" for i in range(1, 100)}
    m = change("d99", definitions)
    ones, twos = 0.0, 1.0
    for _ in range(99):
        ones, twos = twos, ones + twos
    assert [m(t) for t in (0.0, 0.0)] == [ones, ones]
    assert m(1.0) != ones
    assert m(0.0) == ones


def test_there_are_not_more_definitions_than_calls_can_be_nested():
    definitions = {"d0": "t"} | {f"d{i}": f"d{i - 1}" for i in range(1, 101)}
    with pytest.raises(ValueError, match=r"^definitions: there are 101; at most 100 can build on each other$"):
        change("d100", definitions)
