"""Derivatives from sampled states: their weights, noise, bias and time, against closed forms, SciPy and DOP853."""

import numpy as np
import pytest
from scipy import integrate, linalg, signal, stats

from cosim.sampling.derivative_filter import DerivativeFilter, derivative_noise, kernel_of
from cosim.scenarios.schema.sampling import Sampling, SavitzkyGolay, StateVariable
from estimator import DerivativeResidual, Parameter, ParameterSpace, Sample

H = 0.01  # s
FILTERS = {
    "parabola": SavitzkyGolay(kind="savitzky-golay", points=11, order=2),
    "cubic": SavitzkyGolay(kind="savitzky-golay", points=11, order=3),
    "long": SavitzkyGolay(kind="savitzky-golay", points=25, order=4),
    "low-pass": StateVariable(kind="state-variable", cutoff=40.0, order=1),
    "low-passes": StateVariable(kind="state-variable", cutoff=40.0, order=3),
}
each = pytest.mark.parametrize("settings", [pytest.param(f, id=name) for name, f in FILTERS.items()])
polynomials = pytest.mark.parametrize(
    "settings", [pytest.param(f, id=name) for name, f in FILTERS.items() if isinstance(f, SavitzkyGolay)]
)


def filtered(settings, x, u, channels, t=None):
    """The samples that a filter makes of states (k, n) and inputs (k, p), held up to each point."""
    derivative_filter = DerivativeFilter(settings, H, channels)
    times = H * np.arange(len(x)) if t is None else t
    made = (derivative_filter(Sample(float(s), tuple(a), tuple(b), ())) for s, a, b in zip(times, x, u, strict=True))
    return [sample for sample in made if sample is not None]


@polynomials
def test_a_polynomial_of_the_filters_order_has_its_own_slope_at_the_sample_s_time(settings):
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7, -0.4][: settings.order + 1])
    t = H * np.arange(200)
    samples = filtered(settings, polynomial(t)[:, None], np.zeros((200, 0)), [0])
    assert len(samples) >= 7
    for sample in samples:
        assert sample.xdot[0] == pytest.approx(polynomial.deriv()(sample.t), rel=1e-10)


@each
@pytest.mark.parametrize("omega", [2.0, 20.0])
def test_a_sinusoid_comes_out_as_the_mean_over_its_past_says(settings, omega):
    """The mean slope of exp(i w t) over a step is known in closed form, and so is that of the filter's weights."""
    kernel = kernel_of(settings, H)
    t = H * np.arange(400)
    samples = filtered(settings, np.sin(omega * t)[:, None], np.zeros((400, 0)), [0])
    steps = np.arange(len(kernel.weights))
    gain = np.sum(kernel.weights * (np.exp(-1j * omega * H * steps) - np.exp(-1j * omega * H * (steps + 1)))) / H
    newest = np.array([sample.t for sample in samples]) + kernel.delay
    expected = np.imag(gain * np.exp(1j * omega * newest))
    assert [s.xdot[0] for s in samples] == pytest.approx(expected, abs=1e-10)
    slow = abs(np.imag(1j * omega * np.exp(1j * omega * (newest - kernel.delay))) - expected).max() / omega
    # what the weights' second moment leaves of a sinusoid; for no second moment the fourth, at most T^4 / 24
    length = H * len(kernel.weights)
    limit = abs(kernel.variance) * omega**2 / 2 + (omega * length) ** (4 if abs(kernel.variance) < 1e-12 else 3) / 24
    assert slow <= limit


@each
def test_where_the_plant_is_linear_jumping_inputs_leave_no_residual(settings):
    """x1' = x2, x2' = u, u held over each step: integrated in closed form."""
    rng = np.random.default_rng(0)
    u = rng.choice([-5.0, 0.0, 8.0], 300)  # u[k] is held up to t_k
    x2 = np.concatenate([[0.3], 0.3 + H * np.cumsum(u[1:])])
    x1 = np.concatenate([[1.0], 1.0 + np.cumsum(H * (x2[:-1] + x2[1:]) / 2)])
    samples = filtered(settings, np.stack([x1, x2], axis=1), u[:, None], [0, 1])
    assert len(samples) > 5
    for sample in samples:
        assert sample.xdot[0] == pytest.approx(sample.x[1], abs=1e-11)
        assert sample.xdot[1] == pytest.approx(sample.u[0], abs=1e-11)


@each
def test_weights_sum_to_one_and_a_ramp_is_seen_where_it_was_a_delay_ago(settings):
    kernel = kernel_of(settings, H)
    assert kernel.weights.sum() == pytest.approx(1.0, rel=1e-12)
    t = H * np.arange(200)
    for sample in filtered(settings, 3.0 * t[:, None], t[:, None] - H / 2, [0]):
        assert sample.xdot == pytest.approx([3.0], rel=1e-10)
        assert sample.x[0] == pytest.approx(3.0 * sample.t, rel=1e-10)
        assert sample.u[0] == pytest.approx(sample.t, rel=1e-10)


def test_the_delay_is_half_of_a_polynomials_points_and_that_of_the_low_passes():
    assert kernel_of(FILTERS["cubic"], H).delay == pytest.approx(0.05, rel=1e-12)
    # 3 / 40 s, less what the cut tail of 0.1 % would add: it is 0.28 s old at the most here, the mean 0.03 s older
    assert kernel_of(FILTERS["low-passes"], H).delay == pytest.approx(3 / 40.0, rel=5e-3)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_low_passes_weigh_as_scipys_discretised_transfer_function_does(order):
    cutoff = 30.0
    kernel = kernel_of(StateVariable(kind="state-variable", cutoff=cutoff, order=order), H)
    denominator = np.poly([-cutoff] * order)
    numerator, denominator, _ = signal.cont2discrete(([cutoff**order], denominator), H, method="zoh")
    response = signal.lfilter(np.squeeze(numerator), denominator, np.eye(1, len(kernel.weights) + 1)[0])
    assert response[1:].sum() == pytest.approx(1.0, abs=1e-3)
    assert kernel.weights == pytest.approx(response[1:] / response[1:].sum(), rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 10])
def test_a_cutoff_that_asks_for_too_many_weights_is_refused_with_one_that_does_not(order):
    with pytest.raises(ValueError, match=r"cutoff: must be .* rad/s at least") as refused:
        kernel_of(StateVariable(kind="state-variable", cutoff=1e-9, order=order), H)
    least = float(str(refused.value).split()[3])
    n = len(kernel_of(StateVariable(kind="state-variable", cutoff=least, order=order), H).weights)
    assert 4900 < n <= 5000
    assert stats.gamma(order, scale=1.0 / least).sf([H * n, H * (n - 1)]) == pytest.approx([1e-3, 1e-3], rel=0.01)


@pytest.mark.parametrize("points", [5, 11, 31])
def test_noise_of_a_straight_lines_slope_is_that_of_linear_regression(points):
    kernel = kernel_of(SavitzkyGolay(kind="savitzky-golay", points=points, order=1), H)
    spread = points * (points**2 - 1) / 12  # sum of the squared distances from the middle
    assert kernel.noise_gain == pytest.approx(1.0 / (H * np.sqrt(spread)), rel=1e-12)


@pytest.mark.full
@each
def test_white_noise_comes_out_as_strong_as_predicted_and_independent(settings):
    sigma, n = 1e-3, 120_000
    noise = sigma * np.random.default_rng(1).standard_normal((n, 1))
    xdot = np.array([s.xdot[0] for s in filtered(settings, noise, np.zeros((n, 0)), [0])])
    predicted = sigma * kernel_of(settings, H).noise_gain
    squares = np.sum((xdot / predicted) ** 2)
    low, high = stats.chi2(len(xdot)).ppf([1e-4, 1 - 1e-4])
    assert low < squares < high
    for lag in (1, 2):
        shared = np.mean(xdot[lag:] * xdot[:-lag]) / predicted**2
        assert abs(shared) < 0.05 + 4.0 / np.sqrt(len(xdot))


def test_every_point_may_give_a_sample_which_then_shares_its_noise():
    settings = FILTERS["parabola"].model_copy(update={"every": 1})
    noise = np.random.default_rng(1).standard_normal((2000, 1))
    xdot = np.array([s.xdot[0] for s in filtered(settings, noise, np.zeros((2000, 0)), [0])])
    assert len(xdot) == 2000 - 10
    assert np.mean(xdot[1:] * xdot[:-1]) / np.mean(xdot**2) == pytest.approx(
        80 / 110, abs=0.05
    )  # sum j (j - 1) / sum j^2


def test_after_a_gap_in_time_the_filter_begins_anew():
    settings = FILTERS["cubic"]
    t = np.concatenate([H * np.arange(15), 1.0 + H * np.arange(15)])
    samples = filtered(settings, np.where(t < 0.5, t, 100.0 + t)[:, None], np.zeros((30, 0)), [0], t)
    assert [s.t for s in samples] == pytest.approx([0.05, 1.05])
    assert [s.xdot[0] for s in samples] == pytest.approx([1.0, 1.0])


M, L, B, G = 1.3, 0.8, 0.2, 9.81


def swing(x, u):
    """A pendulum's equations, phi = 0 hanging, written down from its textbook."""
    return (x[1], -G / L * np.sin(x[0]) - B / M * x[1] + u / (M * L))


def trajectory(start, force, changes):
    """States (k, 2) and held inputs (k, 1) of a pendulum that jumping forces keep swinging, by DOP853."""
    rng = np.random.default_rng(2)
    u = np.concatenate(
        [[0.0], force * (np.repeat(rng.uniform(-1.0, 1.0, changes), 50) + rng.uniform(-0.2, 0.2, 50 * changes))]
    )
    x = [np.array([start, 0.0])]
    for held in u[1:]:
        step = integrate.solve_ivp(lambda t, y, f=held: swing(y, f), (0, H), x[-1], "DOP853", rtol=1e-10, atol=1e-12)
        x.append(step.y[:, -1])
    return np.array(x), u[:, None]


@pytest.fixture(scope="module")
def wild():
    """Up to several radians a second."""
    return trajectory(1.0, 6.0, 20)


@pytest.fixture(scope="module")
def calm():
    """Within a few tenths of a radian, where a long filter's bias is below the noise."""
    return trajectory(0.1, 1.0, 60)


@each
def test_bias_is_within_what_curvature_and_spread_say(settings, wild):
    x, u = wild
    kernel = kernel_of(settings, H)
    residual = [s.xdot[0] - swing(s.x, s.u[0])[1] for s in filtered(settings, x, u, [1])]
    rate, acceleration = abs(x[:, 1]).max(), abs(np.diff(x[:, 1]) / H).max()
    # |f''| <= g/l; the spread of phi under |w| about the mean; the trapezoidal rule, f' <= g/l, b/m
    age = H * (np.arange(len(kernel.weights)) + 0.5) - kernel.delay
    spread = rate**2 * np.sum(np.abs(kernel.weights) * age**2) + acceleration * rate * np.sum(
        np.abs(kernel.weights * age**3)
    )
    limit = G / L * (spread / 2 + H**2 / 12 * np.sum(np.abs(kernel.weights)) * acceleration) * 1.05
    assert np.abs(residual).max() < limit
    assert np.abs(residual).max() < 0.03 * acceleration  # and it is small


@each
def test_the_mean_of_the_model_over_the_steps_is_off_by_what_a_step_hides_only(settings, wild):
    """In a step the state is a straight line, off by h^2/12 x'' in the mean, of a variance of (h x')^2/12 for f''/2."""
    x, u = wild
    weights = np.abs(kernel_of(settings, H).weights).sum()
    space = ParameterSpace((Parameter("l", 0.1, 1.0),))
    model = DerivativeResidual(lambda x, u, l: swing(x, u[0]), space, channels=(1,), noise=(1.0,))
    samples = filtered(settings, x, u, [1])
    residual = np.array([model(np.array([0.5]), s)[0] for s in samples])
    rate, acceleration = abs(x[:, 1]).max(), abs(np.diff(x[:, 1]) / H).max()
    jerk = G / L * rate + B / M * acceleration  # between two inputs
    limit = weights * H**2 / 12 * (G / L * (acceleration + rate**2 / 2) + B / M * jerk)
    assert np.abs(residual).max() < 1.05 * limit
    of_means = [s.xdot[0] - swing(s.x, s.u[0])[1] for s in samples]
    has_spread = kernel_of(settings, H).variance > H**2  # a polynomial of third order has none
    assert np.std(residual) < (0.2 if has_spread else 0.9) * np.std(of_means)


@pytest.mark.parametrize(("points", "n_steps", "n_nodes"), [(51, 1, 50), (53, 2, 26), (251, 5, 50)])
def test_a_long_filter_has_nodes_of_several_steps_and_is_exact_where_the_plant_is_linear(points, n_steps, n_nodes):
    """But for what a step hides; of an oscillator with an input that jumps, by its matrix exponential."""
    rng, matrix = np.random.default_rng(4), np.array([[0.0, 1.0], [-4.0, -0.3]])
    space = ParameterSpace((Parameter("k", 1.0, 9.0),))
    model = DerivativeResidual(lambda x, u, k: (x[1], u[0] - k * x[0] - 0.3 * x[1]), space, channels=(1,), noise=(1.0,))
    propagator, x, u = linalg.expm(matrix * H), [np.array([1.0, 0.0])], rng.uniform(-1.0, 1.0, (400, 1))
    for (held,) in u[1:]:
        rest = np.linalg.solve(matrix, [0.0, -held])
        x.append(rest + propagator @ (x[-1] - rest))
    x = np.array(x)
    settings = SavitzkyGolay(kind="savitzky-golay", points=points, order=3)
    samples = filtered(settings, x, u, [1])
    assert {len(sample.nodes) for sample in samples} == {n_nodes}
    steps = np.array_split(np.arange(points - 1, 0, -1), range(n_steps, points - 1, n_steps))  # of the first sample
    means = [np.mean((x[k] + x[k - 1]) / 2.0, axis=0) for k in steps]
    assert np.diff([node.dx for node in samples[0].nodes], axis=0) == pytest.approx(np.diff(means, axis=0), abs=1e-12)
    rate, acceleration = np.abs(x[:, 1]).max(), np.abs(np.diff(x[:, 1]) / H).max()
    hidden = H**2 / 12 * (4.0 * acceleration + 0.3 * (4.0 * rate + 0.3 * acceleration))
    limit = hidden * np.abs(kernel_of(settings, H).weights).sum()
    assert np.abs([model(np.array([4.0]), sample)[0] for sample in samples]).max() < limit


def test_newest_state_and_input_beside_a_filtered_derivative_would_be_far_off(wild):
    """The mistake that averaging x and u with the derivative's own weights avoids."""
    x, u = wild
    settings = FILTERS["cubic"]
    samples = filtered(settings, x, u, [1])
    newest = [round((s.t + 0.05) / H) for s in samples]
    right = [s.xdot[0] - swing(s.x, s.u[0])[1] for s in samples]
    wrong = [s.xdot[0] - swing(x[k], u[k, 0])[1] for s, k in zip(samples, newest, strict=True)]
    assert np.std(wrong) > 100 * np.std(right)


@pytest.mark.full_but("cubic", "low-passes")
@each
def test_at_the_true_parameters_residuals_have_unit_variance(settings, calm):
    """In standard deviations of `derivative_noise`, on twenty recordings with noise of their own."""
    x, u = calm
    sigma = 2e-3
    states = {"plant.phi": {"noise": 1e-5}, "plant.phi_dot": {"noise": sigma}}
    derivatives = {"plant.der(phi_dot)": {"of": "plant.phi_dot"}}
    sampling = Sampling.model_validate(
        {"derivatives": derivatives, "states": states, "filter": settings.model_dump(exclude_none=True)}
    )
    (noise,) = derivative_noise(sampling, H)
    rng = np.random.default_rng(3)
    residuals = []
    for _ in range(20):
        measured = x + rng.standard_normal(x.shape) * (1e-5, sigma)
        residuals += [(s.xdot[0] - swing(s.x, s.u[0])[1]) / noise for s in filtered(settings, measured, u, [1])]
    n = len(residuals)
    assert n > 1000
    low, high = stats.chi2(n).ppf([1e-4, 1 - 1e-4])
    assert low < np.sum(np.square(residuals)) < high
    assert abs(np.mean(residuals)) < 4.0 / np.sqrt(n)


def test_a_noise_that_is_given_comes_before_the_filters():
    sampling = Sampling.model_validate({
        "derivatives": {"p.dv": {"of": "p.v", "noise": 0.5}, "p.dw": {"of": "p.w"}},
        "states": {"p.v": {"noise": 1.0}, "p.w": {"noise": 2.0}},
        "filter": {"kind": "savitzky-golay", "points": 3, "order": 1},
    })  # fmt: skip
    assert derivative_noise(sampling, H) == pytest.approx((0.5, 2.0 * np.sqrt(0.5) / H))
