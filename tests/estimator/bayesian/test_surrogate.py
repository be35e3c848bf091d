"""The Gaussian processes in LAPACK against GPy and against the textbook in fifty digits."""

import GPy
import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator.bayesian import gaussian_process
from estimator.bayesian.gaussian_process import NOISE
from estimator.bayesian.surrogate import (
    LENGTHSCALE_BOUNDS,
    LENGTHSCALE_PRIOR,
    MaternBounds,
    ScalarSurrogate,
    VectorSurrogate,
)


def test_constants_are_those_of_the_oracles(oracles):
    assert (NOISE, LENGTHSCALE_PRIOR) == (oracles.NOISE, oracles.PRIOR)


def test_likelihood_and_its_slope_are_gpys(oracles):
    oracles.check_likelihood_against_gpy(gaussian_process)
    oracles.check_likelihood_slope_against_differences(gaussian_process)


def test_matern_prediction_is_gpys_and_the_textbooks(oracles):
    oracles.check_matern_prediction_against_gpy(gaussian_process)
    oracles.check_matern_prediction_against_the_textbook(gaussian_process)


def test_posterior_density_is_gpys_at_the_optimal_variance(oracles):
    oracles.check_posterior_density_against_gpy(gaussian_process)


def test_gradient_is_gpys(oracles):
    oracles.check_gradient_against_gpy(gaussian_process)


def test_gradient_is_that_of_the_value(oracles):
    oracles.check_gradient_against_differences(gaussian_process)


def test_prior_is_gpys_log_gaussian(oracles):
    oracles.check_prior_against_gpy(gaussian_process)


def test_signal_variances_are_the_optima_of_gpys_likelihood(oracles):
    oracles.check_variances_are_gpys_optima(gaussian_process)


@pytest.mark.parametrize("factor", [0.9, 0.999, 1.001, 1.1])
def test_gpys_likelihood_falls_off_on_both_sides_of_the_signal_variance(oracles, factor):
    c = oracles.case("9-points-2d")
    posterior = gaussian_process.Posterior(c.Z, c.Y, c.lengthscales)
    for y, q in zip(c.Y.T, posterior.variances, strict=True):

        def log_likelihood(variance, y=y):
            kernel = GPy.kern.RBF(2, variance=variance, lengthscale=c.lengthscales, ARD=True)
            model = GPy.models.GPRegression(c.Z.copy(), y[:, None].copy(), kernel, noise_var=variance * NOISE - 1e-8)
            return model.log_likelihood()

        assert log_likelihood(factor * q) < log_likelihood(q)


def test_prediction_is_gpys(oracles):
    oracles.check_prediction_against_gpy(gaussian_process)


def test_prediction_is_the_textbooks(oracles):
    oracles.check_prediction_against_the_textbook(gaussian_process)


def test_jacobian_is_gpys(oracles):
    oracles.check_jacobian_against_gpy(gaussian_process)


def test_jacobian_is_that_of_the_predicted_mean(oracles):
    oracles.check_jacobian_against_differences(gaussian_process)


def test_prediction_meets_the_data_and_knows_nothing_far_away(oracles):
    c = oracles.case("15-points-4d")
    posterior = gaussian_process.Posterior(c.Z, c.Y, c.lengthscales)
    mean, variance = posterior.predict(np.vstack([c.Z, np.full((1, 4), 60.0)]))
    scale = np.sqrt(posterior.variances)
    # The misfit at a datum is NOISE times alpha, and alpha is at most y over the least eigenvalue, here 1e-5.
    assert_allclose(mean[:-1] / scale, c.Y / scale, atol=1e-3)
    assert np.all(variance[:-1] < 2.0 * NOISE * posterior.variances)
    assert np.all(variance > 0.0)
    assert_allclose(mean[-1], 0.0, atol=1e-12)
    assert_allclose(variance[-1], posterior.variances)


def test_variance_of_repeated_places_is_positive_and_finite():
    """Rows that repeat make the correlation singular but for the noise."""
    Z = np.repeat(np.random.default_rng(0).random((3, 2)), 4, axis=0)
    posterior = gaussian_process.Posterior(Z, Z @ np.array([[1.0], [2.0]]), np.full(2, 5.0))
    mean, variance = posterior.predict(Z)
    assert np.all(variance > 0.0)
    assert_allclose(mean, Z @ np.array([[1.0], [2.0]]), atol=1e-5)


def _smooth(n, seed=0):
    Z = np.random.default_rng(seed).random((n, 2))
    return Z, np.column_stack([np.sin(4.0 * Z[:, 0]) + 0.2 * Z[:, 1], Z[:, 0] * Z[:, 1]]) * 1e3


def _objective(Z, Y, lengthscales, prior=LENGTHSCALE_PRIOR):
    squares = ((Z[:, None] - Z[None]) ** 2).transpose(2, 0, 1)
    return gaussian_process.negative_log_posterior(np.log(lengthscales), Y, squares, *prior)[0]


def test_fit_lowers_the_objective_to_a_minimum():
    Z, Y = _smooth(12)
    vector = VectorSurrogate(2)
    before = _objective(Z, Y, vector.lengthscales)
    vector.fit(Z, Y, max_iterations=100)
    after = _objective(Z, Y, vector.lengthscales)
    assert after < before - 1.0
    for step in np.vstack([np.eye(2), -np.eye(2)]):
        moved = np.clip(vector.lengthscales * np.exp(0.05 * step), *LENGTHSCALE_BOUNDS)
        # L-BFGS-B stops at a slope of 1e-5: at most 1e-6 of the objective is left to a step of 0.05.
        assert _objective(Z, Y, moved) >= after - 1e-6


def test_a_fit_goes_on_from_where_the_last_one_stopped():
    Z, Y = _smooth(12)
    vector = VectorSurrogate(2)
    seen = []
    for _ in range(4):
        vector.fit(Z, Y, max_iterations=2)
        seen.append(_objective(Z, Y, vector.lengthscales))
    assert np.all(np.diff(seen) <= 1e-9)
    assert seen[-1] < seen[0]


def test_fit_writes_the_lengthscales_into_gpys_kernel():
    Z, Y = _smooth(9)
    vector = VectorSurrogate(2)
    assert_allclose(vector.kernel.lengthscale.values, 1.0)
    vector.fit(Z, Y)
    assert not np.allclose(vector.lengthscales, 1.0)
    np.testing.assert_array_equal(vector.kernel.lengthscale.values, vector.lengthscales)
    # And GPy takes them: the kernel's covariance is the correlation in use.
    assert_allclose(vector.kernel.K(Z), gaussian_process.correlation(Z, Z, vector.lengthscales), atol=1e-14)


def test_the_kernel_holds_the_bounds_and_the_prior():
    kernel = VectorSurrogate(3).kernel
    bounds = [c for c in kernel.lengthscale.constraints.properties() if hasattr(c, "lower")]
    assert [(c.lower, c.upper) for c in bounds] == [LENGTHSCALE_BOUNDS]
    priors = list(kernel.lengthscale.priors.properties())
    assert [(type(p), p.mu, p.sigma) for p in priors] == [(GPy.priors.LogGaussian, *LENGTHSCALE_PRIOR)]
    assert kernel.input_dim == 3


def test_lengthscales_stay_inside_the_bounds():
    """A sawtooth of thirteen points wants short lengthscales, a constant long ones."""
    Z = np.column_stack([np.linspace(0.0, 1.0, 13), np.random.default_rng(0).random(13)])
    vector = VectorSurrogate(2)
    vector.fit(Z, 1e3 * np.where(np.arange(13) % 2, 1.0, -1.0)[:, None], max_iterations=100)
    assert_allclose(vector.lengthscales[0], LENGTHSCALE_BOUNDS[0], rtol=1e-12)
    vector.fit(Z, np.full((13, 1), 1e3), max_iterations=100)
    assert np.all(vector.lengthscales > 1.0)
    assert np.all(vector.lengthscales <= LENGTHSCALE_BOUNDS[1] * (1.0 + 1e-15))


def test_fit_uses_the_prior_that_the_kernel_holds():
    """A prior of width 1e-3 at 0.5 leaves the data no say."""
    Z, Y = _smooth(9)
    vector = VectorSurrogate(2)
    vector.kernel.lengthscale.set_prior(GPy.priors.LogGaussian(np.log(0.5), 1e-3), warning=False)
    vector.fit(Z, Y, max_iterations=100)
    assert_allclose(vector.lengthscales, 0.5, rtol=0.02)


def test_fit_and_condition_leave_the_data_alone():
    Z, Y = _smooth(9)
    Z_before, Y_before = Z.copy(), Y.copy()
    vector = VectorSurrogate(2)
    vector.fit(Z, Y)
    vector.condition(Z, Y).predict(Z)
    np.testing.assert_array_equal(Z, Z_before)
    np.testing.assert_array_equal(Y, Y_before)


def test_conditioning_uses_the_fitted_lengthscales():
    Z, Y = _smooth(9)
    vector = VectorSurrogate(2)
    vector.fit(Z, Y)
    Q = np.random.default_rng(1).random((5, 2))
    truth = gaussian_process.Posterior(Z, Y, vector.lengthscales).predict(Q)
    for got, expected in zip(vector.condition(Z, Y).predict(Q), truth, strict=True):
        np.testing.assert_array_equal(got, expected)


def _gpy_at(scalar, Z, y):
    """GPy's regression of y normalised, with the kernel and noise that the surrogate wrote into GPy's objects."""
    normalised = ((y - y.mean()) / y.std())[:, None]
    return GPy.models.GPRegression(Z.copy(), normalised, scalar.kernel.copy(), noise_var=scalar.likelihood.variance[0])


def _noisy(n, seed=0):
    Z, Y = _smooth(n, seed)
    return Z, Y[:, 0] + 300.0 + 30.0 * np.random.default_rng(seed + 1).standard_normal(n)


def test_scalar_surrogate_is_gpys_matern_regression(oracles):
    Z, y = _noisy(14)
    scalar = ScalarSurrogate(2)
    scalar.fit(Z, y)
    assert isinstance(scalar.kernel, GPy.kern.Matern52)
    assert not np.allclose(scalar.kernel.lengthscale.values, 1.0)
    Q = np.random.default_rng(1).random((20, 2))
    mean, variance = scalar.condition(Z, y).predict(Q)
    truth = _gpy_at(scalar, Z, y).predict_noiseless(Q)
    signal = y.std() ** 2 * scalar.kernel.variance[0]
    assert_allclose(mean, y.mean() + y.std() * truth[0][:, 0], rtol=0.0, atol=1e-10 * np.sqrt(signal))
    assert_allclose(variance, y.std() ** 2 * truth[1][:, 0], rtol=0.0, atol=1e-10 * signal)
    textbook = oracles.textbook_matern(
        Z, y, Q, scalar.kernel.variance[0], scalar.kernel.lengthscale.values, scalar.likelihood.variance[0] + 1e-8
    )
    # The noise is at least 1e-6 of the signal: a condition of 1e7 at most, and 1e-16 of rounding.
    assert_allclose(mean, textbook[0], rtol=0.0, atol=1e-7 * y.std())
    assert_allclose(variance, textbook[1], rtol=0.0, atol=1e-7 * signal)


@pytest.mark.parametrize("seed", range(5))
def test_scalar_fit_is_as_likely_as_gpys_own(seed):
    """Both maximise the same likelihood from the same start; GPy in other coordinates, with 200 iterations."""
    Z, y = _noisy(20, seed)
    scalar = ScalarSurrogate(2)
    scalar.fit(Z, y, max_iterations=50)
    own = _gpy_at(ScalarSurrogate(2), Z, y)
    own.Gaussian_noise.variance.constrain_bounded(1e-6, 1.0, warning=False)
    own.optimize("lbfgsb", max_iters=200)
    start = _gpy_at(ScalarSurrogate(2), Z, y).log_likelihood()
    assert own.log_likelihood() > start + 1.0
    assert _gpy_at(scalar, Z, y).log_likelihood() > own.log_likelihood() - 0.05


def test_scalar_fit_goes_on_from_where_it_was_and_forgets_when_told():
    Z, y = _noisy(20)
    scalar = ScalarSurrogate(2)
    likelihoods = []
    for _ in range(4):
        scalar.fit(Z, y, max_iterations=2)
        likelihoods.append(_gpy_at(scalar, Z, y).log_likelihood())
    assert np.all(np.diff(likelihoods) >= -1e-9)
    assert likelihoods[-1] > likelihoods[0]
    mean = scalar.condition(Z, y).predict(Z)[0]
    scalar.forget()
    fresh = ScalarSurrogate(2).condition(Z, y).predict(Z)[0]
    np.testing.assert_array_equal(scalar.condition(Z, y).predict(Z)[0], fresh)
    assert not np.allclose(mean, fresh)


def test_scalar_hyperparameters_stay_inside_their_bounds_and_equal_bounds_fix():
    Z, y = _noisy(20)
    scalar = ScalarSurrogate(2, MaternBounds(noise=(0.3, 0.3), lengthscale=(0.1, 0.15)))
    scalar.fit(Z, y)
    assert_allclose(scalar.likelihood.variance.values, 0.3)
    assert scalar.likelihood.variance.is_fixed
    assert_allclose(scalar.kernel.lengthscale.values, 0.15)  # smooth values want more
    assert not scalar.kernel.lengthscale.is_fixed


def test_scalar_surrogate_of_equal_values_is_finite():
    Z, _ = _noisy(6)
    scalar = ScalarSurrogate(2)
    scalar.fit(Z, np.full(6, 7.0))
    mean, variance = scalar.condition(Z, np.full(6, 7.0)).predict(Z)
    assert_allclose(mean, 7.0, rtol=1e-12)
    assert np.all((variance > 0.0) & np.isfinite(variance))


def test_scalar_surrogate_leaves_the_data_alone():
    Z, y = _noisy(9)
    Z_before, y_before = Z.copy(), y.copy()
    scalar = ScalarSurrogate(2)
    scalar.fit(Z, y)
    scalar.condition(Z, y).predict(Z)
    np.testing.assert_array_equal(Z, Z_before)
    np.testing.assert_array_equal(y, y_before)
