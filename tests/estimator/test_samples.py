"""Residuals of samples by hand, and how far back each channel of the window remembers."""

from dataclasses import replace
from math import exp

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import DerivativeResidual, Parameter, ParameterSpace, ResidualWindow, Sample, chi2_limit, sliding_window
from estimator.samples import Node, Samples


def sample(t, *xdot):
    return Sample(float(t), (0.0,), (0.0,), tuple(map(float, xdot)))


class Offset:
    """Residual xdot - theta of a sample, a parameter a channel; counts its calls."""

    def __init__(self):
        self.calls = []

    def __call__(self, theta, sample):
        self.calls.append((tuple(theta), sample.t))
        return np.array(sample.xdot) - theta


def test_residual_of_a_sliding_mass_by_hand():
    """x = (position, velocity), xdot = (v, (u - c v)/m): with m = 2, c = 0.5, v = 4, u = 10 it accelerates by 4."""

    def model(x, u, m, c):
        return (x[1], (u[0] - c * x[1]) / m)

    space = ParameterSpace((Parameter("c", 0.0, 1.0), Parameter("m", 0.1, 5.0)))
    seen = Sample(0.1, (1.0, 4.0), (10.0,), (4.3, 4.4))
    theta = np.array([0.5, 2.0])
    both = DerivativeResidual(model, space, channels=(0, 1), noise=(0.1, 0.2))
    assert_allclose(both(theta, seen), [3.0, 2.0], rtol=1e-12)
    # Only the acceleration is sampled.
    one = DerivativeResidual(model, space, channels=(1,), noise=(0.2,))
    assert_allclose(one(theta, Sample(0.1, (1.0, 4.0), (10.0,), (4.4,))), [2.0], rtol=1e-12)
    # With twice the mass half of it: 2.4 too little, or 12 standard deviations.
    assert_allclose(one(np.array([0.5, 4.0]), Sample(0.1, (1.0, 4.0), (10.0,), (4.4,))), [12.0], rtol=1e-12)


def test_residual_refuses_a_sample_of_another_size():
    residual = DerivativeResidual(lambda x, u, m: (m,), ParameterSpace((Parameter("m", 0.0, 1.0),)), (0,), (1.0,))
    with pytest.raises(ValueError, match="zip"):
        residual(np.array([0.5]), sample(0, 1.0, 2.0))


def test_a_model_without_a_value_gives_nan_in_each_channel():
    """With m = 0 Python divides by zero; exp(1000) is too large for it."""
    space = ParameterSpace((Parameter("m", 0.0, 1.0),))
    seen = sample(0, 1.0, 2.0)
    divides = DerivativeResidual(lambda x, u, m: (1.0, 1.0 / m), space, (0, 1), (1.0, 1.0))
    assert_allclose(divides(np.array([0.5]), seen), [0.0, 0.0])
    np.testing.assert_array_equal(divides(np.array([0.0]), seen), [np.nan, np.nan])
    overflows = DerivativeResidual(lambda x, u, m: (exp(1000.0), 1.0), space, (0, 1), (1.0, 1.0))
    np.testing.assert_array_equal(overflows(np.array([0.5]), seen), [np.nan, np.nan])


def test_a_table_of_residuals_is_that_of_one_call_after_the_other_to_the_bit():
    """No value where m is 0, and none where a sample lacks a channel, or both: of 3 x 4 residuals of two channels."""
    space = ParameterSpace((Parameter("m", 0.0, 1.0), Parameter("c", 0.0, 1.0)))
    residual = DerivativeResidual(lambda x, u, m, c: (c * x[0], 0.3, x[0] / m), space, (2, 0), (0.3, 0.7))
    nan = float("nan")
    values = [(0.1, 0.2), (nan, 1.0 / 3.0), (0.7, nan), (nan, nan)]
    seen = [Sample(float(t), (0.1 * t,), (), xdot) for t, xdot in enumerate(values)]
    thetas = np.array([[[0.3, 0.1]], [[0.0, 0.1]], [[0.7, 1.0 / 7.0]]])
    one_by_one = [[[residual(theta, sample) for sample in seen] for theta in row] for row in thetas]
    np.testing.assert_array_equal(residual.rows(thetas, seen), one_by_one)
    np.testing.assert_array_equal(residual.rows(thetas[2, 0], seen), one_by_one[2][0])
    assert residual.rows(thetas, []).shape == (3, 1, 0, 2)


def test_a_vectorised_model_is_called_once_with_arrays_and_gives_the_same_residuals():
    """log(0) is no value; where arrays are refused because of one candidate, each is called by itself."""
    calls = []

    def model(x, u, m):
        calls.append(np.shape(m))
        if np.any(np.asarray(m) > 2.0):
            raise ValueError("too heavy")
        return x[0] + u[0] * m, 0.5, np.log(m) if np.ndim(m) else float(np.log(m)) if m else float("nan")

    space = ParameterSpace((Parameter("m", 0.0, 3.0),))
    alone = DerivativeResidual(model, space, (0, 2), (0.1, 0.2))
    vectorised = DerivativeResidual(model, space, (0, 2), (0.1, 0.2), is_vectorised=True)
    seen = [Sample(0.1 * k, (1.0 + k,), (2.0,), (0.3, 0.7 * k)) for k in range(3)]
    for masses in ([0.5, 0.7, 0.0, 1.1], [0.5, 2.5]):
        thetas = np.array(masses)[:, None]
        expected = alone.rows(thetas, seen)
        calls.clear()
        np.testing.assert_allclose(
            vectorised.rows(thetas, seen)[np.array(masses) > 0.0], expected[np.array(masses) > 0.0]
        )
        assert calls == [(12,)] if max(masses) <= 2.0 else [(6,), *[()] * 6]
    assert not np.isfinite(vectorised.rows(np.zeros((2, 1)), seen)[..., 1]).any()


@pytest.mark.parametrize("is_vectorised", [False, True])
def test_rows_with_other_inputs_are_those_of_samples_that_have_them(is_vectorised):
    space = ParameterSpace((Parameter("m", 0.1, 3.0),))
    residual = DerivativeResidual(
        lambda x, u, m: (x[0] + u[0] / m, u[1] * x[0]), space, (0, 1), (0.1, 0.2), is_vectorised
    )
    seen = [Sample(0.1 * k, (1.0 + k,), (2.0, 0.0), (0.3, 0.7 * k)) for k in range(3)]
    inputs, theta = np.random.default_rng(0).standard_normal((4, 3, 2)), np.array([0.7])
    others = [[replace(s, u=tuple(u)) for s, u in zip(seen, own, strict=True)] for own in inputs.tolist()]
    expected = [residual.rows(theta, other) for other in others]
    np.testing.assert_array_equal(residual.rows_with(inputs, theta, seen), expected)


QUADRATIC = ParameterSpace((Parameter("a", 0.5, 4.0), Parameter("b", 0.1, 2.0)))


def quadratic(x, u, a, b):
    return (a * x[0] ** 2 + b * u[0], a * b * x[0] * u[0])


def spread(t, *nodes):
    """A sample with nodes at these (weight, state, input, change), its x and u being their means."""
    x, u = (sum(node[0] * node[i] for node in nodes) for i in (1, 2))
    return Sample(t, (x,), (u,), (5.0, 6.0), nodes=tuple(Node(w, (s - x,), (v - u,), (c,)) for w, s, v, c in nodes))


SPREAD = [
    spread(0.0, (0.25, 1.0, 2.0, 0.1), (0.5, 1.5, -1.0, 0.2), (0.25, 3.0, 0.5, -0.1)),
    spread(1.0, (0.5, 0.0, 1.0, 0.1), (-0.5, 1.0, 1.0, 0.2), (1.0, 2.0, 0.5, 0.3)),
]


def test_the_model_of_a_sample_with_nodes_is_the_mean_over_them_by_hand():
    """a = 2, b = 0.5: 2 x^2 + u / 2 is 3, 4, 18.25 at the first one's nodes, and x u 2, -1.5, 1.5."""
    residual = DerivativeResidual(quadratic, QUADRATIC, channels=(0, 1), noise=(0.5, 2.0))
    theta = np.array([2.0, 0.5])
    means = 0.25 * 3.0 + 0.5 * 4.0 + 0.25 * 18.25, 0.25 * 2.0 - 0.5 * 1.5 + 0.25 * 1.5
    assert_allclose(residual(theta, SPREAD[0]), [(5.0 - means[0]) / 0.5, (6.0 - means[1]) / 2.0], rtol=1e-12)


@pytest.mark.parametrize("is_vectorised", [False, True])
def test_a_table_of_samples_with_nodes_is_that_of_each_by_itself(is_vectorised):
    n_calls = 0

    def counted(x, u, a, b):
        nonlocal n_calls
        n_calls += 1
        return quadratic(x, u, a, b)

    single = DerivativeResidual(quadratic, QUADRATIC, channels=(0, 1), noise=(0.5, 2.0))
    residual = replace(single, model=counted, is_vectorised=is_vectorised)
    thetas, samples = np.array([[2.0, 0.5], [1.0, 1.5]]), Samples(SPREAD * 3)
    one_by_one = [[single(theta, sample) for sample in samples] for theta in thetas]
    assert_allclose(residual.rows(thetas, samples), one_by_one, rtol=1e-12)
    assert_allclose(residual.rows(thetas, samples.newest(3)), [rows[-3:] for rows in one_by_one], rtol=1e-12)
    inputs = np.arange(12.0).reshape(2, 6, 1)
    moved = [[replace(s, u=(float(v),)) for s, (v,) in zip(samples, held, strict=True)] for held in inputs]
    expected = [[single(thetas[0], sample) for sample in row] for row in moved]
    assert_allclose(residual.rows_with(inputs, thetas[0], samples), expected, rtol=1e-12)
    assert n_calls == (3 if is_vectorised else 3 * 2 * (6 + 3 + 6))


def test_slopes_at_samples_with_nodes_are_means_over_them():
    def slopes(x, u, a, b):
        return [[x[0] ** 2, u[0]], [b * x[0] * u[0], a * x[0] * u[0]]]

    residual = DerivativeResidual(quadratic, QUADRATIC, channels=(0, 1), noise=(0.5, 2.0), slopes=slopes)
    z, step = np.array([0.4, 0.6]), 1e-6
    aside = [QUADRATIC.from_unit(z + side * step * axis) for axis in np.eye(2) for side in (1, -1)]
    rows = residual.rows(np.array(aside), SPREAD)
    differences = np.stack([rows[0] - rows[1], rows[2] - rows[3]], axis=-1) / (2.0 * step)
    assert_allclose(residual.slope_rows(QUADRATIC.from_unit(z), SPREAD), differences, rtol=1e-7)


@pytest.mark.parametrize(("weight", "has_corner"), [(0.16, True), (0.14, False)])
def test_dry_friction_that_turns_round_within_a_step_is_a_corner(weight, has_corner):
    """It is 2 and -2 at the ends of the step and -2 in the middle: the rules differ by 2 w, which is 20 w sigma."""

    def friction(x, u, a, b):
        return (-a * np.sign(x[0]), x[0])

    residual = DerivativeResidual(friction, QUADRATIC, channels=(0, 1), noise=(0.1, 0.1))
    crossing = spread(0.0, (weight, 0.01, 0.0, 0.1), (1.0 - weight, 0.3, 0.0, 0.1))
    assert residual.has_corner(np.array([2.0, 1.0]), crossing).tolist() == [has_corner, False]
    smooth = spread(0.0, (weight, 0.2, 0.0, 0.1), (1.0 - weight, 0.3, 0.0, 0.1))
    assert not residual.has_corner(np.array([2.0, 1.0]), smooth).any()


@pytest.mark.parametrize("error", [KeyError, TypeError, RuntimeError])
def test_a_models_own_mistakes_pass_through(error):
    def model(x, u, m):
        raise error("a slip in the model")

    residual = DerivativeResidual(model, ParameterSpace((Parameter("m", 0.0, 1.0),)), (0,), (1.0,))
    with pytest.raises(error, match="a slip in the model"):
        residual(np.array([0.5]), sample(0, 1.0))


def test_residuals_are_channel_by_channel_from_old_to_new():
    window = ResidualWindow(Offset(), 2)
    for t in range(3):
        window.append(sample(t, t, 10 + t))
    assert window.lengths == (3, 3)
    assert_allclose(window.residual(np.array([1.0, 10.0])), [-1, 0, 1, 0, 1, 2])
    table = window.residuals([np.array([0.0, 0.0]), np.array([1.0, 10.0])])
    assert_allclose(table, [[0, 1, 2, 10, 11, 12], [-1, 0, 1, 0, 1, 2]])


def test_a_full_window_drops_the_oldest_sample():
    window = ResidualWindow(Offset(), 1, max_length=3)
    theta = np.array([0.0])
    for t in range(10):
        window.append(sample(t, t))
        if t % 2:  # also where some samples come and go unseen
            assert_allclose(window.residual(theta), np.arange(max(t - 2, 0), t + 1))
    assert window.lengths == (3,)


@pytest.mark.parametrize("max_length", [1, 4])
def test_the_model_is_called_once_for_each_candidate_and_sample(max_length):
    residual = Offset()
    window = ResidualWindow(residual, 2, max_length)
    candidates = [np.array([float(i), 0.0]) for i in range(5)]
    for t in range(12):
        window.append(sample(t, t, -t))
        for _ in range(2):
            window.residuals(candidates)
            window.residual(candidates[2])
            window.explain(candidates[2])
    assert len(residual.calls) == 5 * 12
    assert len(set(residual.calls)) == 5 * 12
    # A new candidate costs one call for each sample of the window.
    del residual.calls[:]
    n_samples = max(window.lengths)
    window.residual(np.array([9.0, 9.0]))
    assert len(residual.calls) == n_samples


def test_rows_of_other_candidates_are_dropped():
    residual = Offset()
    window = ResidualWindow(residual, 1)
    one, other = np.array([1.0]), np.array([2.0])
    window.append(sample(0, 0))
    window.residuals([one, other])
    window.residuals([one])
    del residual.calls[:]
    window.residuals([one])
    assert residual.calls == []
    window.residuals([one, other])
    assert residual.calls == [((2.0,), 0.0)]


def test_clear_forgets_every_sample():
    window = ResidualWindow(Offset(), 2)
    window.append(sample(0, 100, 100))
    window.residual(np.zeros(2))
    window.clear()
    assert window.lengths == (0, 0)
    window.append(sample(1, 3, 4))
    assert window.lengths == (1, 1)
    assert_allclose(window.residual(np.zeros(2)), [3.0, 4.0])


@pytest.mark.parametrize("max_length", [0, -3])
def test_a_window_holds_a_sample(max_length):
    with pytest.raises(ValueError, match=f"max_length must be at least 1 sample, got {max_length}"):
        ResidualWindow(Offset(), 1, max_length)


NOISE = (0.4, -1.1, 0.7, -0.2, 1.3)


@pytest.fixture
def explained():
    """A window of five samples of noise of one standard deviation in two channels, explained by theta = 0."""
    window = ResidualWindow(Offset(), 2)
    for t, e in enumerate(NOISE):
        window.append(sample(t, e, -e))
        window.explain(np.zeros(2))
    assert window.lengths == (5, 5)
    return window


def test_a_jump_restarts_the_channel_that_contradicts_and_no_other(explained):
    explained.append(sample(5, 50.0, 0.3))
    explained.explain(np.zeros(2))
    assert explained.lengths == (1, 6)
    assert_allclose(explained.residual(np.zeros(2)), [50.0, *(-e for e in NOISE), 0.3])


def test_both_channels_restart_where_both_contradict(explained):
    explained.append(sample(5, 50.0, -40.0))
    explained.explain(np.zeros(2))
    assert explained.lengths == (1, 1)
    # The samples before the jump are gone: a candidate that fits the new sample explains all there is.
    explained.append(sample(6, 50.0, -40.0))
    assert_allclose(explained.residual(np.array([50.0, -40.0])), np.zeros(4))


def test_after_a_restart_the_window_grows_again_once_an_incumbent_explains_it(explained):
    explained.append(sample(5, 50.0, 0.3))
    explained.explain(np.zeros(2))
    for t in range(6, 9):
        explained.append(sample(t, 50.0, 0.0))
        explained.explain(np.array([50.0, 0.0]))
    assert explained.lengths == (4, 9)
    # The other channel still has the samples from before the jump.
    both = [*np.zeros(4), *(-e for e in NOISE), 0.3, *np.zeros(3)]
    assert_allclose(explained.residual(np.array([50.0, 0.0])), both)


def test_a_channel_not_explained_yet_is_patient():
    """Nothing has explained it so far: the incumbent is to blame, not the data."""
    window = ResidualWindow(Offset(), 1)
    for t in range(4):
        window.append(sample(t, 50.0))
        window.explain(np.zeros(1))
    assert window.lengths == (4,)
    window.explain(np.array([50.0]))
    assert window.lengths == (4,)
    # Now it was explained: the next contradiction is a jump.
    window.append(sample(4, 20.0))
    window.explain(np.array([50.0]))
    assert window.lengths == (1,)


def test_without_patience_a_channel_not_explained_restarts_too():
    window = ResidualWindow(Offset(), 1)
    for t in range(4):
        window.append(sample(t, 50.0))
        window.explain(np.zeros(1))
    window.explain(np.zeros(1), patient=False)
    assert window.lengths == (1,)


def test_a_jump_in_a_restarted_channel_waits_for_an_incumbent(explained):
    """Restarted at a sample that the incumbent does not explain, it is not explained: no second restart."""
    explained.append(sample(5, 50.0, 0.3))
    explained.explain(np.zeros(2))
    explained.append(sample(6, 90.0, 0.3))
    explained.explain(np.zeros(2))
    assert explained.lengths == (2, 7)


def test_a_slow_drift_is_noticed_by_the_sum_though_no_sample_stands_out():
    """Residuals of three standard deviations: nine a sample; 9 < 15.1, 18 < 18.4 and 27 > 21.1, chi-square at 1e-4."""
    window = ResidualWindow(Offset(), 1)
    lengths = []
    for t in range(4):
        window.append(sample(t, 3.0))
        window.explain(np.zeros(1))
        lengths.append(window.lengths[0])
    assert lengths == [1, 2, 1, 2]


def test_the_false_alarm_rate_is_the_one_asked_for(monkeypatch):
    """2000 windows of five samples of noise; alarms at 5 %: 100 +- 10, five standard deviations allowed."""
    monkeypatch.setattr(sliding_window, "FALSE_ALARM", 0.05)
    rng, alarms = np.random.default_rng(0), 0
    for _ in range(2000):
        window = ResidualWindow(Offset(), 1)
        for t in range(5):
            window.append(sample(t, rng.standard_normal()))
        window.explain(np.zeros(1))
        alarms += window.lengths == (1,)
    assert abs(alarms - 100) < 5 * np.sqrt(2000 * 0.05 * 0.95)


@pytest.mark.parametrize(
    ("false_alarm", "degrees", "value"),
    [(0.05, 1, 3.841), (0.05, 10, 18.307), (0.01, 5, 15.086), (0.001, 2, 13.816)],
)
def test_chi2_limits_are_those_of_the_printed_tables(false_alarm, degrees, value):
    assert_allclose(chi2_limit(false_alarm, degrees), value, atol=5e-4)


@pytest.mark.parametrize("false_alarm", [1e-4, 1e-17, 1e-20, 1e-300])
def test_chi2_limits_of_two_degrees_are_exact_however_rare_the_alarm(false_alarm):
    """P(|r|^2 > c) = exp(-c/2)."""
    assert_allclose(chi2_limit(false_alarm, 2), -2.0 * np.log(false_alarm), rtol=1e-12)
