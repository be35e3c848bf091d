"""Sensitivity of a study's outcome to its factors, where their points were drawn from distributions."""

import importlib
import importlib.util
import warnings
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from .definition import StudyDefinition
from .summary import NOMINAL, StudySummary

FEWEST_POINTS: Final = 64
MOST_POINTS: Final = 4096
"""Points that are looked at: more change nothing that the interval does not cover."""
_SEED: Final = 0


@dataclass(frozen=True)
class Sensitivity:
    """Part of the variance of an outcome that a factor explains alone."""

    scenario: str
    """Name of the scenario."""
    estimator: str
    """Name of the estimator."""
    factor: str
    """Name of the factor."""
    first_order: float
    """Part of the variance, from 0 to 1 but for its error."""
    half_width: float
    """Half the width of its 95 % interval, by bootstrap."""


def has_salib() -> bool:
    """Return whether the package is installed that computes sensitivities."""
    return importlib.util.find_spec("SALib") is not None


def allows_sensitivity(definition: StudyDefinition) -> bool:
    """Return whether the design of a study allows it: all factors drawn together, at enough points."""
    if any(part.factors for part in definition.scenarios.values()):
        return False
    drawn = [factor.distribution is not None for factor in definition.factors.values()]
    return bool(drawn) and all(drawn) and definition.study.samples >= FEWEST_POINTS


def sensitivities(definition: StudyDefinition, summary: StudySummary) -> list[Sensitivity]:
    """Return first-order sensitivities by RBD-FAST (Tarantola, Gatelli and Mara, 2006), of which SALib has the code.

    The outcome is the logarithm of the ratio to the nominal controller's error, or of the error where there is no
    nominal controller. The points must have been drawn, see allows_sensitivity.
    """
    analyze: Any = importlib.import_module("SALib.analyze.rbd_fast").analyze
    names = list(definition.factors)
    has_nominal = np.isfinite(summary.ratio).any()
    outcome = summary.ratio if has_nominal else summary.columns["mse"]
    found: list[Sensitivity] = []
    for row in summary.rows():
        if has_nominal and row.estimator == NOMINAL:
            continue
        chosen = (summary.columns["scenario"] == row.scenario) & (summary.columns["estimator"] == row.estimator)
        chosen &= np.isfinite(outcome) & (outcome > 0.0)
        x = np.stack([summary.columns[name][chosen].astype(float) for name in names], axis=1)[:MOST_POINTS]
        y = np.log(outcome[chosen])[:MOST_POINTS]
        if len(y) < FEWEST_POINTS or np.ptp(y) == 0.0:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            problem = {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
            made = analyze(problem, x, y, num_resamples=100, seed=_SEED)
        found += [
            Sensitivity(row.scenario, row.estimator, name, float(s), float(half))
            for name, s, half in zip(names, made["S1"], made["S1_conf"], strict=True)
        ]
    return found
