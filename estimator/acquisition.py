"""Acquisition functions: what evaluating a candidate promises. Pure functions; lower objectives are better."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtr

from .space import Vector

Acquisition = Literal["ei", "pi", "lcb"]


def expected_improvement(mean: ArrayLike, variance: ArrayLike, incumbent: float) -> Vector:
    """E[max(b - h, 0)] for h ~ N(mean, variance).

    (b - mu) Phi(d) + sigma phi(d),  d = (b - mu)/sigma.

    mean, variance: (q,), in the objective's unit and its square;  incumbent: b;  returns (q,).
    Jones, Schonlau, Welch (1998), eq. 15.
    """
    mu, sigma = np.asarray(mean, dtype=float), np.sqrt(np.asarray(variance, dtype=float))
    d = (incumbent - mu) / sigma
    return (incumbent - mu) * ndtr(d) + sigma * np.exp(-0.5 * d * d) / np.sqrt(2.0 * np.pi)


def probability_of_improvement(mean: ArrayLike, variance: ArrayLike, incumbent: float) -> Vector:
    """P(h < b) for h ~ N(mean, variance), shapes as in `expected_improvement`. Kushner (1964)."""
    return ndtr((incumbent - np.asarray(mean, dtype=float)) / np.sqrt(np.asarray(variance, dtype=float)))


def lower_confidence_bound(mean: ArrayLike, variance: ArrayLike, kappa: float = 2.0) -> Vector:
    """-(mu - kappa sigma): larger is better, as for the others. Cox and John (1992)."""
    return kappa * np.sqrt(np.asarray(variance, dtype=float)) - np.asarray(mean, dtype=float)


def log_target_vector_improvement(mean: ArrayLike, variance: ArrayLike, incumbent: float) -> Vector:
    """Logarithm of E[max(b - S, 0)] for S = |h|^2, h_j ~ N(mean_j, variance_j) independent, by moment matching.

    S has mean M = sum mu^2 + v and variance V = sum 2 v^2 + 4 mu^2 v; a log-normal with the same two,
    s^2 = log(1 + V/M^2), nu = log M - s^2/2, has E[max(b - S, 0)] = b Phi(d) - M Phi(d - s), d = (log b - nu)/s.
    The channels may have unequal variances. Below the range of doubles the logarithm is of b phi(d) s / d^2,
    the expansion's first term, so that candidates stay ranked.

    mean, variance: (q, k);  incumbent: b > 0, a sum of squares;  returns (q,).
    Objective: Uhrenholt and Jensen (2019), "Efficient Bayesian optimization for target vector estimation".
    """
    mu, v = np.asarray(mean, dtype=float), np.asarray(variance, dtype=float)
    M = np.sum(mu * mu + v, axis=-1)
    V = np.sum(2.0 * v * v + 4.0 * mu * mu * v, axis=-1)
    s = np.sqrt(np.log1p(V / (M * M)))
    d = (np.log(incumbent) - np.log(M)) / s + 0.5 * s
    improvement = incumbent * ndtr(d) - M * ndtr(d - s)
    with np.errstate(divide="ignore", invalid="ignore"):
        tail = np.log(incumbent) + log_ndtr(d) + np.log(s / np.maximum(np.abs(d), s))
        # The difference of two products loses its digits near 1e-12 b.
        return np.where(improvement > 1e-10 * incumbent, np.log(improvement), tail)
