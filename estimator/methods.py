"""The estimators by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from .baselines.kalman import EnsembleKalman, EnsembleSettings, UnscentedKalman, UnscentedSettings
from .baselines.moving_horizon import MovingHorizon, MovingHorizonSettings
from .baselines.recursive_least_squares import RecursiveLeastSquares, RecursiveSettings
from .baselines.solvers import LeastSquares, LeastSquaresSettings, NoisyNorm, NormSettings
from .bayesian.paper import PaperBO, PaperSettings
from .bayesian.target import TargetSettings, TargetVector


@dataclass(frozen=True)
class Method:
    """Estimator with its settings and its usual configuration."""

    estimator: type[Any]
    """Class, called with (space, start, rng, settings)."""
    settings: type[Any]
    """Frozen dataclass of its settings."""
    like: str | None = None
    """Name of the method whose settings it takes where it has none of its own."""
    defaults: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Values that differ from the defaults of its settings' class or of the loop: `trigger`, `window`, ..."""
    sample_defaults: Mapping[str, Any] = field(default_factory=dict[str, Any])
    """Such values where it takes samples with derivatives one by one, each once."""
    needs_linear_form: bool = False
    """True where it works only with a model whose linear form is known."""
    needs_derivatives: bool = False
    """True where it works only sample by sample."""
    needs_package: str | None = None
    """Package that it imports beside NumPy, SciPy and GPy."""
    jumps: bool = True
    """True where parameters that the diagnosis has found are written in place of an estimate that lags behind."""

    @property
    def setting_names(self) -> tuple[str, ...]:
        """Names of the settings that a scenario may set."""
        return tuple(f.name for f in fields(self.settings))


# One solve an episode, on the newest sample; a tracking error that stays triggers the next.
_ONE_SOLVE = {"budget": 1, "evaluations_per_step": 1, "window": 1}
_RECURSIVE = {"trigger": {"kind": "always"}, "evaluations_per_step": 1, "window": 1}
# On a noisy function Ipopt's line searches take a hundred evaluations an iteration.
_IPOPT = {"minimizer": "ipopt", "max_iterations": 10}
# Commits each candidate, one a time step, looks at the newest sample alone, and leaves the regression to GPy.
_ALGORITHM_1 = {"commit": "candidate", "evaluations_per_step": 1, "window": 1, "surrogate": "gpy"}
_BO_SCALAR = {"commit": "incumbent", "refits": "seldom", "surrogate": "auto"}

METHODS: dict[str, Method] = {
    "target": Method(TargetVector, TargetSettings),
    "paper": Method(PaperBO, PaperSettings, None, _ALGORITHM_1),
    "bo-scalar": Method(PaperBO, PaperSettings, "paper", _BO_SCALAR),
    "ipm": Method(NoisyNorm, NormSettings, "paper", _ONE_SOLVE | _IPOPT, needs_package="cyipopt"),
    "ipm-scipy": Method(NoisyNorm, NormSettings, "paper", _ONE_SOLVE | {"minimizer": "trust-constr"}),
    "sqp": Method(NoisyNorm, NormSettings, "paper", _ONE_SOLVE | {"minimizer": "SLSQP"}),
    "least-squares": Method(LeastSquares, LeastSquaresSettings),
    "multi-start": Method(LeastSquares, LeastSquaresSettings, "least-squares", {"n_starts": 8}),
    "rls": Method(RecursiveLeastSquares, RecursiveSettings, None, {}, _RECURSIVE, True, True, "filterpy"),
    "ukf": Method(UnscentedKalman, UnscentedSettings, None, {}, _RECURSIVE),
    "enkf": Method(EnsembleKalman, EnsembleSettings, None, {}, _RECURSIVE),
    "mhe": Method(MovingHorizon, MovingHorizonSettings, None, {}, _RECURSIVE),
}
FORMER_METHODS: dict[str, Method] = {
    f"{name}-wide-step": replace(METHODS[name], like=name, defaults={"difference_step": 0.05})
    for name in ("ipm", "ipm-scipy", "sqp")
}
"""Former names of estimators, each now the method `like` with the settings `defaults`."""


def method_named(name: str) -> Method:
    """Return the method with that present or former name. Raises KeyError."""
    return FORMER_METHODS[name] if name in FORMER_METHODS else METHODS[name]
