"""Gaussian-process surrogates. The only file that imports GPy.

GPy owns the kernel, its priors and its hyperparameters. Its calls cost 0.5 ms (likelihood) to 15 ms (fit) each whatever
the size, so `VectorSurrogate` evaluates the same likelihood and posterior in LAPACK and writes the result back;
the tests hold it to GPy's figures.
"""

from typing import Any, Final

import GPy
import numpy as np
from scipy.linalg import get_lapack_funcs
from scipy.optimize import minimize

from .space import Vector

NOISE: Final = 1e-8
"""Noise variance relative to the signal's. Residuals on fixed samples are exact functions of theta: this is jitter."""
LENGTHSCALE_BOUNDS: Final = (0.2, 5.0)
"""Of the unit cube. Shorter ones find spurious optima of the likelihood from a handful of points."""
LENGTHSCALE_PRIOR: Final[tuple[Any, Any]] = (0.0, 0.7)
"""Mean and standard deviation of a lengthscale's logarithm: long, so that a few points tell much."""

_potrf, _potrs, _potri, _trtrs = get_lapack_funcs(("potrf", "potrs", "potri", "trtrs"), dtype=np.float64)


class VectorSurrogate:
    """Independent GPs for the k outputs of a smooth function of the unit cube, with common lengthscales.

    cov(h_j(z), h_j(z')) = q_j c(z, z'),  c the squared exponential with a lengthscale a dimension.
    The lengthscales are fitted by maximum a posteriori with each q_j at its optimum, q_j = y_j^T C^-1 y_j / n
    (the concentrated likelihood: Rasmussen and Williams (2006), section 5.4.1; Santner et al. (2003), section 3.3).
    """

    def __init__(self, n_dimensions: int) -> None:
        self.kernel = GPy.kern.RBF(n_dimensions, variance=1.0, lengthscale=np.ones(n_dimensions), ARD=True)
        self.kernel.lengthscale.set_prior(GPy.priors.LogGaussian(*LENGTHSCALE_PRIOR), warning=False)
        self.kernel.lengthscale.constrain_bounded(*LENGTHSCALE_BOUNDS, warning=False)
        self._lengthscales = np.ones(n_dimensions)

    @property
    def lengthscales(self) -> Vector:
        """(d,), in units of the cube."""
        return self._lengthscales

    def fit(self, Z: Vector, Y: Vector, max_iterations: int = 15) -> None:
        """Refit the lengthscales to Y (n, k) at Z (n, d), from where they are."""
        squares = np.ascontiguousarray(((Z[:, None, :] - Z[None]) ** 2).transpose(2, 0, 1))
        prior = self.kernel.lengthscale.priors.properties()[0]
        result = minimize(
            lambda p: negative_log_posterior(p, Y, squares, prior.mu, prior.sigma),
            np.log(self._lengthscales),
            jac=True,
            method="L-BFGS-B",
            bounds=[tuple(np.log(LENGTHSCALE_BOUNDS))] * Z.shape[1],
            options={"maxiter": max_iterations},
        )
        self._lengthscales = np.exp(result.x)
        self.kernel.lengthscale[:] = self._lengthscales

    def condition(self, Z: Vector, Y: Vector) -> "Posterior":
        """The posterior given Y (n, k) at Z (n, d), at the present lengthscales."""
        return Posterior(Z, Y, self._lengthscales)


def correlation(A: Vector, B: Vector, lengthscales: Vector) -> Vector:
    """Squared-exponential correlation (n, m) of places A (n, d) and B (m, d)."""
    a, b = A / lengthscales, B / lengthscales
    squares = np.sum(a * a, axis=1)[:, None] + np.sum(b * b, axis=1) - 2.0 * a @ b.T
    return np.exp(-0.5 * np.maximum(squares, 0.0))


def _factor(C: Vector, noise: float) -> tuple[Vector, int]:
    """Lower Cholesky factor of C + noise I, and LAPACK's info: 0 where it exists."""
    K = C.copy()
    K[np.diag_indices(len(C))] += noise
    return _potrf(K, lower=1)


def negative_log_posterior(
    log_lengthscales: Vector, Y: Vector, squares: Vector, prior_mean: float, prior_std: float
) -> tuple[float, Vector]:
    """Minus log likelihood of Y (n, k), the q_j at their optima, minus log prior; with its gradient (d,).

    squares: (d, n, n) squared differences of the places. The log-normal prior is on the lengthscales.
    """
    n, k = Y.shape
    inverse_squares = np.exp(-2.0 * log_lengthscales)
    C = np.exp(-0.5 * np.tensordot(inverse_squares, squares, 1))
    L, failed = _factor(C, NOISE)
    if failed:
        return 1e10, np.zeros_like(log_lengthscales)
    alpha, _ = _potrs(L, Y, lower=1)
    lower, _ = _potri(L, lower=1)
    inverse = np.tril(lower) + np.tril(lower, -1).T
    q = np.maximum(np.sum(Y * alpha, axis=0) / n, np.finfo(float).tiny)
    value = 0.5 * n * np.sum(np.log(q)) + k * np.sum(np.log(np.diag(L))) + 0.5 * n * k * (1.0 + np.log(2.0 * np.pi))
    G = 0.5 * (k * inverse - (alpha / q) @ alpha.T) * C  # d value / d C, times dC/d(log l) but for its factor
    gradient = np.tensordot(squares, G, 2) * inverse_squares
    z = (log_lengthscales - prior_mean) / prior_std
    value += np.sum(0.5 * z * z + log_lengthscales + np.log(prior_std * np.sqrt(2.0 * np.pi)))
    return float(value), np.asarray(gradient + z / prior_std + 1.0, dtype=float)


class Posterior:
    """Mean and variance of k outputs given n observations; frozen once built."""

    def __init__(self, Z: Vector, Y: Vector, lengthscales: Vector) -> None:
        self._places, self._lengthscales = Z, lengthscales
        C = correlation(Z, Z, lengthscales)
        noise = NOISE
        self._cholesky, failed = _factor(C, noise)
        while failed:
            noise *= 10.0
            self._cholesky, failed = _factor(C, noise)
        self._alpha, _ = _potrs(self._cholesky, Y, lower=1)
        self.variances = np.maximum(np.sum(Y * self._alpha, axis=0) / len(Z), np.finfo(float).tiny)
        """q (k,), the signal variance of each output."""

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Noiseless mean (m, k) and variance (m, k) at places Q (m, d)."""
        C = correlation(Q, self._places, self._lengthscales)
        w, _ = _trtrs(self._cholesky, C.T, lower=1)
        unit = np.maximum(1.0 - np.sum(w * w, axis=0), 1e-12)
        return C @ self._alpha, unit[:, None] * self.variances

    def mean_and_jacobian(self, z: Vector) -> tuple[Vector, Vector]:
        """Mean (k,) at z (d,) and its slope (k, d)."""
        scaled = (z - self._places) / self._lengthscales
        c = np.exp(-0.5 * (scaled * scaled).sum(axis=1))
        return c @ self._alpha, -self._alpha.T @ (c[:, None] * scaled / self._lengthscales)


class SeldomScalarSurrogate:
    """The same model, whose hyperparameters are refitted seldom; in between only the data are exchanged.

    It is GPy's model throughout: what is saved is the search over hyperparameters.
    """

    REFITS: Final = frozenset({5, 7, 9, 12, 16, 21, 26})
    """Numbers of observations at which the hyperparameters are refitted."""

    def __init__(self) -> None:
        self._surrogate: ScalarSurrogate | None = None

    def condition(self, Z: Vector, y: Vector) -> "ScalarSurrogate":
        """The surrogate given y (n,) at Z (n, d)."""
        if self._surrogate is None or len(Z) in self.REFITS:
            self._surrogate = ScalarSurrogate(Z, y, max_iterations=20)
        else:
            self._surrogate.model.set_XY(Z.copy(), y[:, None].copy())
        return self._surrogate


class ScalarSurrogate:
    """GPy's own regression with an ARD Matern-5/2 kernel, refitted at every call: the paper's surrogate."""

    def __init__(self, Z: Vector, y: Vector, max_iterations: int = 50) -> None:
        kernel = GPy.kern.Matern52(Z.shape[1], ARD=True)
        kernel.lengthscale.constrain_bounded(0.02, 10.0, warning=False)
        self.model: Any = GPy.models.GPRegression(Z.copy(), y[:, None].copy(), kernel, normalizer=True)
        self.model.Gaussian_noise.variance.constrain_bounded(1e-6, 1.0, warning=False)
        self.model.optimize("lbfgsb", max_iters=max_iterations)

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Noiseless mean (m,) and variance (m,) at places Q (m, d)."""
        mean, variance = self.model.predict_noiseless(Q)
        return mean[:, 0], np.maximum(variance[:, 0], 1e-16)
