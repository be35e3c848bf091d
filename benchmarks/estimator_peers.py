"""Other people's Bayesian optimisers on our residuals: a function for each, with the settings of its documentation.

All search the unit cube, which `ParameterSpace` maps to the bounds (logarithmically where the scenario says so), begin
with five random points, and minimise the Euclidean norm of the residual, without the noise that `paper` and `bo-scalar`
add to it; BoTorch's composite sees the residual itself. Each function imports its own package, so that one which is
missing or broken does not affect the others, and evaluates `n_evaluations` times.
"""

import sys
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimator import ParameterSpace, ResidualWindow, Vector

N_INITIAL = 5
"""Number of random points with which a search begins."""


class UnitObjective:
    """The residual as a function of points in the unit cube, and the best point so far."""

    def __init__(self, space: ParameterSpace, window: ResidualWindow) -> None:
        self._space, self._window = space, window
        self.n_evaluations = 0
        """Number of evaluations so far."""
        self.least = np.inf
        """Least norm so far."""
        self.theta = space.from_unit(np.full(len(space), 0.5))
        """Parameters (d,) of that norm."""

    def __len__(self) -> int:
        return len(self._space)

    def residual(self, z: Vector) -> Vector:
        """Return the residual (D,) at a point z (d,)."""
        self.n_evaluations += 1
        theta = self._space.from_unit(np.asarray(z, dtype=float))
        residual = self._window.residual(theta)
        norm = float(np.linalg.norm(residual))
        if norm < self.least:
            self.least, self.theta = norm, theta
        return residual

    def norm(self, z: Vector) -> float:
        """Return the Euclidean norm of the residual at a point z (d,)."""
        return float(np.linalg.norm(self.residual(z)))

    def column(self, Z: Vector) -> Vector:
        """Return the norms (n, 1) at points Z (n, d), in the shape that GPy-based packages expect."""
        return np.array([[self.norm(z)] for z in np.atleast_2d(Z)])


Search = Callable[[UnitObjective, int, int], None]
"""Search of the form search(objective, n_evaluations, seed); its result is the objective's best point."""


def emukit(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run Emukit's ready-made loop on GPy: Matern-5/2, EI, refitted at every evaluation."""
    from emukit.core import ContinuousParameter
    from emukit.examples.gp_bayesian_optimization.single_objective_bayesian_optimization import GPBayesianOptimization

    np.random.seed(seed)  # noqa: NPY002  GPy's restarts and Emukit's anchor points draw from the global stream
    X = _initial(objective, seed)
    names = [ContinuousParameter(f"z{i}", 0.0, 1.0) for i in range(len(objective))]
    GPBayesianOptimization(names, X, objective.column(X)).run_optimization(objective.column, n_evaluations - len(X))


def gpyopt(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run GPyOpt with its defaults: Matern-5/2, EI, refitted at every evaluation. Last released in 2020."""
    _stand_in_for_pkg_resources()
    from GPyOpt.methods import BayesianOptimization

    np.random.seed(seed)  # noqa: NPY002  it has no other seed
    domain = [{"name": f"z{i}", "type": "continuous", "domain": (0.0, 1.0)} for i in range(len(objective))]
    search = BayesianOptimization(objective.column, domain, initial_design_numdata=N_INITIAL)
    search.run_optimization(n_evaluations - N_INITIAL, eps=-1.0)  # by default it ends when it repeats a point


def botorch(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run BoTorch as in its README: SingleTaskGP (standardised, RBF, log-normal prior), LogEI, 5 restarts of 20."""
    import torch
    from botorch.acquisition import LogExpectedImprovement

    X = torch.tensor(_initial(objective, seed))
    Y = -torch.tensor(objective.column(X.numpy()))
    torch.manual_seed(seed)
    while len(X) < n_evaluations:
        z = _best_by(LogExpectedImprovement(_fitted(X, Y), best_f=Y.max()))
        X, Y = torch.cat([X, z]), torch.cat([Y, -torch.tensor(objective.column(z.numpy()))])


def botorch_composite(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run BoTorch's composite: a GP for each residual, qLogEI of minus their sum of squares, 128 Sobol samples."""
    import torch
    from botorch.acquisition.logei import qLogExpectedImprovement
    from botorch.acquisition.objective import GenericMCObjective
    from botorch.sampling import SobolQMCNormalSampler

    def residuals(Z: Any) -> Any:
        return torch.tensor(np.array([objective.residual(z) for z in Z.numpy()]))

    X = torch.tensor(_initial(objective, seed))
    Y = residuals(X)
    torch.manual_seed(seed)
    cost = GenericMCObjective(lambda samples, X=None: -samples.square().sum(-1))
    while len(X) < n_evaluations:
        sampler = SobolQMCNormalSampler(torch.Size([128]), seed=seed)
        best = cost(Y).max()
        z = _best_by(qLogExpectedImprovement(_fitted(X, Y), best_f=best, sampler=sampler, objective=cost))
        X, Y = torch.cat([X, z]), torch.cat([Y, residuals(z)])


def scikit_optimize(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run gp_minimize with its defaults: Matern-5/2, gp_hedge over EI, PI and LCB."""
    from skopt import gp_minimize

    bounds = [(0.0, 1.0)] * len(objective)
    gp_minimize(objective.norm, bounds, n_calls=n_evaluations, n_initial_points=N_INITIAL, random_state=seed)


def bayesian_optimization(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run bayesian-optimization with its defaults: Matern-5/2, upper confidence bound, kappa 2.576. It maximises."""
    from bayes_opt import BayesianOptimization

    names = [f"z{i}" for i in range(len(objective))]
    search = BayesianOptimization(
        lambda **z: -objective.norm(np.array([z[name] for name in names])),
        dict.fromkeys(names, (0.0, 1.0)),
        random_state=seed,
        verbose=0,
        allow_duplicate_points=True,  # otherwise a repeated point ends it with an error
    )
    search.maximize(init_points=N_INITIAL, n_iter=n_evaluations - N_INITIAL)


def optuna(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run GPSampler with its defaults (Matern-5/2, LogEI), but five random trials instead of ten."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=optuna.samplers.GPSampler(seed=seed, n_startup_trials=N_INITIAL))
    names = [f"z{i}" for i in range(len(objective))]
    study.optimize(
        lambda trial: objective.norm(np.array([trial.suggest_float(name, 0.0, 1.0) for name in names])),
        n_trials=n_evaluations,
    )


def smt_ego(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run SMT's EGO as in its manual: kriging (KRG), EI."""
    from smt.applications import EGO
    from smt.design_space import DesignSpace
    from smt.surrogate_models import KRG

    space = DesignSpace([(0.0, 1.0)] * len(objective), seed=seed)
    EGO(
        n_iter=n_evaluations - N_INITIAL,
        criterion="EI",
        xdoe=_initial(objective, seed),
        surrogate=KRG(design_space=space, print_global=False),
        seed=seed,
    ).optimize(fun=objective.column)


def pybads(objective: UnitObjective, n_evaluations: int, seed: int) -> None:
    """Run PyBADS with its defaults (mesh-adaptive direct search with a local GP) and design, from a random point."""
    from pybads import BADS

    d = len(objective)
    start = _initial(objective, seed)[0]
    # It starts within the plausible bounds and may go to the hard ones; the manual asks for some distance between.
    options = {"max_fun_evals": n_evaluations, "display": "off", "random_seed": seed}
    bounds = [np.full(d, place) for place in (0.0, 1.0, 0.05, 0.95)]
    BADS(objective.norm, start, *bounds, options=options).optimize()


@dataclass(frozen=True)
class Peer:
    """An optimiser that is not ours."""

    package: str
    """Name of its distribution, for pip."""
    module: str
    """Name of the module that it imports."""
    search: Search
    """Function that runs it."""


PEERS: dict[str, Peer] = {
    "emukit": Peer("emukit", "emukit", emukit),
    "gpyopt": Peer("GPyOpt", "GPyOpt", gpyopt),
    "botorch": Peer("botorch", "botorch", botorch),
    "botorch-composite": Peer("botorch", "botorch", botorch_composite),
    "scikit-optimize": Peer("scikit-optimize", "skopt", scikit_optimize),
    "bayesian-optimization": Peer("bayesian-optimization", "bayes_opt", bayesian_optimization),
    "optuna-gp": Peer("optuna", "optuna", optuna),
    "smt-ego": Peer("smt", "smt", smt_ego),
    "pybads": Peer("pybads", "pybads", pybads),
}


def _initial(objective: UnitObjective, seed: int) -> Vector:
    return np.random.default_rng([seed, 3]).random((N_INITIAL, len(objective)))


def _fitted(X: Any, Y: Any) -> Any:
    """Return a batch with a GP for each output, hyperparameters by maximum a posteriori."""
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch.mlls import ExactMarginalLogLikelihood

    model = SingleTaskGP(X, Y)
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def _best_by(acquisition: Any) -> Any:
    """Return the point (1, d) where an acquisition function is largest."""
    import torch
    from botorch.optim import optimize_acqf

    d = acquisition.model.train_inputs[0].shape[-1]
    bounds = torch.stack([torch.zeros(d), torch.ones(d)]).double()
    return optimize_acqf(acquisition, bounds=bounds, q=1, num_restarts=5, raw_samples=20)[0]


def _stand_in_for_pkg_resources() -> None:
    """Provide the pkg_resources that GPyOpt asks for its own version; setuptools has dropped that module."""
    if "pkg_resources" not in sys.modules:
        module: Any = types.ModuleType("pkg_resources")
        module.DistributionNotFound = LookupError
        module.get_distribution = lambda name: types.SimpleNamespace(version="", location="")
        sys.modules["pkg_resources"] = module
