"""Noise of a solver, known or made by one that chooses its steps."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from estimator import Parameter, ParameterSpace
from estimator.offline.fit import fit
from estimator.offline.identifiability_report import findings
from estimator.offline.solver_noise import solver_noise

T = np.linspace(0.0, 8.0, 400)
NOISE = 2e-3


class Rolled:
    """Residuals of a simulation, as an objective of roll-outs has them."""

    def __init__(self, simulate, measured):
        self._simulate, self._measured, self.n_evaluations = simulate, measured, 0

    def __call__(self, theta):
        return self.many([theta])[0]

    def many(self, thetas):
        self.n_evaluations += len(thetas)
        return [(self._simulate(*theta) - self._measured) / NOISE for theta in thetas]


def swing(m, c, k, rtol=1e-5, atol=1e-7):
    """Position of a mass on a spring whose other end jumps: only c/m and k/m are seen."""

    def slope(t, y):
        return [y[1], -c / m * y[1] - k / m * (y[0] - (0.3 if t % 1.3 < 0.6 else -0.2))]

    return solve_ivp(slope, (0.0, T[-1]), [0.1, 0.0], "RK45", t_eval=T, rtol=rtol, atol=atol).y[0]


@pytest.mark.parametrize("size", [1e-9, 1e-3, 10.0])
def test_noise_of_known_size_is_measured(size):
    rng = np.random.default_rng(0)

    def residuals(places):
        return [np.sin(3.0 * z[0] + T) + np.exp(z[1] * T / 8.0) + size * rng.standard_normal(len(T)) for z in places]

    assert solver_noise(residuals, np.array([0.4, 0.9])) == pytest.approx(size * np.sqrt(len(T)), rel=0.5)


def test_a_smooth_function_has_none():
    noise = solver_noise(lambda places: [np.sin(3.0 * z[0] + T) * z[1] for z in places], np.array([0.4, 0.9]))
    assert noise < 1e-12


def test_where_evaluations_fail_none_is_known():
    assert solver_noise(lambda places: [np.full(3, np.nan) for _ in places], np.array([0.5])) == 0.0


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("scale", ["log", "linear"])
def test_a_set_that_no_data_determine_is_named_though_the_solver_scatters(seed, scale):
    bounds = {"m": (0.3, 5.0), "c": (0.1, 5.0), "k": (5.0, 90.0)}
    space = ParameterSpace(tuple(Parameter(name, *low_high, "1", scale) for name, low_high in bounds.items()))
    rng = np.random.default_rng(seed)
    measured = swing(1.7, 0.9, 23.0, 1e-10, 1e-12) + NOISE * rng.standard_normal(len(T))
    found = fit(Rolled(swing, measured), space, np.array([1.0, 0.5, 14.0]), rng=rng)
    assert found.solver_noise > 1e-2
    assert not any(found.is_identifiable)
    (word,) = findings(found.information, space, found.theta)
    assert word.startswith("m, c and k trade off: ")
    m, c, k = found.theta
    assert k / m == pytest.approx(23.0 / 1.7, rel=1e-2)
    assert c / m == pytest.approx(0.9 / 1.7, rel=0.1)


@pytest.mark.full
def test_what_the_data_determine_is_not_lost_in_the_solver_s_noise():
    """With m known, c and k are identifiable; their deviations are those of a tight solver."""
    space = ParameterSpace((Parameter("c", 0.1, 5.0, "kg/s", "log"), Parameter("k", 5.0, 90.0, "N/m", "log")))
    measured = swing(1.7, 0.9, 23.0, 1e-10, 1e-12) + NOISE * np.random.default_rng(0).standard_normal(len(T))
    loose, tight = (
        fit(Rolled(lambda c, k, r=r: swing(1.7, c, k, r, 1e-2 * r), measured), space, np.array([0.5, 14.0]))
        for r in (1e-6, 1e-10)
    )
    assert loose.solver_noise > 1e-2 > 10.0 * tight.solver_noise
    assert all(loose.is_identifiable)
    assert loose.std == pytest.approx(tight.std, rel=0.1)
    assert np.abs((loose.theta - tight.theta) / tight.std).max() < 1.0
