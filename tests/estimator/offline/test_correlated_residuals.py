"""Deviations under correlated residuals, against closed-form covariances and Monte Carlo."""

import numpy as np
import pytest
from scipy.linalg import block_diag, toeplitz

from estimator import Parameter, ParameterSpace
from estimator.offline.correlated_residuals import autocovariances, information_of_correlated
from estimator.offline.fit import fit

N = 1500
X = np.linspace(0.0, 1.0, N)
BASIS = np.column_stack([np.ones(N), X - 0.5, np.sin(40.0 * X)])
"""A level, a trend and an oscillation: correlation from row to row hurts the first two far more than the last."""


def correlated(rng, a, n=N):
    """An autoregressive process of variance one."""
    e = np.sqrt(1.0 - a * a) * rng.standard_normal(n)
    e[0] = rng.standard_normal()
    for k in range(1, n):
        e[k] += a * e[k - 1]
    return e


def exact_std(a, basis=BASIS):
    """Covariance of the least-squares estimate, in closed form."""
    inverse = np.linalg.inv(basis.T @ basis)
    return np.sqrt(np.diag(inverse @ basis.T @ toeplitz(a ** np.arange(len(basis))) @ basis @ inverse))


def std_of(information):
    return np.sqrt(np.diag(np.linalg.inv((information.directions.T * information.singular_values**2)
                                         @ information.directions)))  # fmt: skip


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9, 0.97])
def test_deviations_are_those_of_the_closed_form(a):
    rng = np.random.default_rng(1)
    ratios, errors = [], []
    for _ in range(60):
        e = correlated(rng, a)
        estimate = np.linalg.lstsq(BASIS, e, rcond=None)[0]
        r = e - BASIS @ estimate
        misfit = np.sqrt(r @ r / (N - 3))
        std = std_of(information_of_correlated(BASIS, r, misfit, [N]))
        ratios.append(std / exact_std(a))
        errors.append(estimate / std)
    assert np.median(ratios, axis=0) == pytest.approx(np.ones(3), abs=0.2 if a < 0.95 else 0.35)
    assert np.count_nonzero(np.abs(errors) < 1.96) >= (160 if a < 0.95 else 150)  # of 180: 171 expected


def test_white_residuals_have_the_deviations_of_least_squares():
    r = np.random.default_rng(0).standard_normal(N)
    misfit = np.sqrt(r @ r / (N - 3))
    expected = misfit * np.sqrt(np.diag(np.linalg.inv(BASIS.T @ BASIS)))
    assert std_of(information_of_correlated(BASIS, r, misfit, [N])) == pytest.approx(expected, rel=1e-9)


def test_each_series_has_a_correlation_of_its_own():
    """Level of a white and of a correlated series, side by side."""
    rng = np.random.default_rng(3)
    r = np.concatenate([rng.standard_normal(N), correlated(rng, 0.9)])
    basis = np.kron(np.eye(2), np.ones((N, 1)))
    std = std_of(information_of_correlated(basis, r, 1.0, [N, N]))
    assert std[0] == pytest.approx(N**-0.5, rel=0.1)
    assert std[1] == pytest.approx(exact_std(0.9, np.ones((N, 1)))[0], rel=0.4)


def test_noisy_start_values_widen_the_deviations_as_the_closed_form_says():
    """Two windows, each begun off by a level and a trend of its own."""
    r = np.random.default_rng(2).standard_normal(N)
    starts = [5.0 * BASIS[:500, :2], 3.0 * BASIS[500:, :2]]
    G = block_diag(*starts)
    inverse = np.linalg.inv(BASIS.T @ BASIS)
    expected = np.sqrt(np.diag(inverse @ BASIS.T @ (np.eye(N) + G @ G.T) @ BASIS @ inverse))
    found = std_of(information_of_correlated(BASIS, r, 1.0, [500, 1000], starts))
    assert found[:2] == pytest.approx(expected[:2], rel=1e-3)
    assert np.all(expected[:2] > 50.0 * np.sqrt(np.diag(inverse)[:2]))


@pytest.mark.parametrize("n", [1, 2, 5, 7])
def test_series_of_a_few_rows_are_taken_too(n):
    assert np.all(np.isfinite(autocovariances(np.arange(1.0, n + 1.0))))
    assert autocovariances(np.zeros(n)).tolist() == [0.0] * n


@pytest.mark.full
def test_the_deviations_of_a_fit_cover_the_truth_under_correlated_noise():
    space = ParameterSpace((Parameter("a", 0.1, 10.0, "m", "log"), Parameter("b", 0.0, 3.0, "1/s")))

    class Decay:
        n_evaluations = 0

        def __init__(self, y):
            self._y = y

        def __call__(self, theta):
            return self.many([theta])[0]

        def many(self, thetas):
            self.n_evaluations += len(thetas)
            return [(a * np.exp(-4.0 * b * X) - self._y) / 0.02 for a, b in thetas]

    inside = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        y = 2.0 * np.exp(-4.0 * 0.7 * X) + 0.02 * correlated(rng, 0.8)
        found = fit(Decay(y), space, np.array([1.5, 0.9]), "least-squares", rng=rng)
        inside += np.count_nonzero(np.abs(found.theta - [2.0, 0.7]) < 1.96 * found.std)
        assert np.all(found.white_std < 0.6 * found.std)
    assert inside >= 68  # of 80: 76 expected
