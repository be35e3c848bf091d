"""Kernels from a text: names of GPy's, sums and products, and nothing else."""

import GPy
import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import PaperSettings, Parameter, ParameterSpace, TargetSettings, TargetVector
from estimator.bayesian.kernels import KernelBounds, check_kernel, fix_scale, kernel_from_text

PLACES = np.random.default_rng(0).random((7, 2))
BOUNDS = KernelBounds((1e-3, 1e3), (0.2, 5.0), (0.0, 0.7))
PLANE = ParameterSpace((Parameter("a", 0.0, 1.0), Parameter("b", 0.0, 1.0)))


def test_sums_and_products_are_gpys():
    made = kernel_from_text("Matern52 * (Bias + StdPeriodic(period=0.5)) + Linear", 2, BOUNDS)
    by_hand = GPy.kern.Matern52(2, ARD=True) * (
        GPy.kern.Bias(2) + GPy.kern.StdPeriodic(2, period=0.5)
    ) + GPy.kern.Linear(2, ARD=True)
    assert_allclose(made.K(PLACES), by_hand.K(PLACES), rtol=1e-12)


def test_each_dimension_has_a_lengthscale_and_a_part_may_take_one_dimension_only():
    made = kernel_from_text("RBF + Brownian(active_dims=[1])", 2, BOUNDS)
    assert made.parts[0].lengthscale.size == 2
    assert_allclose(made.K(PLACES), GPy.kern.RBF(2).K(PLACES) + GPy.kern.Brownian(1).K(PLACES[:, 1:]))


def test_bounds_and_prior_are_set():
    kernel = kernel_from_text("Matern52(lengthscale=0.5)", 2, BOUNDS)
    bounds = [(c.lower, c.upper) for c in kernel.lengthscale.constraints.properties() if hasattr(c, "lower")]
    assert bounds == [(0.2, 5.0)]
    assert [(p.mu, p.sigma) for p in kernel.lengthscale.priors.properties()] == [(0.0, 0.7)]
    assert_allclose(kernel.lengthscale, 0.5)


@pytest.mark.parametrize(
    ("text", "fixed"),
    [
        ("Matern52", [True]),
        ("Matern52 + RBF", [True, False]),
        ("Matern52 * RBF", [True, True]),
        ("Linear + RBF + Bias", [True, False]),
        ("Matern52 * (RBF + Bias)", [True, True, False]),
    ],
)
def test_the_scale_of_the_whole_is_fixed_and_the_weights_of_parts_are_not(text, fixed):
    kernel = kernel_from_text(text, 2, BOUNDS)
    assert fix_scale(kernel)
    assert [p.is_fixed for p in kernel.flattened_parameters if p.name == "variance"] == fixed


FORM = "kernel must be names of GPy's kernels with \\+ and \\*"
REFUSED = {
    "": FORM,
    "RBF +": FORM,
    "RBF - Linear": FORM,
    "RBF ** 2": FORM,
    "RBF.copy": FORM,
    "RBF(2)": FORM,
    "RBF(lengthscale=x)": FORM,
    "RBF(**{'variance': 2})": FORM,
    "(lambda: RBF)()": FORM,
    "[RBF for _ in (1,)]": FORM,
    "__import__('os').system('true')": FORM,
    "RBF\x00": FORM,
    "(" * 150 + "RBF" + ")" * 40: FORM,
    " + ".join(["RBF"] * 80): "kernel must have at most 200 characters, got 477",
    "Matern25": "GPy has no kernel 'Matern25'; did you mean 'Matern52'\\?",
    "os": "GPy has no kernel 'os'",
    "RBF(length=1.0)": "kernel 'RBF' has no option 'length'; it has ARD, active_dims, inv_l, lengthscale, variance",
    "RBF(useGPU=True)": "kernel 'RBF' has no option 'useGPU'",
    "RBF(lengthscale=-1)": "lengthscale of kernel 'RBF' must be numbers from 0 to 100, got -1",
    "Poly(order=1000000000)": "order of kernel 'Poly' must be numbers from 0 to 100",
    "RBF(lengthscale='a')": "lengthscale of kernel 'RBF' must be numbers",
    "RBF(active_dims=0)": "active_dims of kernel 'RBF' must be a list of dimensions, from 0, got 0",
    "Coregionalize": "kernel 'Coregionalize' needs more than a text can say; make it in Python",
    "Kern": "kernel 'Kern' needs more than a text can say",
}


@pytest.mark.parametrize("settings", [TargetSettings, PaperSettings])
@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_any_other_text_is_refused(text, settings):
    with pytest.raises(ValueError, match=REFUSED[text]):
        settings(kernel=text)


UNFIT = {
    "Brownian": "kernel 'Brownian' does not work in 2 dimensions: Brownian motion in 1D only",
    "Cosine": "kernel 'Cosine' is no covariance in 2 dimensions",
    "RBF(active_dims=[2])": "does not work in 2 dimensions: index 2 is out of bounds",
    "RBF(lengthscale=50)": "lengthscale in kernel 'RBF\\(lengthscale=50\\)' must be from 0.2 to 5",
}


@pytest.mark.parametrize("text", UNFIT)
def test_a_kernel_that_does_not_fit_the_parameters_is_refused(text):
    check_kernel(text)
    with pytest.raises(ValueError, match=UNFIT[text]):
        TargetVector(PLANE, np.zeros(2), np.random.default_rng(0), TargetSettings(kernel=text))


class Larger(GPy.kern.RBF):
    """Its diagonal, by GPy's rule for stationary kernels, is not the one of its matrix."""

    def K_of_r(self, r):
        return 1.5 * super().K_of_r(r)


OWN = {
    "another diagonal": (Larger(2), "kernel 'rbf' is no covariance in 2 dimensions"),
    "too many dimensions": (GPy.kern.RBF(3), "kernel 'rbf' does not work in 2 dimensions"),
    "no kernel": (5, "kernel must be a GPy.kern.Kern or a function that makes one, got 5"),
    "makes none": (lambda d: d, "kernel '<lambda>' does not work in 2 dimensions"),
    "raises": (lambda d: d // 0, "kernel '<lambda>' does not work in 2 dimensions: integer division or modulo by zero"),
}


@pytest.mark.parametrize(("kernel", "message"), OWN.values(), ids=OWN)
def test_a_users_kernel_that_is_none_is_refused(kernel, message):
    with pytest.raises(ValueError, match=message):
        TargetVector(PLANE, np.zeros(2), np.random.default_rng(0), kernel=kernel)
