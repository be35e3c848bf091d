"""Standard deviations that hold where residuals are correlated from row to row, as those of a real log are."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import scipy  # its parts, 0.3 s, are loaded when they are used

from ..identifiability import Information, information
from ..space import Vector

_QUIET: Final = 5
"""Number of lags without a significant correlation after which there is none."""


def information_of_correlated(
    jacobian: Vector, r: Vector, misfit: float, series: Sequence[int], start_noise: Sequence[Vector] = ()
) -> Information:
    """Return the information of the least-squares estimate, J (D, d), whose residuals r (D,) need not be white.

    Its covariance is (J^T J)^-1 J^T (C + G G^T) J (J^T J)^-1, C the residuals' covariance: of each series, stationary.
    With J = Q R and C white, of variance misfit^2, Q^T C Q / misfit^2 is the identity; what it is more than that widens
    the deviations, what it is less does not narrow them. series: numbers of rows that follow one another, D together.
    start_noise: G by window, the change (n, s) of its rows by a standard deviation of each noisy start value; D rows
    together, or none.
    """
    Q, R = np.linalg.qr(jacobian)
    share = len(r) / max(len(r) - jacobian.shape[1], 1)
    ratio = np.zeros((Q.shape[1], Q.shape[1]))
    start = 0
    for n in series:
        rows = slice(start, start + n)
        start += n
        toeplitz: Any = scipy.linalg.matmul_toeplitz(share * autocovariances(r[rows]) / misfit**2, Q[rows])
        ratio += Q[rows].T @ toeplitz
    for rows, G in zip(np.split(Q, np.cumsum([len(G) for G in start_noise])[:-1]), start_noise, strict=False):
        shared = rows.T @ G / misfit
        ratio += shared @ shared.T
    widening, axes = np.linalg.eigh(0.5 * (ratio + ratio.T))
    return information((axes / np.sqrt(np.maximum(widening, 1.0))).T @ R / misfit)


def autocovariances(r: Vector) -> Vector:
    """Return the autocovariances (n,) of a series of mean zero, tapered to zero beyond those that are significant.

    A flat-top window of a width that follows from the data: Politis (2003), "Adaptive bandwidth choice".
    """
    n = len(r)
    raw = np.fft.irfft(np.abs(np.fft.rfft(r, 2 * n)) ** 2, 2 * n)[:n] / n
    if not raw[0] > 0.0:
        return np.zeros(n)
    is_quiet = np.abs(raw) / raw[0] < 2.0 * np.sqrt(np.log10(max(n, 10)) / n)
    runs = np.convolve(is_quiet[1:], np.ones(_QUIET), "valid") if n > _QUIET else np.zeros(0)
    first = np.flatnonzero(runs == _QUIET)
    m = int(first[0]) if len(first) else n // 2
    lags = np.arange(n)
    return raw * np.clip(2.0 - lags / max(m, 0.5), 0.0, 1.0)
