"""Formulas against Python's own arithmetic, and everything that is not a formula."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cosim.scenarios.formula import FUNCTIONS, compile_formula

TIMES = (0.0, 0.3, 1.0, 2.5, 7.0)

VALUES = [
    ("2", lambda t: 2.0),
    ("-t + 3*t**2", lambda t: -t + 3.0 * t**2.0),
    ("7 % 3 + t/4", lambda t: 1.0 + t / 4.0),
    ("0.2*exp(-0.2*t)*sin(1.5*t)", lambda t: 0.2 * math.exp(-0.2 * t) * math.sin(1.5 * t)),
    ("1 if t <= 1 else 2 if t < 5 else 3", lambda t: 1.0 if t <= 1 else 2.0 if t < 5 else 3.0),
    ("cos(t) - tan(t/9) + atan2(t, 2)", lambda t: math.cos(t) - math.tan(t / 9) + math.atan2(t, 2)),
    ("asin(t/7) + acos(t/7) + atan(t)", lambda t: math.asin(t / 7) + math.acos(t / 7) + math.atan(t)),
    ("log(1 + t) + sqrt(t) + tanh(t)", lambda t: math.log(1 + t) + math.sqrt(t) + math.tanh(t)),
    ("floor(t) + ceil(t)", lambda t: float(math.floor(t) + math.ceil(t))),
    ("abs(1 - t) + min(t, 1) + max(t, 2, 3)", lambda t: abs(1 - t) + min(t, 1) + max(t, 2, 3)),
    ("pi + e", lambda t: math.pi + math.e),
    ("1 < t < 5", lambda t: float(1 < t < 5)),
    ("t == 1 or not t >= 1 and t != 0", lambda t: float(t == 1 or (not t >= 1 and t != 0))),
]


@pytest.mark.parametrize(("text", "expected"), VALUES, ids=[text for text, _ in VALUES])
def test_a_formula_has_the_value_that_python_gives_it(text, expected):
    formula = compile_formula(text, {})
    assert [formula(t) for t in TIMES] == [expected(t) for t in TIMES]


def test_a_formula_may_go_over_several_lines():
    assert compile_formula("\n(t\n  +\n 1)\n", {})(2.0) == 3.0


def test_a_value_is_always_a_float():
    assert type(compile_formula("1 < t", {})(2.0)) is float
    assert type(compile_formula("7", {})(2.0)) is float


def test_a_formula_may_name_the_definitions_it_is_given():
    formula = compile_formula("2*a + b", {"a": lambda t: t, "b": lambda t: 10.0, "c": lambda t: 1.0 / 0.0})
    assert formula(3.0) == 16.0


REFUSED = [
    ("an attribute", "t.real", "Attribute"),
    ("a dunder", "().__class__", "__class__|Attribute|Tuple"),
    ("an import", "__import__('os')", "__import__"),
    ("a builtin", "eval", "'eval'"),
    ("the builtins", "__builtins__", "'__builtins__'"),
    ("a call of a call", "sin(t)(t)", "calls sin"),
    ("a call of a number", "t(1)", "calls t"),
    ("a string", "'a'", "constants are numbers"),
    ("a format string", "f'{t}'", "JoinedStr"),
    ("a truth value", "True", "constants are numbers"),
    ("nothing at all", "None", "constants are numbers"),
    ("an imaginary number", "1j", "constants are numbers"),
    ("a lambda", "lambda: 1", "Lambda"),
    ("a walrus", "(x := 1)", "NamedExpr"),
    ("a list", "[1, 2]", "List"),
    ("a comprehension", "[t for t in t]", "ListComp|comprehension"),
    ("an index", "t[0]", "Subscript"),
    ("a keyword argument", "sin(x=1)", "keyword"),
    ("a starred argument", "max(*t)", "Starred"),
    ("a bit operation", "1 << 9", "LShift"),
    ("an identity", "t is t", "Is"),
    ("a statement", "t = 1", "is not a formula"),
    ("two statements", "t; t", "is not a formula"),
    ("an empty text", "", "is not a formula"),
    ("half a conditional", "1 if t", "is not a formula"),
    ("a null byte", "t\0", "is not a formula"),
    ("deep parentheses", "(" * 300 + "t" + ")" * 300, "is not a formula"),
    ("deep signs", "-" * 5000 + "t", "is not a formula"),
    ("deep sums", "t+" * 20000 + "t", "is not a formula"),
    ("deep calls", "sin(" * 400 + "t" + ")" * 400, "is not a formula"),
    ("an integer that no float holds", "1" + "0" * 400, "is not a formula"),
]


@pytest.mark.parametrize(("text", "reason"), [r[1:] for r in REFUSED], ids=[r[0] for r in REFUSED])
def test_anything_else_is_refused_in_one_line(text, reason):
    with pytest.raises(ValueError, match=reason) as caught:
        compile_formula(text, {})
    assert "\n" not in str(caught.value)


def test_a_message_quotes_no_more_of_a_long_text_than_a_line_holds():
    with pytest.raises(ValueError, match="is not a formula") as caught:
        compile_formula("(" * 5000, {})
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        "sin",
        "max",
        "sin(1, 2)",
        "sin()",
        "atan2(1)",
        "max()",
        "max(t)",
        "max(t, sin)",
        "-sin",
        "t if sin else 1",
        "sin == sin",
    ],
)
def test_a_function_that_is_not_called_or_called_with_the_wrong_number_of_arguments_is_refused(text):
    with pytest.raises(ValueError, match=r"sin|max|atan2"):
        compile_formula(text, {})


@pytest.mark.parametrize(("text", "hint"), [("m_hatt", "m_hat"), ("2*pie", "pi"), ("tt", "t")])
def test_a_misspelt_name_brings_a_suggestion(text, hint):
    with pytest.raises(ValueError, match=f"did you mean '{hint}'"):
        compile_formula(text, {"m_hat": lambda t: t})


def test_a_misspelt_function_brings_the_functions_to_choose_from():
    with pytest.raises(ValueError, match=r"calls sinn.*\bsin\b"):
        compile_formula("sinn(t)", {})


@pytest.mark.parametrize(
    "text",
    [
        "9**9**9**9",
        "9.0**9**9**9",
        "exp(1000)",
        "1/(t - 1)",
        "log(t - 1)",
        "sqrt(-t)",
        "(-8)**0.5",
        "t % 0",
        "asin(2*t)",
    ],
)
def test_a_formula_without_a_value_raises_an_arithmetic_or_value_error_at_once(text):
    formula = compile_formula(text, {})
    with pytest.raises((ArithmeticError, ValueError)):
        formula(1.0)


# Formulas and their meaning, grown together: the oracle never sees the text.
LEAVES = st.one_of(
    st.just(("t", lambda t: t)),
    st.floats(0.0, 1e3, allow_subnormal=False).map(lambda c: (repr(c), lambda t: c)),
    st.integers(0, 50).map(lambda c: (str(c), lambda t: float(c))),
)


def _binary(parts):
    symbol, (a, f), (b, g) = parts
    operate = {
        "+": lambda x, y: x + y,
        "-": lambda x, y: x - y,
        "*": lambda x, y: x * y,
        "/": lambda x, y: x / y,
        "<": lambda x, y: float(x < y),
        ">=": lambda x, y: float(x >= y),
    }[symbol]
    return f"({a} {symbol} {b})", lambda t: operate(f(t), g(t))


def _called(parts):
    name, (a, f) = parts
    return f"{name}({a})", lambda t: float(getattr(math, name)(f(t)))


def _chosen(parts):
    (a, f), (c, h), (b, g) = parts
    return f"({a} if {c} else {b})", lambda t: f(t) if h(t) else g(t)


def _grow(inner):
    return st.one_of(
        st.tuples(st.sampled_from(["+", "-", "*", "/", "<", ">="]), inner, inner).map(_binary),
        st.tuples(st.sampled_from(["sin", "cos", "exp", "sqrt", "log", "tanh", "floor"]), inner).map(_called),
        st.tuples(inner, inner, inner).map(_chosen),
        inner.map(lambda p: (f"-{p[0]}", lambda t: -p[1](t))),
    )


@settings(max_examples=150, deadline=None)
@given(st.recursive(LEAVES, _grow, max_leaves=12), st.floats(0.0, 20.0))
def test_any_formula_means_what_its_parts_mean(formula, t):
    text, meaning = formula
    try:
        expected = meaning(t)
    except (ArithmeticError, ValueError) as error:
        with pytest.raises(type(error)):
            compile_formula(text, {})(t)
        return
    got = compile_formula(text, {})(t)
    assert got == expected or (math.isnan(got) and math.isnan(expected))


TOKENS = [
    *FUNCTIONS, "t", "pi", "a", "(", ")", ",", "+", "-", "*", "/", "**", "%", "<", "==", "if", "else", "and", "not",
    "1", "2.5", "1e300", "9", " ", ".", "[", "]", "lambda", ":", "'", "=", "\\", "\n", "#", "j", "_", "0x",
]  # fmt: skip


@pytest.mark.full
@settings(max_examples=400, deadline=None)
@given(st.one_of(st.text(max_size=30), st.lists(st.sampled_from(TOKENS), max_size=14).map(" ".join)))
def test_no_text_escapes_as_anything_but_a_value_or_arithmetic_error(text):
    try:
        formula = compile_formula(text, {"a": lambda t: t})
    except ValueError as refusal:
        assert "\n" not in str(refusal)
        return
    try:
        value = formula(1.5)
    except (ArithmeticError, ValueError) as failure:
        assert "\n" not in str(failure)  # a run tells it in its own line
    else:
        assert type(value) is float


def test_whole_numbers_do_not_grow_beyond_floats():
    assert isinstance(compile_formula("floor(2.5)", {})(0.0), float)
    assert isinstance(compile_formula("ceil(2.5)", {})(0.0), float)
    with pytest.raises(OverflowError):
        compile_formula("floor(9e9) ** floor(9e9)", {})(0.0)
