"""Bayesian optimisation of one noisy norm: the paper's estimator, kept as published, for comparison."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy  # its stats, which takes 0.3 s, is loaded when it is used

from ..contract import Estimate, NoEstimateError
from ..space import ParameterSpace, Vector
from .acquisition import Acquisition, expected_improvement, lower_confidence_bound, probability_of_improvement
from .gpy_surrogate import GPyScalarPosterior, Surrogate, scalar_surrogate
from .kernels import OwnKernel, check_kernel
from .surrogate import ScalarPosterior

_REFITS = frozenset({5, 7, 9, 12, 16, 21, 26})
"""Numbers of observations at which the hyperparameters are refitted, where that is seldom."""


@dataclass(frozen=True)
class PaperSettings:
    """Settings of `PaperBO`, as in Khan and Chatterjee (2020) where they are printed."""

    noise: float = 3.2e-3
    """Standard deviation of the noise added to the norm at each evaluation, in the residual's unit."""
    acquisition: Acquisition = "ei"
    """Expected improvement, probability of improvement or lower confidence bound."""
    n_initial: int = 5
    """Number of random candidates that begin an episode."""
    n_pool: int = 512
    """Number of candidates among which the acquisition is maximised."""
    refits: Literal["always", "seldom"] = "always"
    """Refits of the surrogate's hyperparameters: at every evaluation, or on a schedule."""
    surrogate: Surrogate = "auto"
    """The Gaussian process: `auto` is this package's code where it knows the kernel, which is Matern52, and GPy's where
    not; `gpy` is always GPy's, and with `refits = "always"` GPy's own L-BFGS. `paper` has `gpy`."""
    kernel: str = "Matern52"
    """Kernel of GPy's, by name, or a sum and product of several: "Matern52 * StdPeriodic(period=0.5) + Linear"."""

    def __post_init__(self) -> None:
        if self.kernel != "Matern52":
            check_kernel(self.kernel)
        if self.noise < 0.0:
            raise ValueError(f"noise must not be negative, got {self.noise}.")
        if self.n_initial < 1 or self.n_pool < 1:
            raise ValueError(f"n_initial and n_pool must be positive, got {self.n_initial} and {self.n_pool}.")


class PaperBO:
    """Bayesian optimisation with one GP (Matern-5/2, a lengthscale a dimension) for |residual| + noise.

    The GP is GPy's own regression, or the same in LAPACK: see `PaperSettings.surrogate`. It is refitted at every
    evaluation. Each episode starts without data, and recorded norms are never updated, even when the plant changes
    meanwhile.
    Khan and Chatterjee (2020), algorithm 1. Residuals are in physical units.
    """

    is_whitened = False

    def __init__(
        self,
        space: ParameterSpace,
        start: Vector,
        rng: np.random.Generator,
        settings: PaperSettings | None = None,
        kernel: OwnKernel | None = None,
    ) -> None:
        """kernel: a GPy.kern.Kern, or a function of d that makes one, in the place of the settings' kernel."""
        self._space, self._rng, self._settings = space, rng, settings or PaperSettings()
        self._surrogate = scalar_surrogate(len(space), self._settings.surrogate, self._settings.kernel, kernel)
        self._sobol = scipy.stats.qmc.Sobol(len(space), rng=rng)
        self.restart(start)

    @property
    def model(self) -> Any:
        """A GPy model of the norms over the unit cube; new each time, so that changing it changes nothing here."""
        if not len(self._places):
            raise NoEstimateError("no candidate has succeeded yet: tell the residual of one first.")
        return self._surrogate.model(self._places, self._norms)

    def restart(self, start: Vector) -> None:
        """Begin an episode without data. The paper does not use the start."""
        d = len(self._space)
        self._queue = list(self._rng.random((self._settings.n_initial, d)))
        self._places, self._norms = np.empty((0, d)), np.empty(0)
        self._n_evaluations = 0
        self._spread = np.ones(d)
        self._surrogate.forget()

    def ask(self) -> Vector:
        """Return the next candidate: of the random design first, then the maximiser of the acquisition function."""
        if self._queue or not len(self._places):
            return self._space.from_unit(self._queue.pop(0) if self._queue else self._rng.random(len(self._space)))
        posterior = self._posterior()
        best = self._places[int(np.argmin(self._norms))]
        local = best + 0.05 * self._rng.standard_normal((64, len(best)))
        pool = np.clip(np.vstack([self._sobol.random(self._settings.n_pool), local]), 0.0, 1.0)
        mean, variance = posterior.predict(pool)
        weights = probability_of_improvement(mean, variance, float(self._norms.min()))
        even = slice(self._settings.n_pool)  # those round the incumbent would make the spread theirs
        self._spread = _weighted_std(pool[even], weights[even])
        return self._space.from_unit(pool[int(np.argmax(self._score(mean, variance, weights)))])

    def tell(self, theta: Vector, residual: Vector) -> None:
        """Record the norm of a candidate's residual (D,), with noise. A non-finite one is left out."""
        self._n_evaluations += 1
        norm = float(np.linalg.norm(residual)) + self._settings.noise * float(self._rng.standard_normal())
        if np.isfinite(norm):
            self._places = np.vstack([self._places, self._space.to_unit(theta)])
            self._norms = np.append(self._norms, norm)

    def estimate(self) -> Estimate:
        """Return the candidate of least noisy norm; its std is the spread of the places that may be better."""
        if not len(self._places):
            raise NoEstimateError("no candidate has succeeded yet: tell the residual of one first.")
        best = int(np.argmin(self._norms))
        theta = self._space.from_unit(self._places[best])
        return Estimate(
            theta=theta,
            std=self._spread * self._space.slope(theta),
            is_identifiable=(False,) * len(theta),  # one noisy norm cannot tell
            cost=float(self._norms[best]),
            n_evaluations=self._n_evaluations,
            reason="incumbent",
        )

    def _posterior(self) -> ScalarPosterior | GPyScalarPosterior:
        """Return the GP of the recorded norms, its hyperparameters refitted always and from their start, or seldom."""
        if self._settings.refits == "always":
            self._surrogate.fit_anew(self._places, self._norms)
        elif len(self._places) in _REFITS:
            self._surrogate.fit(self._places, self._norms)
        return self._surrogate.condition(self._places, self._norms)

    def _score(self, mean: Vector, variance: Vector, improvement_probability: Vector) -> Vector:
        match self._settings.acquisition:
            case "ei":
                return expected_improvement(mean, variance, float(self._norms.min()))
            case "pi":
                return improvement_probability
            case "lcb":
                return lower_confidence_bound(mean, variance)


def _weighted_std(places: Vector, weights: Vector) -> Vector:
    """Return the standard deviation (d,) of places (n, d) under weights (n,); one, the whole cube, where all vanish."""
    total = float(np.sum(weights))
    if total <= 0.0:
        return np.ones(places.shape[1])
    mean = weights @ places / total
    return np.sqrt(weights @ (places - mean) ** 2 / total)
