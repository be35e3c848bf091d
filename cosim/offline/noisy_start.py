"""Noise of start values that are columns of a log: it is in every residual of a window, from its first row on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.space import ParameterSpace, Vector

from ..fmi.component import Component
from ..fmi.types import is_real
from .log_windows import LogWindow
from .rollout import RolloutResidual, Rollouts, SimulatedPlant, noise_of


@dataclass
class NoisyStart:
    """Start values that are columns of a log, and what their noise does to the residuals."""

    plant: SimulatedPlant
    component: Component
    windows: Sequence[LogWindow]
    space: ParameterSpace
    noise: Vector
    """Standard deviation (c,) of each output's noise."""
    start_noise: Mapping[str, float]
    """Standard deviation of each noisy start value, in its unit."""
    jobs: int
    """Roll-outs at a time."""
    failure: str | None = None
    """Reason why a roll-out begun a standard deviation aside failed, or None."""

    def effects(self, theta: Vector) -> list[Vector]:
        """Return by window the change (n, s) of its residual at theta (d,) by a standard deviation of each value.

        From a roll-out begun aside for each; none where one fails.
        """
        if not self.start_noise:
            return []
        fitted = [w for w in self.windows if w.n_fit]
        moved = [replace(w, start=_moved(w.start, name, s)) for name, s in self.start_noise.items() for w in fitted]
        with Rollouts(self.plant, self.component, [*fitted, *moved], self.jobs) as rollouts:
            residual = RolloutResidual(rollouts, self.space, [*fitted, *moved], self.noise)
            first, *others = residual(theta).reshape(len(self.start_noise) + 1, -1)
        self.failure = residual.evaluations[0][2]
        if self.failure is not None:
            return []
        sizes = [np.count_nonzero(np.isfinite(w.measured[: w.n_fit])) for w in fitted]
        return np.split(np.column_stack([aside - first for aside in others]), np.cumsum(sizes)[:-1])


def start_noise_of(
    columns: Mapping[str, str],
    measured: Mapping[str, str],
    component: Component,
    windows: Sequence[LogWindow],
    noise: Vector,
) -> dict[str, float]:
    """Return the standard deviation of each noisy start value: that of the output with its column, or the column's own.

    columns, measured: column by variable; noise: (c,), of the outputs.
    """
    own = noise_of([replace(w, measured=w.states) for w in windows]).tolist()
    outputs = [(column, component.unit(name), s) for (name, column), s in zip(measured.items(), noise, strict=True)]
    found: dict[str, float] = {}
    for (name, column), s in zip(columns.items(), own, strict=True):
        same = [float(of) for other, unit, of in outputs if (other, unit) == (column, component.unit(name))]
        found[name] = same[0] if same else s
    return {name: s for name, s in found.items() if s > 0.0 and is_real(component.variables[name].type)}


def _moved(start: Mapping[str, float], name: str, by: float) -> dict[str, float]:
    return {**start, name: start[name] + by}
