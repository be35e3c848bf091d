"""Gaussian-process surrogates in LAPACK, for one kernel each; `gpy_surrogate` has those of GPy's other kernels.

GPy owns the kernels, their priors, bounds and hyperparameters; likelihood and posterior are those of
`gaussian_process`, and what a fit has found is written into GPy's objects when they are asked for.
"""

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..space import Vector
from .gaussian_process import (
    MaternPosterior,
    Posterior,
    negative_log_likelihood,
    negative_log_posterior,
    squared_differences,
)
from .kernels import constrain

LENGTHSCALE_BOUNDS: Final = (0.2, 5.0)
"""Bounds of the lengthscales in the unit cube; shorter ones fit spurious optima of the likelihood to few points."""
LENGTHSCALE_PRIOR: Final[tuple[Any, Any]] = (0.0, 0.7)
"""Mean and standard deviation of a lengthscale's logarithm: long, so that a few points predict far."""
ENOUGH: Final = 1e-4
"""Relative gain of the likelihood below which a fit ends: candidates are chosen no better for more."""


class VectorSurrogate:
    """Independent GPs for the k outputs of a smooth function of the unit cube, with common lengthscales.

    cov(h_j(z), h_j(z')) = q_j c(z, z'),  c the squared exponential with a lengthscale a dimension.
    The lengthscales are fitted by maximum a posteriori with each q_j at its optimum, q_j = y_j^T C^-1 y_j / n
    (the concentrated likelihood: Rasmussen and Williams (2006), section 5.4.1; Santner et al. (2003), section 3.3).
    """

    made_anew: ClassVar = ("_kernel",)
    """Attributes that are in no checkpoint."""

    def __init__(self, n_dimensions: int) -> None:
        self._kernel: Any = None
        self._lengthscales = np.ones(n_dimensions)

    @property
    def kernel(self) -> Any:
        """GPy's kernel with its prior and bounds, at the present lengthscales; made when first asked for."""
        if self._kernel is None:
            self._kernel = _squared_exponential(len(self._lengthscales))
        self._kernel.lengthscale[:] = self._lengthscales
        return self._kernel

    @property
    def lengthscales(self) -> Vector:
        """Lengthscales (d,), in units of the cube."""
        return self._lengthscales

    def fit(self, Z: Vector, Y: Vector, max_iterations: int = 8) -> None:
        """Refit the lengthscales to Y (n, k) at Z (n, d), from where they are."""
        found = scipy.optimize.minimize(
            negative_log_posterior,
            np.log(self._lengthscales),
            (Y, squared_differences(Z), *self._prior()),
            jac=True,
            method="L-BFGS-B",
            bounds=[tuple(np.log(LENGTHSCALE_BOUNDS))] * Z.shape[1],
            options={"maxiter": max_iterations, "ftol": ENOUGH},
        )
        self._lengthscales = np.exp(found.x)

    def condition(self, Z: Vector, Y: Vector) -> Posterior:
        """Return the posterior given Y (n, k) at Z (n, d), at the present lengthscales."""
        return Posterior(Z, Y, self._lengthscales)

    def model(self, Z: Vector, Y: Vector) -> Any:
        """Return GPy's regression of the outputs Y (n, k), each divided by the root of its q_j."""
        return regression_of_outputs(Z, Y, self.kernel.copy(), np.sqrt(self.condition(Z, Y).variances))

    def _prior(self) -> tuple[Any, Any]:
        """Return mean and deviation of a lengthscale's logarithm: those of GPy's kernel, which a user may have set."""
        if self._kernel is None:
            return LENGTHSCALE_PRIOR
        prior = self._kernel.lengthscale.priors.properties()[0]
        return prior.mu, prior.sigma


@dataclass(frozen=True)
class MaternBounds:
    """Bounds of the hyperparameters, for values of mean 0 and deviation 1 on the unit cube; equal ones fix them."""

    variance: tuple[float, float] = (1e-3, 1e3)
    """Variance of the function."""
    noise: tuple[float, float] = (1e-6, 1.0)
    """Noise variance; without a bound it drifts to 1e-63."""
    lengthscale: tuple[float, float] = (0.02, 10.0)
    """Lengthscales, in sides of the cube."""


class ScalarSurrogate:
    """GP for one noisy output: GPy's Matern-5/2 with a lengthscale a dimension, fitted by maximum likelihood."""

    made_anew: ClassVar = ("_kernel", "_likelihood")
    """Attributes that are in no checkpoint."""

    def __init__(self, n_dimensions: int, bounds: MaternBounds | None = None) -> None:
        import GPy

        bounds = bounds or MaternBounds()
        self._kernel = GPy.kern.Matern52(n_dimensions, ARD=True)
        self._likelihood = GPy.likelihoods.Gaussian()
        constrain(self._kernel.variance, bounds.variance)
        constrain(self._kernel.lengthscale, bounds.lengthscale)
        constrain(self._likelihood.variance, bounds.noise)
        self._noise_bounds = bounds.noise
        self._log_bounds = np.log([bounds.variance, bounds.noise, *[bounds.lengthscale] * n_dimensions])
        self.forget()

    @property
    def kernel(self) -> Any:
        """GPy's kernel with its bounds, at the present variance and lengthscales."""
        variance, _, *lengthscales = np.exp(self._log_parameters)
        self._kernel.variance[:], self._kernel.lengthscale[:] = variance, lengthscales
        return self._kernel

    @property
    def likelihood(self) -> Any:
        """GPy's likelihood with its bounds, at the present noise variance."""
        self._likelihood.variance[:] = np.exp(self._log_parameters[1])
        return self._likelihood

    def forget(self) -> None:
        """Reset the hyperparameters to GPy's start, one, or the bound nearest to it."""
        self._log_parameters = np.clip(0.0, *self._log_bounds.T)

    def fit_anew(self, Z: Vector, y: Vector) -> None:
        """Fit the hyperparameters to y (n,) at Z (n, d) from their start."""
        self.forget()
        self.fit(Z, y, max_iterations=50)

    def fit(self, Z: Vector, y: Vector, max_iterations: int = 12) -> None:
        """Refit the hyperparameters to y (n,) at Z (n, d), from where they are."""
        found = scipy.optimize.minimize(
            negative_log_likelihood,
            self._log_parameters,
            (_normalised(y)[0], squared_differences(Z)),
            jac=True,
            method="L-BFGS-B",
            bounds=self._log_bounds,
            options={"maxiter": max_iterations, "ftol": ENOUGH},
        )
        self._log_parameters = found.x

    def condition(self, Z: Vector, y: Vector) -> "ScalarPosterior":
        """Return the posterior given y (n,) at Z (n, d), at the present hyperparameters."""
        return ScalarPosterior(Z, y, self._log_parameters)

    def model(self, Z: Vector, y: Vector) -> Any:
        """Return GPy's regression of y (n,) at Z (n, d), at the present hyperparameters."""
        noise = float(np.exp(self._log_parameters[1]))
        return regression_of_norms(Z, y, self.kernel.copy(), noise, self._noise_bounds)


class ScalarPosterior:
    """Mean and variance of one output, in its own unit; frozen once built."""

    def __init__(self, Z: Vector, y: Vector, log_parameters: Vector) -> None:
        normalised, self._mean, self._deviation = _normalised(y)
        variance, noise = np.exp(log_parameters[:2])
        self._posterior = MaternPosterior(Z, normalised, variance, noise, np.exp(log_parameters[2:]))

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Return the noiseless mean (m,) and variance (m,) at places Q (m, d)."""
        mean, variance = self._posterior.predict(Q)
        return self._mean + self._deviation * mean, self._deviation**2 * variance


def _squared_exponential(n_dimensions: int) -> Any:
    """Return GPy's kernel with the prior and the bounds of `VectorSurrogate`."""
    import GPy  # takes 0.4 s: not before somebody looks at it

    kernel = GPy.kern.RBF(n_dimensions, variance=1.0, lengthscale=np.ones(n_dimensions), ARD=True)
    kernel.lengthscale.set_prior(GPy.priors.LogGaussian(*LENGTHSCALE_PRIOR), warning=False)
    kernel.lengthscale.constrain_bounded(*LENGTHSCALE_BOUNDS, warning=False)
    return kernel


def regression_of_outputs(Z: Vector, Y: Vector, kernel: Any, deviations: Vector) -> Any:
    """Return GPy's regression of Y (n, k), without noise, divided by the outputs' deviations (k,)."""
    import GPy

    tiny = np.finfo(float).tiny  # GPy's inference adds JITTER, which is NOISE
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of kernels that need not all dimensions
        model = GPy.models.GPRegression(Z.copy(), Y / deviations, kernel, noise_var=tiny)
    model.likelihood.variance.fix(warning=False)
    return model


def regression_of_norms(Z: Vector, y: Vector, kernel: Any, noise: float, noise_bounds: tuple[float, float]) -> Any:
    """Return GPy's regression of y (n,) at Z (n, d), which GPy normalises; noise: its variance, then."""
    import GPy

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # as above, and of equal values
        model = GPy.models.GPRegression(Z.copy(), y[:, None].copy(), kernel, normalizer=True, noise_var=noise)
    constrain(model.likelihood.variance, noise_bounds)
    return model


def _normalised(y: Vector) -> tuple[Vector, float, float]:
    """Return y (n,) with mean 0 and deviation 1, and the former two; the deviation of equal values counts as 1."""
    mean, deviation = float(y.mean()), float(y.std())
    deviation = deviation if deviation > 0.0 else 1.0
    return (y - mean) / deviation, mean, deviation
