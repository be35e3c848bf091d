"""What is said of flat directions, on Jacobians of models whose flat directions are known in closed form."""

import numpy as np
import pytest

from estimator import Parameter, ParameterSpace
from estimator.identifiability import information, information_of_covariance
from estimator.offline.identifiability_report import findings

LOG = {"scale": "log"}
M, L = Parameter("m", 0.1, 5.0, "kg", **LOG), Parameter("l", 0.1, 3.0, "m", **LOG)
C, K = Parameter("c", 0.01, 1.0, "kg/s", **LOG), Parameter("k", 1.0, 90.0, "N/m", **LOG)
A, B = Parameter("a", -2.0, 2.0, "N"), Parameter("b", 0.0, 5.0)
THETA = {"m": 1.2, "l": 0.5, "c": 0.2, "k": 7.0, "a": 0.5, "b": 3.0, "e": 0.0}


def told(parameters, *functions, noise=1e-3):
    """Findings where so many functions of the parameters are measured; their slopes by central differences."""
    space = ParameterSpace(parameters)
    theta = np.array([THETA[p.name] for p in parameters])
    z, h = space.to_unit(theta), 1e-6

    def values(z):
        return np.array([f(**space.named(space.from_unit(z))) for f in functions]) / noise

    jacobian = np.column_stack([(values(z + e) - values(z - e)) / (2 * h) for e in h * np.eye(len(z))])
    return findings(information(jacobian), space, theta)


def test_of_a_product_the_ratio_is_not_seen():
    assert told((M, L), lambda m, l: m * l) == [
        "m and l trade off: their product is seen, their ratio is not; hold one, or excite them more."
    ]


def test_a_seen_parameter_that_is_zero_changes_nothing():
    (word,) = told((M, L, Parameter("e", -1.0, 1.0)), lambda m, l, e: m * l, lambda m, l, e: e)
    assert word.startswith("m and l trade off: their product is seen,")


def test_of_a_ratio_the_product_is_not_seen():
    (word,) = told((M, K), lambda m, k: k / m)
    assert word.startswith("m and k trade off: their ratio is seen, their product is not;")


@pytest.mark.parametrize(
    ("function", "words"),
    [(lambda m, l: m * l**2, "m * l^2 is seen"), (lambda m, l: np.sqrt(l) / m, "m / l^0.5 is seen")],
    ids=["moment of inertia", "root"],
)
def test_of_powers_the_combination_is_told(function, words):
    (word,) = told((M, L), function)
    assert f"trade off: {words}, and neither alone;" in word


def test_what_only_ratios_are_seen_of_has_a_common_factor():
    """A mass-spring-damper that swings freely: c/m and k/m."""
    (word,) = told((M, C, K), lambda m, c, k: c / m, lambda m, c, k: k / m)
    assert word.startswith("m, c and k trade off: their ratios are seen, their common factor is not;")


def test_what_one_product_is_seen_of_trades_off_in_all_other_ways():
    (word,) = told((M, C, K), lambda m, c, k: m * c * k)
    assert word.startswith("m, c and k trade off in 2 ways: hold 2 of them,")


@pytest.mark.parametrize("d", [11, 12, 30])
def test_a_direction_over_many_parameters_is_named_by_its_members(d):
    """Where only the ratios of d parameters are seen, each has 1/sqrt(d) of the direction: below 0.3 from 12 on."""
    space = ParameterSpace(tuple(Parameter(f"p{i}", 0.1, 10.0, **LOG) for i in range(d)))
    ratios = 1e4 * (np.eye(d) - np.full((d, d), 1.0 / d))
    (word,) = findings(information(ratios), space, np.ones(d))
    names = ", ".join(f"p{i}" for i in range(d - 1))
    assert word.startswith(f"{names} and p{d - 1} trade off: their ratios are seen, their common factor is not;")


def test_trade_offs_that_share_no_parameter_are_told_each():
    words = told((M, L, C, K, A), lambda m, l, c, k, a: m * l, lambda m, l, c, k, a: c / k, noise=1e-4)
    assert sorted(word.partition(";")[0] for word in words) == [
        "The data hardly see a: hold it, or excite it more.",
        "c and k trade off: their ratio is seen, their product is not",
        "m and l trade off: their product is seen, their ratio is not",
    ]


def test_linear_parameters_trade_off_by_amounts_in_their_units():
    """a + 2 b is seen: one more of b, of bounds of 5, makes up for two less of a, of bounds of 4."""
    (word,) = told((A, B), lambda a, b: a + 2 * b)
    share = np.array([2 / 4, -1 / 5]) / np.hypot(2 / 4, 1 / 5)  # of the cube, along the flat direction
    steps = 0.01 * share * [4.0, 5.0]
    assert any(f"a {s * steps[0]:+.2g} N with b {s * steps[1]:+.2g} goes nearly unseen" in word for s in (1, -1))


def test_parameters_that_nothing_depends_on_are_told_apart():
    """Two nil singular values: their vectors are any mixture, and yet no trade-off is told."""
    rotation = np.linalg.qr(np.random.default_rng(0).normal(size=(2, 2)))[0]
    seen = information(np.array([[500.0, 0, 0], [0, 0, 0], [0, 0, 0]]))
    mixed = type(seen)(seen.singular_values, np.vstack([[1.0, 0, 0], np.pad(rotation, ((0, 0), (1, 0)))]))
    space = ParameterSpace((M, A, K))
    assert sorted(findings(mixed, space, np.array([1.2, 0.5, 7.0]))) == [
        "The data hardly see a: hold it, or excite it more.",
        "The data hardly see k: hold it, or excite it more.",
    ]


@pytest.mark.parametrize(("value", "words"), [(3.0, "upper bound, 3 m"), (0.1, "lower bound, 0.1 m")])
def test_a_parameter_at_a_bound_is_named(value, words):
    space = ParameterSpace((L,))
    (word,) = findings(information(np.array([[1e3]])), space, np.array([value]))
    assert word == f"l is at its {words}: widen it unless it is a physical limit, or doubt the model."


def test_where_all_is_seen_nothing_is_said():
    assert told((M, L, C), lambda m, l, c: m, lambda m, l, c: l, lambda m, l, c: c) == []


def test_errors_that_are_nearly_one_are_correlated():
    """m + l and, a hundred times worse, m - l: correlation -(100^2 - 1)/(100^2 + 1) in equal scales."""
    a, b = Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)
    seen = information(np.array([[1e4, 1e4], [100.0, -100.0]]))
    assert findings(seen, ParameterSpace((a, b)), np.array([0.5, 0.5])) == [
        "The errors of b and a are correlated (-1.00)."
    ]


@pytest.mark.parametrize(("flat", "told"), [(0.3, "9.6"), (3.58, "100")])
def test_a_parameter_that_several_directions_blur_together_is_named(flat, told):
    """One that two directions, of 4.9 and of 30 or 358 %, have a part of: 0.96 and 0.28, in squares."""
    direction = np.array([0.28, np.sqrt(1.0 - 0.28**2)])
    directions = np.array([[direction[1], -direction[0]], direction])
    seen = type(information(np.eye(2)))(np.array([1 / 0.049, 1 / flat]), directions)
    words = findings(seen, ParameterSpace((A, B)), np.array([0.5, 3.0]))
    assert words[0].startswith("The data hardly see b")
    assert 100.0 * np.hypot(0.049 * direction[1], flat * 0.28) == pytest.approx(float(told), rel=0.05)
    assert words[1] == f"a is known to {told} % of its scaled bounds only: excite it more."


def test_sight_of_a_covariance_is_that_of_the_data_it_came_from():
    J = np.random.default_rng(1).normal(size=(20, 3)) * [30.0, 40.0, 50.0]
    seen, same = information(J), information_of_covariance(np.linalg.inv(J.T @ J))
    np.testing.assert_allclose(same.singular_values, seen.singular_values, rtol=1e-9)
    np.testing.assert_allclose(np.abs(np.sum(same.directions * seen.directions, axis=1)), 1.0, rtol=1e-9)
    np.testing.assert_allclose(same.std(), np.sqrt(np.linalg.inv(J.T @ J).diagonal()), rtol=1e-9)
