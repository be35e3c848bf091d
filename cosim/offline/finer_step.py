"""Bias of an estimate by the FMU's own coarse solver, told by a roll-out at half the communication step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimator.identifiability import IDENTIFIABLE_BELOW, information
from estimator.offline.fit import OfflineFit
from estimator.space import ParameterSpace, Vector

from ..fmi.component import Component
from .log_windows import LogWindow
from .rollout import RolloutResidual, Rollouts, SimulatedPlant

_EVEN: Final = 1e-6
"""Share of a step by which rows may miss an even grid, to be simulated at half of it."""


@dataclass(frozen=True)
class FinerStep:
    """The estimates that half the communication step would give, to first order."""

    step: float
    """Half the communication step [s]."""
    change: Mapping[str, float]
    """Change of each estimate, in its unit."""


def finer_step(
    plant: SimulatedPlant,
    component: Component,
    windows: Sequence[LogWindow],
    space: ParameterSpace,
    noise: Vector,
    fit: OfflineFit,
) -> FinerStep | None:
    """Return what half the step would change, by one roll-out of the estimate; None where it cannot be told.

    It cannot where rows are uneven and no step is given, or the FMU takes no such step. Directions that the data do
    not determine stay as they are.
    """
    step = plant.step or _even_step(windows)
    if step is None:
        return None
    with Rollouts(replace(plant, step=0.5 * step), component, windows, 1) as rollouts:
        r = fit.loss.shrunk(RolloutResidual(rollouts, space, windows, noise)(fit.theta))
    if not np.all(np.isfinite(r)):
        return None
    seen = information(np.linalg.qr(fit.jacobian).R / fit.misfit)
    directions = seen.directions[seen.singular_values * IDENTIFIABLE_BELOW > 1.0]
    change = np.zeros(len(space))
    if len(directions):
        change = -directions.T @ np.linalg.lstsq(fit.jacobian @ directions.T, r - fit.residual)[0]
    return FinerStep(0.5 * step, space.named(change * space.slope(fit.theta)))


def _even_step(windows: Sequence[LogWindow]) -> float | None:
    """Return the distance of rows, if it is the same everywhere."""
    steps = np.concatenate([np.diff(w.time) for w in windows])
    mean = float(np.mean(steps))
    return mean if float(np.abs(steps - mean).max()) < _EVEN * mean else None
