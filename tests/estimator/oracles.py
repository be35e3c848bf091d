"""Comparisons of the estimator's formulas with independent truths: `check_...(module)` raises AssertionError.

The truths are quadrature, Monte Carlo, SciPy's distributions, GPy, finite differences, and the textbook's formula with
a linear solve in fifty decimal digits. A check takes the module, so that it can also be shown a mutant.
"""

from decimal import Decimal, localcontext
from functools import cache
from types import SimpleNamespace

import GPy
import numpy as np
from numpy.testing import assert_allclose
from scipy.integrate import quad, solve_ivp
from scipy.linalg import toeplitz
from scipy.optimize import brentq, least_squares, minimize_scalar
from scipy.signal import lfilter
from scipy.stats import lognorm, multivariate_normal, ncx2, norm

from estimator.samples import Sample

# --- acquisition ---------------------------------------------------------------------------------------------------

EI_CASES = [
    # mean, standard deviation, incumbent
    (0.0, 1.0, 0.0),
    (0.3, 0.5, 1.1),
    (2.0, 0.7, 1.0),
    (-4.0, 3.0, -5.0),
    (1e3, 20.0, 960.0),
    (5e-4, 1e-4, 3e-4),
]
TAIL_CASES = [(4.0, 0.5, 0.0), (10.0, 0.4, 0.0), (0.0, 1.0, 9.0)]
"""8 and 25 standard deviations on the wrong side of the incumbent, 9 on the right one."""


def _columns(cases):
    mean, std, incumbent = np.array(cases).T
    return zip(mean[:, None], std[:, None] ** 2, incumbent, cases, strict=True)


def check_expected_improvement_against_quadrature(acquisition):
    """In standard deviations the integrand is smooth over a range of order one: quad is good to 1e-12."""
    for mean, variance, incumbent, (mu, sigma, b) in _columns(EI_CASES + TAIL_CASES):
        d = (b - mu) / sigma
        peak = max(-d, 0.0)  # the density's largest value where there is an improvement, taken out of the integral
        integral, _ = quad(lambda y, d=d, p=peak: y * np.exp(0.5 * p * p - 0.5 * (y - d) ** 2), 0.0, max(d, 0.0) + 12.0,
                           epsabs=0.0, epsrel=1e-12, limit=200)  # fmt: skip
        truth = sigma * integral * np.exp(-0.5 * peak * peak) / np.sqrt(2.0 * np.pi)
        # At d = -25 two products cancel but for 1/d^2 of them: 1e-16 * 625, and exp(-d^2/2) loses as much.
        assert_allclose(acquisition.expected_improvement(mean, variance, incumbent), truth, rtol=1e-11)


def check_expected_improvement_against_monte_carlo(acquisition):
    draws = np.random.default_rng(1).standard_normal(1_000_000)
    for mean, variance, incumbent, (mu, sigma, b) in _columns(EI_CASES):
        gains = np.maximum(b - (mu + sigma * draws), 0.0)
        # Five standard errors of the draws: a wrong formula is off by tens.
        atol = 5.0 * gains.std() / np.sqrt(len(draws))
        assert_allclose(acquisition.expected_improvement(mean, variance, incumbent), gains.mean(), rtol=0.0, atol=atol)


def check_probability_of_improvement_against_quadrature(acquisition):
    for mean, variance, incumbent, (mu, sigma, b) in _columns(EI_CASES + TAIL_CASES):
        d = (b - mu) / sigma
        peak = min(d, 0.0)
        integral, _ = quad(lambda t, p=peak: np.exp(0.5 * p * p - 0.5 * t * t), min(d, 0.0) - 12.0, d, epsrel=1e-12)
        truth = integral * np.exp(-0.5 * peak * peak) / np.sqrt(2.0 * np.pi)
        assert_allclose(acquisition.probability_of_improvement(mean, variance, incumbent), truth, rtol=1e-10)


def check_lower_confidence_bound_is_a_quantile(acquisition):
    """The bound is exceeded with the probability that kappa standard deviations have."""
    for mean, variance, _, (mu, sigma, _) in _columns(EI_CASES):
        for kappa in (0.5, 2.0, 3.0):
            quantile = norm.ppf(norm.cdf(-kappa), mu, sigma)
            assert_allclose(-acquisition.lower_confidence_bound(mean, variance, kappa), quantile, rtol=1e-12)


def _sum_of_squares(mean, std):
    """Mean and variance of sum h_j^2, h_j ~ N(mean_j, std_j^2): h_j^2 / std_j^2 is noncentral chi-square."""
    m, v = ncx2.stats(1, (mean / std) ** 2, moments="mv")
    return float(np.sum(m * std**2)), float(np.sum(v * std**4))


def _log_normal_with(mean, variance):
    """SciPy's log-normal of these moments, its shape found by solving for the variance."""

    def surplus(s):
        return np.log(lognorm.var(s) / lognorm.mean(s) ** 2) - np.log(variance / mean**2)

    s = brentq(surplus, 1e-6, 3.0, xtol=1e-15, rtol=1e-14)
    return lognorm(s, scale=mean / lognorm.mean(s))


def _log_improvement(distribution, b):
    """log E[max(b - S, 0)] = log of the integral of the distribution function up to b, far into the tail."""
    at_b = float(distribution.logcdf(b))
    integral, _ = quad(lambda u: np.exp(u + distribution.logcdf(b * np.exp(u)) - at_b), -40.0, 0.0,
                       points=(-3.0, -1.0, -0.3, -0.1, -0.03, -0.01), epsabs=0.0, epsrel=1e-11, limit=400)  # fmt: skip
    return np.log(b) + at_b + np.log(integral)


VECTOR_CASES = [
    # means and standard deviations of the channels
    ((1.0, -0.5), (0.2, 0.1)),
    ((0.3, 0.1, -0.2), (0.5, 0.05, 1.0)),
    ((0.0, 0.0), (1.0, 0.3)),
    ((20.0, -3.0, 1.0, 0.5), (2.0, 1.0, 0.2, 0.01)),
]


def check_target_vector_improvement_is_that_of_the_matched_log_normal(acquisition):
    for mean, std in VECTOR_CASES:
        mean, std = np.array(mean), np.array(std)
        matched = _log_normal_with(*_sum_of_squares(mean, std))
        for probability in (1e-4, 0.01, 0.1, 0.5, 0.9, 0.9999):
            b = float(matched.ppf(probability))
            got = acquisition.log_target_vector_improvement(mean[None], std[None] ** 2, b)
            # Where P = 1e-4 the improvement is 1e-6 of the products it is the difference of; SciPy's moments give 1e-9.
            assert_allclose(got, _log_improvement(matched, b), rtol=0.0, atol=1e-7)


def check_target_vector_improvement_far_in_the_tail(acquisition):
    """The same out to d = -200, where a rounding of s is multiplied by d^2. Measured 1e-8."""
    for mean, std in (((1.0, -0.5), (0.2, 0.1)), ((1.0, 1.0, -2.0), (0.01, 0.02, 0.02)), ((3.0,), (0.01,))):
        mean, std = np.array(mean), np.array(std)
        matched = _log_normal_with(*_sum_of_squares(mean, std))
        s = matched.args[0]
        for depth in (15.0, 40.0, 200.0):
            b = float(matched.median() * np.exp(-depth * s))
            got = acquisition.log_target_vector_improvement(mean[None], std[None] ** 2, b)
            assert_allclose(got, _log_improvement(matched, b), rtol=0.0, atol=1e-7)


def check_target_vector_improvement_of_a_hopeless_incumbent(acquisition):
    """Where every outcome is an improvement, its expectation is b minus the mean of the sum of squares, exactly."""
    draws = np.random.default_rng(3).standard_normal((200_000, 4))
    for mean, std in VECTOR_CASES:
        mean, std = np.array(mean), np.array(std)
        S = np.sum((mean + std * draws[:, : len(mean)]) ** 2, axis=1)
        b = 3.0 * float(S.max())
        got = np.exp(acquisition.log_target_vector_improvement(mean[None], std[None] ** 2, b))
        # Five standard errors, and 1e-3 of b for the log-normal's heavier upper tail.
        assert_allclose(got, b - S.mean(), rtol=1e-3, atol=5.0 * S.std() / np.sqrt(len(S)))


def check_target_vector_improvement_of_small_variances(acquisition):
    """Where every channel is known to 3e-4 of itself, the sum of squares is normal, and its improvement known."""
    for mean in ((1.0,), (1.0, -0.5), (3.0, 2.0, -5.0)):
        mean = np.array(mean)
        std = 3e-4 * np.abs(mean) * np.arange(1, len(mean) + 1) / len(mean)
        sigma = np.linalg.norm(2.0 * mean * std)
        for d in (-2.0, 0.0, 1.5):
            b = float(mean @ mean + d * sigma)
            integral, _ = quad(lambda y, d=d: y * norm.pdf(d - y), 0.0, max(d, 0.0) + 12.0, epsrel=1e-12)
            got = np.exp(acquisition.log_target_vector_improvement(mean[None], std[None] ** 2, b))
            # Skewness is of order std/mean; ten times that where d = -2. Measured 0.4 %.
            assert_allclose(got, sigma * integral, rtol=0.01)


# --- gaussian_process ----------------------------------------------------------------------------------------------

NOISE = 1e-8
PRIOR = (0.0, 0.7)
SIZES = {
    # n, d, k, lengthscale: conditions of C + 1e-8 I from 4e2 to 4e6, where 1e-16 of rounding leaves 1e-10
    "5-points-1d": (5, 1, 1, 0.2),
    "9-points-2d": (9, 2, 2, 0.4),
    "15-points-4d": (15, 4, 3, 2.0),
    "25-points-4d": (25, 4, 3, 1.5),
}


@cache
def case(name):
    """Places, outputs and lengthscales; outputs of 1e3 and more, so that q NOISE is far above GPy's 1e-8."""
    n, d, k, lengthscale = SIZES[name]
    rng = np.random.default_rng(n)
    Z, W = rng.random((n, d)), rng.normal(size=(d, k))
    Y = (np.sin(2.0 * Z @ W) + 0.3 * (Z @ W) ** 2 + Z[:, :1]) * 10.0 ** rng.uniform(3.0, 5.0, k)
    lengthscales = lengthscale * np.exp(rng.uniform(-0.2, 0.2, d))
    return SimpleNamespace(
        Z=Z,
        Y=Y,
        lengthscales=lengthscales,
        squares=((Z[:, None] - Z[None]) ** 2).transpose(2, 0, 1).copy(),
        Q=np.vstack([rng.random((8, d)), Z[:1], 0.5 * (Z[:1] + Z[1:2]), np.full((1, d), 1.5)]),
    )


def gpy_at_its_optimal_variance(Z, y, lengthscales):
    """GPy's regression of one output with a noise NOISE times the signal, the variance where its slope is nil.

    GPy's exact inference adds 1e-8 to the diagonal by itself.
    """
    kernel = GPy.kern.RBF(Z.shape[1], variance=1.0, lengthscale=lengthscales, ARD=True)
    model = GPy.models.GPRegression(Z.copy(), y[:, None].copy(), kernel)

    def slope(log_variance):
        variance = np.exp(log_variance)
        model.kern.variance = variance
        model.Gaussian_noise.variance = variance * NOISE - 1e-8
        return variance * float(model.kern.variance.gradient[0] + NOISE * model.Gaussian_noise.variance.gradient[0])

    guess = np.log(np.mean(y * y))
    slope(brentq(slope, guess - 12.0, guess + 12.0, xtol=1e-14, rtol=1e-14))
    return model


@cache
def gpy_models(name):
    c = case(name)
    return [gpy_at_its_optimal_variance(c.Z, y, c.lengthscales) for y in c.Y.T]


def _value(gp, c, log_lengthscales, prior=PRIOR):
    return gp.negative_log_posterior(log_lengthscales, c.Y, c.squares, *prior)


def check_posterior_density_against_gpy(gp):
    for name in SIZES:
        c = case(name)
        prior = GPy.priors.LogGaussian(*PRIOR)
        truth = -sum(m.log_likelihood() for m in gpy_models(name)) - float(np.sum(prior.lnpdf(c.lengthscales)))
        assert_allclose(_value(gp, c, np.log(c.lengthscales))[0], truth, rtol=1e-10)


def check_gradient_against_gpy(gp):
    """At the variance's optimum its own slope is nil, so the slope in the lengthscales is the partial one."""
    for name in SIZES:
        c = case(name)
        prior = GPy.priors.LogGaussian(*PRIOR)
        slope = -sum(m.kern.lengthscale.gradient for m in gpy_models(name)) - prior.lnpdf_grad(c.lengthscales)
        truth = slope * c.lengthscales
        got = _value(gp, c, np.log(c.lengthscales))[1]
        assert_allclose(got, truth, rtol=0.0, atol=1e-10 * np.abs(truth).max())


def check_gradient_against_differences(gp):
    """Differences of fourth order with a step of 2e-3: truncation 1e-10, rounding 1e-12 of the value over the step."""
    for name in SIZES:
        c = case(name)
        at = np.log(c.lengthscales)
        for prior in (PRIOR, (0.4, 0.2)):
            truth = differences(lambda p, c=c, prior=prior: _value(gp, c, p, prior)[0], at, 2e-3)
            got = _value(gp, c, at, prior)[1]
            assert_allclose(got, truth, rtol=0.0, atol=1e-7 * np.abs(truth).max())


def check_prior_against_gpy(gp):
    """Two priors apart, the likelihood drops out."""
    c = case("9-points-2d")
    for log_lengthscales in (np.array([0.3, -0.7]), np.array([-1.2, 1.1])):
        lengthscales = np.exp(log_lengthscales)
        one, other = (0.0, 0.7), (0.5, 0.3)
        (a, da), (b, db) = (_value(gp, c, log_lengthscales, prior) for prior in (one, other))
        p, q = GPy.priors.LogGaussian(*one), GPy.priors.LogGaussian(*other)
        # The likelihoods of both, of order 1e2 and slopes of 1e3, cancel to 1e-10.
        assert_allclose(b - a, np.sum(p.lnpdf(lengthscales) - q.lnpdf(lengthscales)), rtol=1e-9)
        truth = (p.lnpdf_grad(lengthscales) - q.lnpdf_grad(lengthscales)) * lengthscales
        assert_allclose(db - da, truth, rtol=1e-8)


def check_variances_are_gpys_optima(gp):
    for name in SIZES:
        c = case(name)
        truth = [float(m.kern.variance[0]) for m in gpy_models(name)]
        assert_allclose(gp.Posterior(c.Z, c.Y, c.lengthscales).variances, truth, rtol=1e-9)


def check_prediction_against_gpy(gp):
    for name in SIZES:
        c = case(name)
        posterior = gp.Posterior(c.Z, c.Y, c.lengthscales)
        mean, variance = posterior.predict(c.Q)
        for j, model in enumerate(gpy_models(name)):
            q = float(model.kern.variance[0])
            m, v = model.predict_noiseless(c.Q)
            assert_allclose(mean[:, j], m[:, 0], rtol=0.0, atol=1e-10 * np.sqrt(q))
            assert_allclose(variance[:, j], v[:, 0], rtol=0.0, atol=1e-10 * q)


@cache
def textbook_posterior(name):
    """K^-1 y and c^T K^-1 c by Gauss' elimination in fifty digits; Rasmussen and Williams (2006), eqs 2.25, 2.26."""
    c = case(name)
    n, k = c.Y.shape
    with localcontext() as context:
        context.prec = 50

        def exact(table):
            return [[Decimal(float(x)) for x in row] for row in np.atleast_2d(table)]

        Z, Q, Y, lengthscales = exact(c.Z), exact(c.Q), exact(c.Y), exact(c.lengthscales)[0]

        def correlation(a, b):
            scaled = ((x - y) / l for x, y, l in zip(a, b, lengthscales, strict=True))
            return (-sum(x * x for x in scaled) / 2).exp()

        across = [[correlation(z, place) for place in Q] for z in Z]
        rows = [[correlation(a, b) + (Decimal(NOISE) if a is b else 0) for b in Z] + Y[i] + across[i]
                for i, a in enumerate(Z)]  # fmt: skip
        for i in range(n):
            rows[i] = [x / rows[i][i] for x in rows[i]]
            for j in range(n):
                if j != i:
                    rows[j] = [x - rows[j][i] * y for x, y in zip(rows[j], rows[i], strict=True)]
        alpha = [row[n : n + k] for row in rows]
        solved = [row[n + k :] for row in rows]

        def products(a, b):
            return [sum(x * y for x, y in zip(u, v, strict=True)) for u, v in zip(zip(*a), zip(*b))]

        signal = np.array([float(q / n) for q in products(Y, alpha)])
        unit = np.array([float(1 - p) for p in products(across, solved)])
        mean = np.array([
            [float(sum(a[p] * b[j] for a, b in zip(across, alpha))) for j in range(k)] for p in range(len(Q))
        ])  # fmt: skip
    return mean, unit[:, None] * signal, signal


def check_prediction_against_the_textbook(gp):
    for name in SIZES:
        c = case(name)
        mean, variance, signal = textbook_posterior(name)
        posterior = gp.Posterior(c.Z, c.Y, c.lengthscales)
        got_mean, got_variance = posterior.predict(c.Q)
        assert_allclose(posterior.variances, signal, rtol=1e-10)
        assert_allclose(got_mean / np.sqrt(signal), mean / np.sqrt(signal), rtol=0.0, atol=1e-10)
        assert_allclose(got_variance / signal, variance / signal, rtol=0.0, atol=1e-10)


def check_jacobian_against_gpy(gp):
    for name in SIZES:
        c = case(name)
        posterior = gp.Posterior(c.Z, c.Y, c.lengthscales)
        for j, model in enumerate(gpy_models(name)):
            truth, _ = model.predict_jacobian(c.Q)
            got = np.array([posterior.mean_and_jacobian(z)[1][j] for z in c.Q])
            assert_allclose(got, truth[:, :, 0], rtol=0.0, atol=1e-10 * np.abs(truth).max())


def check_jacobian_against_differences(gp):
    """The slope of the mean that `predict` gives; fourth order, step 1e-3 of the cube."""
    for name in SIZES:
        c = case(name)
        posterior = gp.Posterior(c.Z, c.Y, c.lengthscales)
        for z in c.Q[:4]:
            truth = differences(lambda p, posterior=posterior: posterior.predict(p[None])[0][0], z, 1e-3)
            mean, got = posterior.mean_and_jacobian(z)
            assert_allclose(mean, posterior.predict(z[None])[0][0], rtol=0.0, atol=1e-10 * np.abs(c.Y).max())
            scale = np.abs(truth).max(axis=1, keepdims=True)
            assert_allclose(got / scale, truth / scale, rtol=0.0, atol=2e-6)


def differences(f, at, h):
    """Central differences of fourth order (..., d) of f at (d,)."""
    columns = []
    for e in h * np.eye(len(at)):
        columns.append((8.0 * (f(at + e) - f(at - e)) - (f(at + 2.0 * e) - f(at - 2.0 * e))) / (12.0 * h))
    return np.stack(columns, axis=-1)


def textbook_matern(Z, y, Q, variance, lengthscales, noise):
    """Mean and variance of a Matern-5/2 regression of y centred and scaled to one, by explicit inverse."""

    def covariance(A, B):
        s = np.sqrt(5.0) * np.linalg.norm((A[:, None] - B[None]) / lengthscales, axis=2)
        return variance * (1.0 + s + s**2 / 3.0) * np.exp(-s)

    inverse = np.linalg.inv(covariance(Z, Z) + noise * np.eye(len(Z)))
    across = covariance(Q, Z)
    mean = y.mean() + y.std() * across @ inverse @ ((y - y.mean()) / y.std())
    return mean, y.std() ** 2 * (variance - np.einsum("ij,jk,ik->i", across, inverse, across))


MATERN_SIZES = {"6-points-1d": (6, 1), "12-points-2d": (12, 2), "30-points-4d": (30, 4)}


@cache
def matern_model(name):
    """GPy's Matern-5/2 regression of normalised values at given hyperparameters, and the places to predict at."""
    n, d = MATERN_SIZES[name]
    rng = np.random.default_rng(100 + n)
    Z = rng.random((n, d))
    y = np.sin(3.0 * Z @ rng.normal(size=d)) + 0.1 * rng.normal(size=n)
    variance, noise = np.exp(rng.normal(size=2) * (0.5, 1.0) + (0.3, -4.0))
    kernel = GPy.kern.Matern52(d, ARD=True, variance=variance, lengthscale=np.exp(rng.normal(size=d) * 0.5))
    model = GPy.models.GPRegression(Z.copy(), ((y - y.mean()) / y.std())[:, None], kernel, noise_var=noise)
    return model, np.vstack([rng.random((8, d)), Z[:2], np.full((1, d), 1.7)])


def _matern_arguments(model):
    Z = np.array(model.X)
    hyperparameters = np.concatenate([model.kern.variance, model.Gaussian_noise.variance, model.kern.lengthscale])
    return np.log(hyperparameters), np.array(model.Y)[:, 0], ((Z[:, None] - Z[None]) ** 2).transpose(2, 0, 1).copy()


def check_likelihood_against_gpy(gp):
    for name in MATERN_SIZES:
        model, _ = matern_model(name)
        value, slope = gp.negative_log_likelihood(*_matern_arguments(model))
        assert_allclose(value, -model.log_likelihood(), rtol=1e-10)
        hyperparameters = np.exp(_matern_arguments(model)[0])
        partial = [
            model.kern.variance.gradient,
            model.Gaussian_noise.variance.gradient,
            model.kern.lengthscale.gradient,
        ]
        truth = -np.concatenate(partial) * hyperparameters
        assert_allclose(slope, truth, rtol=0.0, atol=1e-10 * np.abs(truth).max())


def check_likelihood_slope_against_differences(gp):
    for name in MATERN_SIZES:
        at, y, squares = _matern_arguments(matern_model(name)[0])
        truth = differences(lambda p, y=y, s=squares: gp.negative_log_likelihood(p, y, s)[0], at, 2e-3)
        got = gp.negative_log_likelihood(at, y, squares)[1]
        assert_allclose(got, truth, rtol=0.0, atol=1e-7 * np.abs(truth).max())


def check_matern_prediction_against_gpy(gp):
    for name in MATERN_SIZES:
        model, Q = matern_model(name)
        log_hyperparameters, y, _ = _matern_arguments(model)
        variance, noise, *lengthscales = np.exp(log_hyperparameters)
        got = gp.MaternPosterior(np.array(model.X), y, variance, noise, np.array(lengthscales)).predict(Q)
        for a, b in zip(got, model.predict_noiseless(Q), strict=True):
            assert_allclose(a, b[:, 0], rtol=0.0, atol=1e-10 * variance)


def check_matern_prediction_against_the_textbook(gp):
    for name in MATERN_SIZES:
        model, Q = matern_model(name)
        log_hyperparameters, y, _ = _matern_arguments(model)
        variance, noise, *lengthscales = np.exp(log_hyperparameters)
        Z, lengthscales = np.array(model.X), np.array(lengthscales)
        got = gp.MaternPosterior(Z, y, variance, noise, lengthscales).predict(Q)
        # Values normalised already: the textbook's own normalisation does nothing to them.
        truth = textbook_matern(Z, y, Q, variance, lengthscales, noise + 1e-8)
        for a, b in zip(got, truth, strict=True):
            assert_allclose(a, b, rtol=0.0, atol=1e-9)


# --- identifiability -----------------------------------------------------------------------------------------------


def check_std_against_the_covariance_of_least_squares(identifiability):
    """Standard deviations of a linear model with unit noise: the roots of diag (X^T X)^-1."""
    rng = np.random.default_rng(0)
    for n, d in ((3, 1), (8, 2), (30, 4)):
        X = 20.0 * rng.normal(size=(n, d)) * 10.0 ** rng.uniform(0.0, 1.0, d)
        truth = np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
        assert_allclose(identifiability.information(X).std(), truth, rtol=1e-9)


def check_std_against_refits_of_noisy_data(identifiability):
    rng = np.random.default_rng(1)
    X = 10.0 * rng.normal(size=(6, 2))
    fits = np.linalg.lstsq(X, rng.standard_normal((6, 40_000)), rcond=None)[0]
    # The standard deviation of 40 000 draws has a relative error of 1/sqrt(80 000) = 0.35 %: five of those.
    assert_allclose(identifiability.information(X).std(), fits.std(axis=1), rtol=0.018)


def check_std_of_what_is_not_seen_is_the_whole_cube(identifiability):
    # The sum of two is measured, never their difference: sqrt(1/2)/1e-12 and more, cut at the bounds.
    assert_allclose(identifiability.information(np.array([[50.0, 50.0]])).std(), [1.0, 1.0])
    # A parameter of its own, and one that does nothing.
    assert_allclose(identifiability.information(np.array([[40.0, 0.0], [30.0, 0.0]])).std(), [0.02, 1.0])
    assert_allclose(identifiability.information(np.zeros((3, 2))).std(), [1.0, 1.0])
    # Weak but real: half the cube.
    assert_allclose(identifiability.information(np.diag([2.0, 0.5])).std(), [0.5, 1.0])


def check_covariance_with_a_prior_is_that_of_the_normal_equations(identifiability):
    rng = np.random.default_rng(5)
    for n in (1, 2, 5):
        X = 30.0 * rng.normal(size=(n, 3))
        expected = np.linalg.inv(X.T @ X + np.eye(3) / 0.05**2)
        assert_allclose(identifiability.information(X).covariance(0.05), expected, rtol=1e-9, atol=1e-15)


def check_distance_is_that_of_the_inverse_covariance(identifiability):
    rng = np.random.default_rng(6)
    for _ in range(3):
        X, change = 30.0 * rng.normal(size=(5, 3)), rng.normal(size=3)
        covariance = np.linalg.inv(X.T @ X)
        expected = np.sqrt(change @ np.linalg.solve(covariance, change))
        assert_allclose(identifiability.information(X).distance(change), expected, rtol=1e-9)


def check_least_moved_is_the_mean_given_the_parameters_held(identifiability):
    """The conditional mean of a normal distribution, and Mahalanobis' distance of what is held: Anderson (1984)."""
    rng = np.random.default_rng(7)
    n_held = set()
    for d, n in ((2, 6), (4, 9), (4, 2), (6, 30)):
        for _ in range(20):
            X = rng.normal(size=(n, d)) * 10.0 ** rng.uniform(0.5, 2.0, d)
            P = np.linalg.inv(X.T @ X + np.eye(d))
            std = np.sqrt(np.diag(P))
            change = rng.normal(size=d) * std * 2.0
            held, distance = np.array([], dtype=int), 0.0
            for i in np.argsort(np.abs(change) / std):
                more = np.append(held, i)
                further = change[more] @ np.linalg.inv(P[np.ix_(more, more)]) @ change[more]
                if further - distance > 1.5**2:
                    break
                held, distance = more, further
            expected = change - P[:, held] @ np.linalg.inv(P[np.ix_(held, held)]) @ change[held]
            found = identifiability.information(X).least_moved(change, 1.5)
            assert_allclose(found / std, expected / std, atol=1e-7)
            assert not found[held].any()
            n_held.add(len(held))
    assert n_held >= {0, 1, 2, 3, 4}


def check_least_moved_of_parameters_that_are_known_to_rounding(identifiability):
    """Two parameters move where their sum, known to 1e-12, or their difference, known to a tenth, asks for it."""
    both = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2.0)
    seen = identifiability.Information(np.array([1e12, 10.0]), both)
    assert_allclose(seen.least_moved(np.array([0.3, -0.3]), 1.0), [0.3, -0.3], rtol=1e-9)
    assert_allclose(seen.least_moved(np.array([0.01, -0.01]), 1.0), 0.0)
    assert_allclose(seen.least_moved(np.array([0.02, 0.0]), 1.0), [0.02, 0.0], atol=1e-9)


def projector(seen, change, n_std):
    """On the significant directions, from their rows."""
    rows = seen.significant(change, n_std)
    return rows.T @ rows


def check_significant_directions_by_hand(identifiability):
    straight = identifiability.information(np.diag([10.0, 1.0]))
    # (1, 1) is 10 standard deviations along the first axis and one along the second.
    assert_allclose(projector(straight, np.array([1.0, 1.0]), 3.0), np.diag([1.0, 0.0]), atol=1e-15)
    assert_allclose(projector(straight, np.array([1.0, -4.0]), 3.0), np.eye(2), atol=1e-15)
    assert_allclose(projector(straight, np.array([0.2, 0.2]), 3.0), np.zeros((2, 2)), atol=1e-15)
    assert_allclose(projector(straight, np.array([0.2, 0.2]), 1.0), np.diag([1.0, 0.0]), atol=1e-15)
    # Only the sum is seen: the projector averages, along (1, 1)/sqrt(2).
    oblique = identifiability.information(np.array([[10.0, 10.0]]))
    assert_allclose(projector(oblique, np.array([1.0, 0.0]), 3.0), np.full((2, 2), 0.5), atol=1e-14)
    assert_allclose(projector(oblique, np.array([1.0, -1.0]), 3.0), np.zeros((2, 2)), atol=1e-14)


def check_significant_is_a_projector_that_loses_little(identifiability):
    rng = np.random.default_rng(2)
    for n, d in ((2, 4), (6, 3), (12, 4)):
        for _ in range(20):
            J = rng.normal(size=(n, d)) * 10.0 ** rng.uniform(-1.0, 2.0, d)
            change = rng.uniform(-1.0, 1.0, d)
            seen = identifiability.information(J)
            rows = seen.significant(change, 3.0)
            assert_allclose(rows @ rows.T, np.eye(len(rows)), atol=1e-12)
            P = rows.T @ rows
            assert_allclose(P @ P, P, atol=1e-12)
            assert_allclose(P.T, P, atol=1e-12)
            # Each direction kept back would have moved the residual by at most three standard deviations ...
            lost = float(np.linalg.norm(J @ (change - P @ change)))
            assert_allclose(max(lost - 3.0 * np.sqrt(d), 0.0), 0.0, atol=1e-9)
            # ... and each one let through moves it by more, at right angles to the others.
            moved = float(np.linalg.norm(J @ P @ change))
            assert_allclose(max(3.0 * np.sqrt(np.trace(P)) - moved, 0.0), 0.0, atol=1e-9)
            assert_allclose(moved**2 + lost**2, np.sum((J @ change) ** 2), rtol=1e-9)


# --- diagnosis -----------------------------------------------------------------------------------------------------


def check_score_is_the_evidence_of_a_linear_model(hypotheses):
    """Schwarz (1978): y = m + e with m ~ N(0, 1) is y ~ N(0, I + 1 1^T); the difference is m^2 and of order 1/n."""
    n = 400
    y = np.random.default_rng(n).standard_normal(n)
    C = np.eye(n) + np.ones((n, n))
    evidence = y @ np.linalg.solve(C, y) + np.linalg.slogdet(C)[1]
    fit = hypotheses.plain_fit((y - y.mean())[:, None], 1)
    assert_allclose(fit.score, evidence, rtol=0.0, atol=0.1)


def check_margins_are_very_strong_evidence(hypotheses):
    """Kass and Raftery (1995): from 10 on. Where a rival's score is that much more, and that much less, it tips."""
    fit = hypotheses.Fit(20.0, 2, 20)
    awful = hypotheses.Fit(1e6, 0, 20)
    verdicts = (("are_parameters_certain", 20.0), ("are_parameters_proven", 10.0), ("are_parameters_possible", -10.0))
    for verdict, tips_at in verdicts:
        for order in (1, -1):
            low, high = -50.0, 50.0
            while high - low > 1e-9:
                middle = 0.5 * (low + high)
                rivals = (hypotheses.Fit(fit.score + middle, 0, 20), awful)[::order]
                is_so = getattr(hypotheses.Weighing(fit, *rivals), verdict)
                low, high = (low, middle) if is_so else (middle, high)
            assert_allclose(high, tips_at, atol=1e-6)
    noises = [hypotheses.Fit(fit.score + lead, 0, 20) for lead in (19.9, 20.1)]
    are_certain = [hypotheses.Weighing(fit, awful, awful, noise=noise).are_parameters_certain for noise in noises]
    assert_allclose(are_certain, [False, True])


def check_disturbance_against_least_squares(hypotheses):
    rng = np.random.default_rng(3)
    t = np.arange(12)
    for order in (0, 1, 2):
        rows = rng.standard_normal((12, 2)) + np.outer(t**order, [30.0, -20.0])
        design = t[:, None] ** np.arange(order + 1)
        best = design @ np.linalg.lstsq(design, rows, rcond=None)[0]
        found = hypotheses.disturbance_of(rows)
        assert_allclose(found.newest, best[-1], rtol=1e-9)
        assert_allclose(found.largest, np.abs(best).max(axis=0), rtol=1e-9)
        assert_allclose(found.fit.squares, np.sum((rows - best) ** 2), rtol=1e-7)


def check_arriving_inputs_against_integration(input_lag):
    """A lag by DOP853, the input held up to each of unevenly spaced times; a dead time by counting."""
    rng = np.random.default_rng(6)
    times, inputs, start = np.cumsum(rng.uniform(0.02, 0.1, 25)), rng.standard_normal((25, 2)), np.array([0.7, -1.3])
    lags = [input_lag.Lag(0.04), input_lag.Lag(0.5), input_lag.Lag(n_late=3)]
    made = input_lag.arriving(lags, times, inputs, start)
    for lag, of in zip(lags[:2], made[:2], strict=True):
        v = start
        for k in range(1, 25):
            slope = lambda _, y, u=inputs[k], tau=lag.time_constant: (u - y) / tau  # noqa: E731
            v = solve_ivp(slope, times[k - 1 : k + 1], v, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
            assert_allclose(of[k], v, rtol=1e-7, atol=1e-9)
    assert_allclose(made[2], [*[start] * 3, *inputs[:22]])


def check_inputs_of_limited_rates_against_small_steps(lag):
    """Towards the input that is held, by 2000 small steps an interval; the second one is not limited."""
    rng = np.random.default_rng(8)
    times, inputs, start = np.cumsum(rng.uniform(0.02, 0.1, 25)), rng.standard_normal((25, 2)), np.array([0.7, -1.3])
    (made,) = lag.arriving([lag.Lag(rates=(12.0, np.inf))], times, inputs, start)
    v = start[0]
    for k in range(1, 25):
        most = 12.0 * (times[k] - times[k - 1]) / 2000
        for _ in range(2000):
            v += np.sign(inputs[k, 0] - v) * min(most, abs(inputs[k, 0] - v))
        assert_allclose(made[k, 0], v, atol=1e-9)
    assert_allclose(made[1:, 1], inputs[1:, 1])


def check_means_over_steps_against_small_steps(lag):
    """Check the means of a lag, a limited rate and a dead time by the trapezoidal rule over 2000 steps an interval."""
    rng = np.random.default_rng(12)
    times, inputs, start = np.cumsum(rng.uniform(0.02, 0.1, 25)), rng.standard_normal((25, 2)), np.array([0.7, -1.3])
    lags = [lag.Lag(0.04), lag.Lag(rates=(12.0, np.inf)), lag.Lag(n_late=3)]
    made = lag.arriving(lags, times, inputs, start)
    means = lag.step_means(lags, times, inputs, made)
    assert_allclose(means[:, 0], made[:, 0])
    assert_allclose(means[2], made[2])
    assert_allclose(means[1, 1:, 1], inputs[1:, 1])
    for k in range(1, 25):
        dt = (times[k] - times[k - 1]) / 2000
        slow, limited = [made[0, k - 1]], [made[1, k - 1, 0]]
        for _ in range(2000):
            slow.append(inputs[k] + (slow[-1] - inputs[k]) * np.exp(-dt / 0.04))
            limited.append(limited[-1] + np.clip(inputs[k, 0] - limited[-1], -12.0 * dt, 12.0 * dt))
        assert_allclose(means[0, k], np.trapezoid(slow, dx=1.0 / 2000, axis=0), atol=1e-5)
        assert_allclose(means[1, k, 0], np.trapezoid(limited, dx=1.0 / 2000), atol=1e-5)
    both = lag.step_means(lags, times, inputs, np.stack([made, 2.0 * made], axis=1))
    assert_allclose(both[:, 0], means)


def check_limits_against_a_grid(input_limits):
    """Upper and lower limits are the best of a grid; the slope by the input changes, and the noise is not small."""
    rng = np.random.default_rng(9)
    sent, slope = np.sin(0.37 * np.arange(40)), 1.0 + 2.0 * rng.random(40)
    grid = np.arange(0.4, 0.8, 1e-4)
    for sign in (1.0, -1.0):
        arrived = sign * np.minimum(sign * sent, 0.6)
        measured = slope * arrived + 0.1 * rng.standard_normal(40)

        def rows_with(arrives, measured=measured):
            return ((measured[:, None] - slope[:, None] * arrives) / 0.1)[..., :1]

        (limits,) = input_limits.InputLimits(rows_with, sent[:, None], [0]).best().limits.values()
        squares = [np.sum(rows_with((sign * np.minimum(sign * sent, c))[:, None]) ** 2) for c in grid]
        assert_allclose(limits, (-np.inf, grid[np.argmin(squares)])[:: int(sign)] * np.array(sign), atol=2e-4)


def check_fading_is_what_is_left_of_the_start(input_lag):
    """The difference of two ways from different starts, which the model is linear in."""
    times = np.cumsum(np.random.default_rng(7).uniform(0.02, 0.1, 12))
    for lag in (input_lag.Lag(0.2), input_lag.Lag(n_late=4)):
        ways = [input_lag.arriving([lag], times, np.ones((12, 1)), np.array([start]))[0, :, 0] for start in (0.0, 1.0)]
        assert_allclose(lag.fading(times), ways[1] - ways[0], atol=1e-12)


def two_joints(x, u):
    """Accelerations of two coupled joints without friction: the inverse of an inertia matrix, times the torques."""
    inertia = np.array([[3.0 + np.cos(x[1]), 1.0 + 0.5 * np.cos(x[1])], [1.0 + 0.5 * np.cos(x[1]), 1.0]])
    return np.linalg.solve(inertia, np.array(u) - [9.0 * np.sin(x[0]), 4.0 * np.sin(x[0] + x[1])])


JOINT_NOISE = 0.01


def samples_of_joints(torques=lambda w: np.zeros(2), drag=lambda w: np.zeros(2), n=40, seed=11):
    """Samples of the joints, whose drives rub with torques(w), and which the air brakes with drag(w)."""
    rng = np.random.default_rng(seed)
    for k in range(n):
        x, u = [*rng.uniform(-1.0, 1.0, 2), *rng.uniform(-3.0, 3.0, 2)], rng.uniform(-8.0, 8.0, 2)
        w = np.array(x[2:])
        xdot = two_joints(x, u - torques(w)) - drag(w) + JOINT_NOISE * rng.standard_normal(2)
        yield Sample(0.05 * k, tuple(map(float, x)), tuple(u.tolist()), tuple(xdot.tolist()))


def joint_residuals(samples):
    """Residuals (n, 2) in standard deviations; 0 where nothing was sampled."""
    rows = np.array([np.array(s.xdot) - two_joints(s.x, s.u) for s in samples]) / JOINT_NOISE
    return np.where(np.isnan(rows), 0.0, rows)


def friction_sizes(found):
    """Coefficients by law, velocity, and place: on the derivative, at the first input, at the second."""
    sizes = np.zeros((3, 2, 3))
    for term in found.terms:
        place = 0 if term.at_input is None else 1 + term.at_input
        sizes[("viscous", "dry", "quadratic").index(term.law), term.velocity - 2, place] = term.coefficient
    return sizes


def assert_only_noise_is_left(found, samples, constant=0.0):
    """Mean square of the residuals: its expected value is one, its deviation sqrt(2 / 80) at most."""
    left = joint_residuals([found.without(s) for s in samples])
    assert_allclose(np.mean((left - (left != 0.0) * constant) ** 2), np.mean(left != 0.0), rtol=0.5)


def check_friction_in_drives_is_found_and_taken_out(friction):
    """Two torques, each by a law of its own."""
    samples = [*samples_of_joints(torques=lambda w: np.array([0.8 * w[0], 0.3 * w[1] * abs(w[1])]))]
    found = friction.find_friction(joint_residuals, samples, (2, 3)).friction
    expected = np.zeros((3, 2, 3))
    expected[0, 0, 1], expected[2, 1, 2] = 0.8, 0.3
    assert_allclose(friction_sizes(found), expected, rtol=0.02)
    assert_only_noise_is_left(found, samples)


def check_drag_on_one_derivative_is_found_and_taken_out(friction):
    """What brakes one acceleration, whatever the drives do, beside a constant on it."""
    samples = [*samples_of_joints(drag=lambda w: np.array([0.5 * w[0] + 0.2, 0.0]))]
    found = friction.find_friction(joint_residuals, samples, (2, 3))
    expected = np.zeros((3, 2, 3))
    expected[0, 0, 0] = 0.5
    assert_allclose(friction_sizes(found.friction), expected, rtol=0.02)
    assert_allclose(np.zeros(2) + found.constant, [-0.2 / JOINT_NOISE, 0.0], rtol=0.1)
    assert_only_noise_is_left(found.friction, samples, found.constant)


def check_dry_friction_is_not_known_near_rest(friction):
    """It sticks below a speed of 0.14: there, what it holds is any torque up to that of sliding."""
    stuck = np.random.default_rng(5)

    def rubs(w):
        return np.array([np.sign(w[0]) if abs(w[0]) > 0.14 else stuck.uniform(-1.0, 1.0), 0.0])

    samples = [*samples_of_joints(torques=rubs, n=80)]
    found = friction.find_friction(joint_residuals, samples, (2, 3)).friction
    expected = np.zeros((3, 2, 3))
    expected[1, 0, 1] = 1.0
    assert_allclose(friction_sizes(found), expected, rtol=0.02)
    slow = [abs(s.x[2]) < 0.14 for s in samples]
    assert sum(slow) > 2
    assert_allclose(np.isnan([found.without(s).xdot for s in samples])[slow], 1.0)
    assert_only_noise_is_left(found, samples)


def check_spread_is_that_of_white_noise_about_a_slow_mean(residual_scale):
    """A median of 200 000 differences that are correlated with one neighbour each: good to 0.3 %."""
    slow = 50.0 * np.sin(1e-3 * np.arange(200_000))
    rows = np.random.default_rng(4).standard_normal((200_000, 2)) * [1.0, 7.0] + slow[:, None]
    assert_allclose(residual_scale.spread_of(rows), [1.0, 7.0], rtol=0.015)


def check_coloured_noise_against_normal_distributions(residual_scale):
    """The covariance of an autoregression is s^2 rho^|i - j|: the likeliest of four correlations and many sizes."""
    for rho, sigma in ((0.9, 3.0), (0.5, 6.0), (0.95, 9.0), (0.9, 0.5)):
        draws = np.random.default_rng(6).standard_normal((15, 2)) * np.sqrt(1.0 - rho * rho)
        rows = sigma * lfilter([1.0], [1.0, -rho], draws, axis=0)
        likeliest = 0.0
        for of_channel in rows.T:
            found = []
            for tried in (0.5, 0.8, 0.9, 0.95):
                known = toeplitz(tried ** np.arange(15.0))
                least = 1.0 / np.sqrt(1.0 - tried**2)  # innovations as large as known noise
                found.append(
                    minimize_scalar(
                        lambda s, y=of_channel, known=known: -2.0 * multivariate_normal.logpdf(y, cov=s**2 * known),
                        bounds=(least, 10.0),
                        method="bounded",
                        options={"xatol": 1e-6},
                    ).fun
                )
            likeliest += min(found) - 15.0 * np.log(2.0 * np.pi)
        fit = residual_scale.coloured_noise(rows)
        assert_allclose(fit.squares, likeliest, rtol=1e-4)
        assert (fit.n_free, fit.n_values) == (4, 30)


def check_effective_scale_is_that_of_means_of_correlated_samples(residual_scale):
    """The variance of a mean of n samples is sum_ij rho^|i-j| / n^2; 400 000 samples give rho to 0.001."""
    n, rho = 4000, 0.8
    lags = np.arange(1, n)
    truth = np.sqrt(1.0 + 2.0 * np.sum((1.0 - lags / n) * rho**lags))
    scale = residual_scale.ResidualScale(1)
    draws = np.random.default_rng(5).standard_normal(400_000) * np.sqrt(1.0 - rho * rho)
    scale.admit(3.0 * lfilter([1.0], [1.0, -rho], draws)[:, None])
    assert_allclose(scale.effective, 3.0 * truth, rtol=0.03)


def check_step_is_the_minimum_of_hubers_loss(leap):
    """SciPy's trust region finds it to rounding, twenty weightings to a fiftieth of a standard deviation."""
    rng = np.random.default_rng(0)
    for _ in range(5):
        slope = rng.normal(size=(40, 3)) * (100.0, 30.0, 10.0)
        r = slope @ (0.1, -0.2, 0.3) + rng.normal(size=40)
        r[:3] += (-250.0, 80.0, 30.0)
        truth = least_squares(lambda step, r=r, J=slope: r + J @ step, np.zeros(3), loss="huber", xtol=1e-12).x
        std = np.sqrt(np.linalg.inv(slope.T @ slope).diagonal())
        assert_allclose(leap.least_absolute_step(r, slope) / std, truth / std, atol=0.02)
