"""Surrogates whose kernel, likelihood, slopes and predictions are GPy's: of any kernel, and slower than `surrogate`.

What a checkpoint keeps of them are hyperparameters and data, as arrays; kernels and models are made anew.
"""

from functools import cached_property
from typing import Any, ClassVar, Final, Literal

import numpy as np

from ..space import Vector
from .gpy_search import maximise
from .kernels import KernelBounds, OwnKernel, fix_scale, kernel_from_text, own_kernel
from .surrogate import (
    LENGTHSCALE_BOUNDS,
    LENGTHSCALE_PRIOR,
    MaternBounds,
    ScalarSurrogate,
    VectorSurrogate,
    regression_of_norms,
    regression_of_outputs,
)

Surrogate = Literal["auto", "gpy"]
_GPY_NOISE: Final = 0.01
"""Noise variance at the start of GPy's own fit; on its bound it would stay, in the coordinates that GPy searches in."""
_STEP: Final = 1e-4
"""Difference for the slopes of kernels that have none in GPy, in the unit cube."""


def vector_surrogate(
    n_dimensions: int, surrogate: Surrogate, kernel: str, own: OwnKernel | None = None
) -> "VectorSurrogate | GPyVectorSurrogate":
    """Return the surrogate of a residual's components: in LAPACK for the kernel RBF, else GPy's. Raises ValueError."""
    if own is not None:
        return GPyVectorSurrogate(own_kernel(own, n_dimensions))
    if surrogate == "auto" and kernel == "RBF":
        return VectorSurrogate(n_dimensions)
    bounds = MaternBounds().variance
    made = kernel_from_text(kernel, n_dimensions, KernelBounds(bounds, LENGTHSCALE_BOUNDS, LENGTHSCALE_PRIOR))
    fix_scale(made)  # each output has a scale of its own
    return GPyVectorSurrogate(made)


def scalar_surrogate(
    n_dimensions: int, surrogate: Surrogate, kernel: str, own: OwnKernel | None = None
) -> "ScalarSurrogate | GPyScalarSurrogate":
    """Return the surrogate of a norm: in LAPACK for the kernel Matern52, else GPy's. Raises ValueError."""
    if own is not None:
        return GPyScalarSurrogate(own_kernel(own, n_dimensions))
    if surrogate == "auto" and kernel == "Matern52":
        return ScalarSurrogate(n_dimensions)
    bounds = MaternBounds()
    return GPyScalarSurrogate(kernel_from_text(kernel, n_dimensions, KernelBounds(bounds.variance, bounds.lengthscale)))


class GPyVectorSurrogate:
    """Independent GPs for the k outputs of a function of the unit cube, with one kernel of GPy's.

    cov(h_j(z), h_j(z')) = q_j c(z, z'),  c the kernel; as `VectorSurrogate`, by maximum a posteriori of the kernel's
    hyperparameters with each q_j at its optimum.
    """

    made_anew: ClassVar = ("_kernel",)
    """Attributes that are in no checkpoint."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._parameters: Vector = np.array(kernel.param_array)

    def fit(self, Z: Vector, Y: Vector, max_iterations: int = 8) -> None:
        """Refit the hyperparameters to Y (n, k) at Z (n, d), from where they are."""
        deviations = np.ones(Y.shape[1])
        model = regression_of_outputs(Z, Y, self.kernel_at(self._parameters), deviations)

        def log_likelihood() -> float:
            nonlocal deviations
            deviations = deviations * _deviations(model)
            model.set_Y(Y / deviations)
            return model.log_likelihood() - len(Z) * float(np.log(deviations).sum())

        maximise(model, log_likelihood, max_iterations)
        self._parameters = np.array(model.kern.param_array)

    def condition(self, Z: Vector, Y: Vector) -> "GPyPosterior":
        """Return the posterior given Y (n, k) at Z (n, d), at the present hyperparameters."""
        return GPyPosterior(self, Z, Y, self._parameters)

    def model(self, Z: Vector, Y: Vector) -> Any:
        """Return GPy's regression of the outputs, each divided by the root of its q_j."""
        return self.condition(Z, Y).model

    def kernel_at(self, parameters: Vector) -> Any:
        """Return a kernel with these hyperparameters."""
        kernel = self._kernel.copy()
        kernel[:] = parameters
        return kernel


class GPyPosterior:
    """Mean and variance of k outputs given n observations, by GPy."""

    def __init__(self, surrogate: GPyVectorSurrogate, Z: Vector, Y: Vector, parameters: Vector) -> None:
        self._surrogate, self._places, self._outputs, self._parameters = surrogate, Z, Y, parameters

    @cached_property
    def _scaled(self) -> tuple[Any, Vector]:
        """GPy's model, and the deviations (k,) by which its outputs are divided."""
        kernel = self._surrogate.kernel_at(self._parameters)
        model = regression_of_outputs(self._places, self._outputs, kernel, np.ones(self._outputs.shape[1]))
        deviations = _deviations(model)
        model.set_Y(self._outputs / deviations)
        return model, deviations

    @property
    def model(self) -> Any:
        """GPy's regression."""
        return self._scaled[0]

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Return the noiseless mean (m, k) and variance (m, k) at places Q (m, d)."""
        model, deviations = self._scaled
        mean, variance = model.predict_noiseless(Q)
        return mean * deviations, np.maximum(variance, 1e-12) * deviations**2

    def mean_and_jacobian(self, z: Vector) -> tuple[Vector, Vector]:
        """Return the mean (k,) at z (d,) and its slope (k, d)."""
        model, deviations = self._scaled
        alpha: Vector = model.posterior.woodbury_vector * deviations
        return (model.kern.K(z[None], model.X) @ alpha)[0], _slopes(model, alpha, z)


class GPyScalarSurrogate:
    """GP for one noisy output: GPy's regression of its values, normalised, with one of its kernels."""

    made_anew: ClassVar = ("_kernel",)
    """Attributes that are in no checkpoint."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._start: Vector = np.append(kernel.param_array, MaternBounds().noise[1])
        self.forget()

    def forget(self) -> None:
        """Reset the hyperparameters to their start."""
        self._parameters = self._start

    def fit_anew(self, Z: Vector, y: Vector) -> None:
        """Fit the hyperparameters to y (n,) at Z (n, d) from their start, by GPy's own L-BFGS until it ends."""
        model = self._model(Z, y, np.append(self._start[:-1], _GPY_NOISE))
        with np.errstate(all="ignore"):  # GPy's coordinates near a bound
            model.optimize("lbfgsb")
        self._parameters = np.array(model.param_array)

    def fit(self, Z: Vector, y: Vector, max_iterations: int = 12) -> None:
        """Refit the hyperparameters to y (n,) at Z (n, d), from where they are."""
        model = self._model(Z, y, self._parameters)
        maximise(model, lambda: float(model.log_likelihood()), max_iterations)
        self._parameters = np.array(model.param_array)

    def condition(self, Z: Vector, y: Vector) -> "GPyScalarPosterior":
        """Return the posterior given y (n,) at Z (n, d), at the present hyperparameters."""
        return GPyScalarPosterior(self.model(Z, y))

    def model(self, Z: Vector, y: Vector) -> Any:
        """Return GPy's regression of y (n,) at Z (n, d), at the present hyperparameters."""
        return self._model(Z, y, self._parameters)

    def _model(self, Z: Vector, y: Vector, parameters: Vector) -> Any:
        kernel = self._kernel.copy()
        kernel[:] = parameters[:-1]
        return regression_of_norms(Z, y, kernel, float(parameters[-1]), MaternBounds().noise)


class GPyScalarPosterior:
    """Mean and variance of one output, in its own unit, by GPy."""

    def __init__(self, model: Any) -> None:
        self._model = model

    def predict(self, Q: Vector) -> tuple[Vector, Vector]:
        """Return the noiseless mean (m,) and variance (m,) at places Q (m, d)."""
        mean, variance = self._model.predict_noiseless(Q)
        return mean[:, 0], np.maximum(variance[:, 0], 1e-16 * self._model.normalizer.std**2)


def _deviations(model: Any) -> Vector:
    """Return the deviations (k,) of the model's outputs at which they are likeliest: roots of y^T C^-1 y / n."""
    q = np.einsum("ij,ij->j", model.Y, model.posterior.woodbury_vector) / model.num_data
    return np.sqrt(np.maximum(q, np.finfo(float).tiny))


def _slopes(model: Any, alpha: Vector, z: Vector) -> Vector:
    """Return the slopes (k, d) of K(z, Z) alpha at z (d,); by differences where GPy has none for the kernel."""
    try:
        return np.vstack([model.kern.gradients_X(column[None], z[None], model.X) for column in alpha.T])
    except NotImplementedError:
        places = z + _STEP * np.vstack([np.eye(len(z)), -np.eye(len(z))])
        ahead, behind = np.split(model.kern.K(places, model.X) @ alpha, 2)
        return (ahead - behind).T / (2.0 * _STEP)
