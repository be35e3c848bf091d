"""Likelihoods and posteriors of two Gaussian processes, in NumPy and LAPACK: pure functions and frozen posteriors.

GPy's calls cost 0.5 ms (likelihood) to 15 ms (fit) each whatever the size; these cost what the data cost. The tests
hold likelihoods, gradients, means and variances to GPy's figures. Rasmussen, Williams (2006), algorithm 2.1, eq. 5.9.
"""

from typing import Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..space import Vector

NOISE: Final = 1e-8
"""Noise variance relative to the signal's. Residuals on fixed samples are exact functions of theta: this is jitter."""
JITTER: Final = 1e-8
"""Term that GPy's exact inference adds to the diagonal."""
_LOG_2PI: Final = float(np.log(2.0 * np.pi))
_IMPOSSIBLE: Final = 1e10
"""Value returned to a minimiser where the covariance has no Cholesky factor."""


def squared_differences(Z: Vector) -> Vector:
    """Return the squared differences (d, n, n) of the places Z (n, d) in each dimension."""
    columns = np.ascontiguousarray(Z.T)
    return (columns[:, :, None] - columns[:, None, :]) ** 2


def _scaled_squares(squares: Vector, inverse_squares: Vector) -> Vector:
    """Return the sum (n, n) of squared differences (d, n, n), each divided by its lengthscale's square."""
    d, n, _ = squares.shape
    return (inverse_squares @ squares.reshape(d, n * n)).reshape(n, n)


def _factor(K: Vector, noise: float) -> tuple[Vector, int]:
    """Return the lower Cholesky factor of K + noise I, written over K, and LAPACK's info: 0 where there is one."""
    K.reshape(-1)[:: len(K) + 1] += noise
    return scipy.linalg.lapack.dpotrf(K.T, lower=1, overwrite_a=1)


# --- several outputs with common lengthscales, squared exponential --------------------------------------------------


def negative_log_posterior(
    log_lengthscales: Vector, Y: Vector, squares: Vector, prior_mean: float, prior_std: float
) -> tuple[float, Vector]:
    """Return minus log posterior of the lengthscales given Y (n, k), with its gradient (d,).

    Minus log likelihood, each signal variance at its optimum, minus log prior.
    squares: (d, n, n) squared differences of the places. The log-normal prior is on the lengthscales.
    """
    n, k = Y.shape
    inverse_squares = np.exp(-2.0 * log_lengthscales)
    C = np.exp(-0.5 * _scaled_squares(squares, inverse_squares))
    L, failed = _factor(C.copy(), NOISE)
    if failed:
        return _IMPOSSIBLE, np.zeros_like(log_lengthscales)
    alpha, _ = scipy.linalg.lapack.dpotrs(L, Y, lower=1)
    q = np.maximum(np.einsum("ij,ij->j", Y, alpha) / n, np.finfo(float).tiny)
    value = 0.5 * n * np.log(q).sum() + k * np.log(L.diagonal()).sum() + 0.5 * n * k * (1.0 + _LOG_2PI)
    lower, _ = scipy.linalg.lapack.dpotri(L, lower=1)
    # d value / d C, times dC/d(log l) but for its factor; one triangle of the inverse, twice: squares have no diagonal
    G = 0.5 * (2.0 * k * lower - (alpha / q) @ alpha.T) * C
    gradient = squares.reshape(len(squares), n * n) @ G.reshape(-1) * inverse_squares
    z = (log_lengthscales - prior_mean) / prior_std
    value += (0.5 * z * z + log_lengthscales + np.log(prior_std * np.sqrt(2.0 * np.pi))).sum()
    return float(value), gradient + z / prior_std + 1.0


def correlation(A: Vector, B: Vector, lengthscales: Vector) -> Vector:
    """Return the squared-exponential correlation (n, m) of places A (n, d) and B (m, d)."""
    return np.exp(-0.5 * scipy.spatial.distance.cdist(A / lengthscales, B / lengthscales, "sqeuclidean"))


class Posterior:
    """Mean and variance of k outputs given n observations; frozen once built."""

    def __init__(self, Z: Vector, Y: Vector, lengthscales: Vector) -> None:
        self._places, self._lengthscales = Z, lengthscales
        C = correlation(Z, Z, lengthscales)
        noise = NOISE
        self._cholesky, failed = _factor(C.copy(), noise)
        while failed:
            noise *= 10.0
            self._cholesky, failed = _factor(C.copy(), noise)
        self._alpha, _ = scipy.linalg.lapack.dpotrs(self._cholesky, Y, lower=1)
        self.variances = np.maximum(np.einsum("ij,ij->j", Y, self._alpha) / len(Z), np.finfo(float).tiny)
        """Signal variance q (k,) of each output."""

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Return the noiseless mean (m, k) and variance (m, k) at places Q (m, d)."""
        C = correlation(Q, self._places, self._lengthscales)
        w, _ = scipy.linalg.lapack.dtrtrs(self._cholesky, C.T, lower=1)
        unit = np.maximum(1.0 - np.einsum("ij,ij->j", w, w), 1e-12)
        return C @ self._alpha, unit[:, None] * self.variances

    def mean_and_jacobian(self, z: Vector) -> tuple[Vector, Vector]:
        """Return the mean (k,) at z (d,) and its slope (k, d)."""
        scaled = (z - self._places) / self._lengthscales
        c = np.exp(-0.5 * np.einsum("ij,ij->i", scaled, scaled))
        return c @ self._alpha, -(c * self._alpha.T) @ (scaled / self._lengthscales)


# --- one noisy output, Matern-5/2 -----------------------------------------------------------------------------------


def matern52(A: Vector, B: Vector, lengthscales: Vector) -> Vector:
    """Return the correlation (n, m) of places A (n, d) and B (m, d): (1 + s + s^2/3) exp(-s), s = sqrt(5) r.

    Rasmussen and Williams (2006), eq. 4.17.
    """
    s = np.sqrt(5.0) * scipy.spatial.distance.cdist(A / lengthscales, B / lengthscales)
    return (1.0 + s + s * s / 3.0) * np.exp(-s)


def negative_log_likelihood(log_parameters: Vector, y: Vector, squares: Vector) -> tuple[float, Vector]:
    """Return minus log likelihood of y (n,), and its gradient (d + 2,).

    log_parameters: logarithms of signal variance, noise variance and lengthscales, (d + 2,).
    squares: (d, n, n) squared differences of the places.
    """
    n = len(y)
    variance, noise = np.exp(log_parameters[:2])
    inverse_squares = np.exp(-2.0 * log_parameters[2:])
    s = np.sqrt(5.0 * _scaled_squares(squares, inverse_squares))
    decay = variance * np.exp(-s)
    L, failed = _factor((1.0 + s + s * s / 3.0) * decay, noise + JITTER)
    if failed:
        return _IMPOSSIBLE, np.zeros_like(log_parameters)
    alpha, _ = scipy.linalg.lapack.dpotrs(L, y, lower=1)
    value = 0.5 * (y @ alpha) + np.log(L.diagonal()).sum() + 0.5 * n * _LOG_2PI
    lower, _ = scipy.linalg.lapack.dpotri(L, lower=1)
    trace = lower.trace() - alpha @ alpha  # of d value / d K, twice: the inverse minus alpha alpha^T
    G = (2.0 * lower - alpha[:, None] * alpha) * (1.0 + s) * decay  # one triangle, twice: squares have no diagonal
    gradient = np.empty_like(log_parameters)
    gradient[0] = 0.5 * (n - y @ alpha - (noise + JITTER) * trace)
    gradient[1] = 0.5 * noise * trace
    gradient[2:] = 5.0 / 6.0 * (squares.reshape(len(squares), n * n) @ G.reshape(-1)) * inverse_squares
    return float(value), gradient


class MaternPosterior:
    """Mean and variance of one output given n noisy observations; frozen once built."""

    def __init__(self, Z: Vector, y: Vector, variance: float, noise: float, lengthscales: Vector) -> None:
        self._places, self._variance, self._lengthscales = Z, variance, lengthscales
        self._cholesky, failed = _factor(variance * matern52(Z, Z, lengthscales), noise + JITTER)
        if failed:
            raise np.linalg.LinAlgError(f"a covariance of {len(Z)} places has no Cholesky factor.")
        self._alpha, _ = scipy.linalg.lapack.dpotrs(self._cholesky, y, lower=1)

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Return the noiseless mean (m,) and variance (m,) at places Q (m, d)."""
        K = self._variance * matern52(Q, self._places, self._lengthscales)
        w, _ = scipy.linalg.lapack.dtrtrs(self._cholesky, K.T, lower=1)
        return K @ self._alpha, np.maximum(self._variance - np.einsum("ij,ij->j", w, w), 1e-16)
