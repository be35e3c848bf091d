"""Estimators on GPy's own models: the same candidates as in LAPACK, any kernel, and a model to look at."""

import GPy
import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimator import NoEstimateError, PaperBO, PaperSettings, Parameter, ParameterSpace, TargetSettings, TargetVector
from estimator.bayesian.acquisition import expected_improvement

BODY = ParameterSpace(tuple(Parameter(name, 0.1, 10.0, "1", "log") for name in ("m", "J")))
VALLEY = ParameterSpace((Parameter("a", -2.0, 2.0), Parameter("b", -1.0, 3.0)))
FOUR = ParameterSpace(tuple(Parameter(name, 0.1, 10.0, "1", "log") for name in "abcd"))
ROWS = np.random.default_rng(0).normal(size=(8, 2))
TIMES = np.linspace(0.0, 3.0, 25)


def body(theta):
    return ROWS @ [1.0 / 1.7 - 1.0 / theta[0], 3.0 - theta[1]] / 1e-3 + np.random.default_rng(1).standard_normal(8)


def valley(theta):
    return np.array([10.0 * (theta[1] - theta[0] ** 2), 1.0 - theta[0]]) / 0.1


def wave(theta):
    def signal(p):
        return p[0] * np.exp(-p[1] * TIMES) + p[2] * np.cos(p[3] * TIMES / 3.0)

    return (signal(theta) - signal(np.array([2.0, 0.5, 1.0, 5.0]))) / 0.01


PROBLEMS = {
    "a body": (BODY, (1.0, 1.0), body),
    "a valley": (VALLEY, (-1.2, 1.0), valley),
    "a wave": (FOUR, (1.0, 1.0, 1.0, 1.0), wave),
}


def advance(estimator, residual, n):
    for _ in range(n):
        theta = estimator.ask()
        estimator.tell(theta, residual(theta))
    return estimator


def largest_difference(problem, kind, settings, n, seed):
    """Compare n candidates, each asked of both surrogates after the same ones before, in the unit cube."""
    space, start, residual = problem
    fast, gpy = (kind(space, np.array(start), np.random.default_rng(seed), s) for s in settings)
    worst = 0.0
    for _ in range(n):
        theta = fast.ask()
        worst = max(worst, float(np.abs(space.to_unit(theta) - space.to_unit(gpy.ask())).max()))
        for estimator in (fast, gpy):
            estimator.tell(theta, residual(theta))
    return worst, fast, gpy


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_target_asks_for_the_same_candidate_with_either_surrogate(problem, seed):
    """Measured 1e-11 to 7e-9. Refits are included: both search in the same coordinates."""
    settings = (TargetSettings(), TargetSettings(surrogate="gpy"))
    worst, fast, gpy = largest_difference(problem, TargetVector, settings, 35, seed)
    assert worst < 1e-6
    # Estimates are candidates, or places with directions held, which the surrogate's slopes decide on.
    assert_allclose(gpy.estimate().theta, fast.estimate().theta, rtol=1e-6)
    assert_allclose(gpy.estimate().std, fast.estimate().std, rtol=1e-3)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("problem", PROBLEMS.values(), ids=PROBLEMS)
def test_bo_scalar_asks_for_the_same_candidate_with_either_surrogate(problem, seed):
    settings = (PaperSettings(refits="seldom"), PaperSettings(refits="seldom", surrogate="gpy"))
    worst, fast, gpy = largest_difference(problem, PaperBO, settings, 28, seed)
    assert worst < 1e-6
    assert_allclose(gpy.estimate().std, fast.estimate().std, rtol=1e-6)


def test_a_batch_is_the_same_with_either_surrogate():
    batches = []
    for surrogate in ("auto", "gpy"):
        settings = TargetSettings(surrogate=surrogate)
        estimator = TargetVector(BODY, np.ones(2), np.random.default_rng(0), settings)
        batches.append(np.array(advance(estimator, body, 12).ask_many(4)))
    assert len(np.unique(batches[0], axis=0)) == 4
    assert_allclose(batches[1], batches[0], rtol=1e-6)


def test_paper_is_gpys_regression_its_l_bfgs_and_its_prediction():
    """The candidate after the design is that of GPy used by hand, with the same draws."""
    settings = PaperSettings(surrogate="gpy", noise=0.0)
    estimator = advance(PaperBO(VALLEY, np.zeros(2), np.random.default_rng(3), settings), valley, 8)
    told = estimator.model
    kernel = GPy.kern.Matern52(2, ARD=True)
    kernel.variance.constrain_bounded(1e-3, 1e3, warning=False)
    kernel.lengthscale.constrain_bounded(0.02, 10.0, warning=False)
    by_hand = GPy.models.GPRegression(told.X.copy(), told.Y.copy(), kernel, normalizer=True, noise_var=0.01)
    by_hand.likelihood.variance.constrain_bounded(1e-6, 1.0, warning=False)
    by_hand.optimize("lbfgsb")
    asked = VALLEY.to_unit(estimator.ask())
    assert_allclose(estimator.model.param_array, by_hand.param_array, rtol=1e-9)
    improvement = [
        expected_improvement(mean[:, 0], variance[:, 0], float(told.Y.min()))
        for mean, variance in map(by_hand.predict_noiseless, (asked[None], np.random.default_rng(0).random((400, 2))))
    ]
    # The best of a pool of 576 against the best of 400 other places; a random one has half of it in the median.
    assert improvement[0][0] > 0.95 * improvement[1].max()


def test_the_model_of_target_is_gpys_and_predicts_what_target_expects():
    settings = (TargetSettings(), TargetSettings(surrogate="gpy"))
    _, estimator, with_gpy = largest_difference(PROBLEMS["a body"], TargetVector, settings, 25, 0)
    fast, gpy = estimator.model, with_gpy.model
    assert isinstance(fast, GPy.models.GPRegression)
    assert isinstance(gpy, GPy.models.GPRegression)
    # L-BFGS ends where the likelihood no longer grows: within 2e-5 of the other's lengthscales, by the processor.
    assert_allclose(fast.kern.lengthscale, gpy.kern.lengthscale, rtol=1e-4)
    Q = np.random.default_rng(1).random((30, 2))
    for a, b in zip(fast.predict_noiseless(Q), gpy.predict_noiseless(Q), strict=True):
        assert_allclose(a, b, atol=1e-4 * np.abs(a).max())
    candidates = BODY.to_unit(estimator.candidates)
    assert all(np.isclose(candidates, z, atol=1e-12).all(axis=1).any() for z in np.asarray(fast.X))
    assert_allclose(fast.predict_noiseless(fast.X)[0], fast.Y, atol=1e-3)  # without noise it meets its data


@pytest.mark.parametrize("surrogate", ["auto", "gpy"])
def test_the_model_of_a_norm_has_the_norms_unit_and_is_saved_and_loaded(surrogate, tmp_path):
    settings = PaperSettings(surrogate=surrogate, noise=0.0)
    estimator = advance(PaperBO(VALLEY, np.zeros(2), np.random.default_rng(0), settings), valley, 12)
    model = estimator.model
    norms = [np.linalg.norm(valley(VALLEY.from_unit(z))) for z in np.asarray(model.X)]
    assert_allclose(np.asarray(model.Y)[:, 0], norms)
    model.save_model(str(tmp_path / "model"))
    loaded = GPy.models.GPRegression.load_model(str(tmp_path / "model.zip"))
    Q = np.random.default_rng(1).random((9, 2))
    for a, b in zip(loaded.predict(Q), model.predict(Q), strict=True):
        assert_allclose(a, b, rtol=1e-9)


def test_changing_the_model_changes_nothing_in_the_estimator():
    asked = []
    for is_changed in (False, True):
        settings = TargetSettings(surrogate="gpy")
        estimator = advance(TargetVector(BODY, np.ones(2), np.random.default_rng(0), settings), body, 12)
        if is_changed:
            estimator.model.kern.lengthscale[:] = 0.21
            estimator.model.X[:] = 0.5
        asked.append(estimator.ask())
    np.testing.assert_array_equal(*asked)


@pytest.mark.parametrize(("kind", "settings"), [(TargetVector, TargetSettings()), (PaperBO, PaperSettings())])
def test_there_is_no_model_before_a_candidate_has_succeeded(kind, settings):
    with pytest.raises(NoEstimateError, match="no candidate has succeeded yet"):
        _ = kind(BODY, np.ones(2), np.random.default_rng(0), settings).model


KERNELS = [
    "Matern52 + Linear",
    "RBF * StdPeriodic(period=2.0)",
    "Matern32 * (Bias + Linear)",
    "RatQuad",
    "Poly(order=3)",
    "RBF(active_dims=[0]) * Matern52(active_dims=[1])",
]


@pytest.mark.full_but(KERNELS[0], KERNELS[-1])
@pytest.mark.parametrize("kernel", KERNELS)
def test_target_finds_the_minimum_with_any_smooth_kernel(kernel):
    """Poly has no slopes in GPy: they are taken by differences."""
    settings = TargetSettings(kernel=kernel)
    estimator = advance(TargetVector(BODY, np.ones(2), np.random.default_rng(0), settings), body, 30)
    truth = np.linalg.lstsq(ROWS, ROWS @ [1.0 / 1.7, 3.0] + 1e-3 * np.random.default_rng(1).standard_normal(8))[0]
    # A tenth of the standard deviations, which are 1e-3 and 5e-4; Exponential, which is not smooth, is 4 of them away.
    assert_allclose(estimator.estimate().theta, [1.0 / truth[0], truth[1]], atol=1e-4)
    assert estimator.model.kern.name != "rbf"


@pytest.mark.parametrize("kernel", ["Matern32", "Matern52 + Bias", "Exponential * RBF"])
def test_a_norm_is_modelled_with_any_kernel(kernel):
    settings = PaperSettings(kernel=kernel, refits="seldom")
    estimator = advance(PaperBO(VALLEY, np.zeros(2), np.random.default_rng(0), settings), valley, 20)
    assert estimator.estimate().cost < 20.0  # that of random places is 180 in the median
    assert type(estimator.model.kern).__name__ in ("Matern32", "Add", "Prod")


class Steep(GPy.kern.RBF):
    """A kernel of the user's own."""

    def K_of_r(self, r):
        return 0.5 * (super().K_of_r(r) + self.variance * np.exp(-2.0 * r**2))

    def dK_dr(self, r):
        return 0.5 * super().dK_dr(r) - 2.0 * r * self.variance * np.exp(-2.0 * r**2)


OWN = {
    "an object": GPy.kern.Matern52(2, ARD=True),
    "a function": lambda d: GPy.kern.Matern52(d, ARD=True),
    "a class": Steep,
}


@pytest.mark.parametrize("kernel", OWN.values(), ids=OWN)
def test_the_users_own_kernel_is_taken_and_left_alone(kernel):
    before = None if callable(kernel) else np.array(kernel.param_array)
    target = TargetVector(BODY, np.ones(2), np.random.default_rng(0), kernel=kernel)
    assert_allclose(advance(target, body, 30).estimate().theta, [1.6996, 2.9991], atol=1e-3)
    norm = PaperBO(BODY, np.ones(2), np.random.default_rng(0), kernel=kernel)
    assert type(advance(norm, body, 9).model.kern) is type(target.model.kern)
    if before is not None:
        np.testing.assert_array_equal(kernel.param_array, before)


def test_the_prior_and_the_fixes_of_the_users_kernel_are_kept():
    kernel = GPy.kern.Matern52(2, ARD=True)
    kernel.lengthscale.set_prior(GPy.priors.LogGaussian(np.log(0.5), 1e-3), warning=False)
    kernel.variance.fix(warning=False)
    target = TargetVector(BODY, np.ones(2), np.random.default_rng(0), kernel=kernel)
    found = advance(target, body, 20).model.kern
    assert_allclose(found.lengthscale, 0.5, rtol=0.02)
    assert found.variance[0] == 1.0


def test_numpys_global_random_state_is_left_alone():
    before = np.random.get_state()  # noqa: NPY002
    advance(PaperBO(BODY, np.ones(2), np.random.default_rng(0), PaperSettings(surrogate="gpy")), body, 8)
    advance(TargetVector(BODY, np.ones(2), np.random.default_rng(0), TargetSettings(kernel="Matern52")), body, 8)
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
