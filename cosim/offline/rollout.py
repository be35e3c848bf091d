"""Roll-outs: the plant FMU simulated over windows of a log at candidate parameters, and the residuals.

Each roll-out begins in a newly made instance, in a process of its own; several processes work at the same time.
"""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from estimator.space import ParameterSpace, Vector

from ..fmi.archive import capabilities, has_fixed_step
from ..fmi.component import Component
from ..objectives.rollout_pool import Pool
from ..slaves.slave import Slave, open_slave
from .log_windows import LogWindow
from .logs import LogError
from .swapped_columns import cross_misfit

LARGEST: Final = 1e9
"""Residual [standard deviations] beyond which a simulation has diverged, however far."""
_UNEVEN: Final = 0.05
"""Share of a step by which time stamps may miss an even grid, or a communication point: they are rounded."""
_FEW: Final = 20
"""Number of third differences below which their median is too uncertain to tell the noise."""


@dataclass(frozen=True)
class SimulatedPlant:
    """The FMU that is simulated, and its variables."""

    fmu: Path
    inputs: tuple[str, ...]
    """Inputs, set at each row and held until the next."""
    outputs: tuple[str, ...]
    """Outputs that are compared with the measured ones."""
    start: Mapping[str, float]
    """Start values that are the same in every roll-out."""
    step: float | None = None
    """Communication step [s]; None: from row to row."""
    timeout: float = 10.0
    """Time that each call of the FMU may take [s]."""
    environment: tuple[str, ...] = ()
    """Environment variables that its process is given: see open_slave."""
    own: Mapping[str, tuple[str, Path]] = field(default_factory=dict[str, tuple[str, Path]])
    """Variable and log of each parameter that is sought for one log alone, by the parameter's name."""

    def values_in(self, log: Path, values: Mapping[str, float]) -> dict[str, float]:
        """Return start values by variable for a log, of values by parameter."""
        shared = {name: value for name, value in values.items() if name not in self.own}
        own = {self.own[name][0]: v for name, v in values.items() if name in self.own and self.own[name][1] == log}
        return shared | own


class Rollout(NamedTuple):
    """The outputs over a window's rows (n, c), or the reason why there are none."""

    outputs: Vector | None
    reason: str | None = None


class Grid(NamedTuple):
    """The communication points of a window, on the FMU's time."""

    times: list[float]
    """Communication points (N + 1,) [s]."""
    inputs: list[list[float]]
    """Inputs (N, p), held from each point to the next."""
    rows: Vector | None
    """Time of each row (n,), to interpolate the outputs at; None where the points are the rows."""


class Rollouts:
    """Processes that simulate a plant over a log's windows. A context: leaving it ends them."""

    def __init__(self, plant: SimulatedPlant, component: Component, windows: Sequence[LogWindow], jobs: int) -> None:
        """jobs: number of processes. Raises LogError where the FMU cannot step as the log's rows ask."""
        interface: Any = capabilities(component.description)
        is_even = has_fixed_step(component.description)
        self._plant, self._grids = plant, [grid_of(w, plant.step, is_even) for w in windows]
        self._windows = tuple(windows)
        self._pool = Pool(self._opened, jobs, not interface.canBeInstantiatedOnlyOncePerProcess)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.__exit__()

    def simulate(self, candidates: Sequence[Mapping[str, float]], is_whole: bool = False) -> list[list[Rollout]]:
        """Simulate each candidate over each window, over its rows to fit or all of them; several at a time.

        candidates: start values by the parameter's name.
        """
        numbers = [i for i, w in enumerate(self._windows) if is_whole or w.n_fit]
        tasks = [partial(self._rollout, i, is_whole, values) for values in candidates for i in numbers]
        found = [Rollout(outcome.result, outcome.reason) for outcome in self._pool.map(tasks)]
        return [found[k : k + len(numbers)] for k in range(0, len(found), len(numbers))]

    def _opened(self) -> Slave:
        slave = open_slave(self._plant.fmu, "plant", timeout=self._plant.timeout, environment=self._plant.environment)
        slave.bind(self._plant.inputs, (), self._plant.outputs)
        return slave

    def _rollout(self, number: int, is_whole: bool, values: Mapping[str, float], slave: Slave, _: bool) -> Vector:
        """Return the outputs (n, c) over a window. Raises SlaveError."""
        window, (times, inputs, rows) = self._windows[number], self._grids[number]
        n_rows = len(window.time) if is_whole else window.n_fit
        end = times[n_rows - 1] if rows is None else float(rows[n_rows - 1])
        values_here = self._plant.values_in(window.log, values)
        inputs_at_start = zip(self._plant.inputs, inputs[0], strict=True)
        slave.initialize(
            {**dict(inputs_at_start), **self._plant.start, **window.start, **values_here}, times[0], times[-1]
        )
        n = bisect_left(times, end)
        table = np.array([slave.get(), *self._pool.through(slave, times[: n + 1], inputs[:n])])
        if rows is None:
            return table
        return np.column_stack([np.interp(rows[:n_rows], times[: len(table)], y) for y in table.T])


def grid_of(window: LogWindow, step: float | None, is_even: bool) -> Grid:
    """Return communication points, at the rows or step [s] apart. Raises LogError if they must be even and are not."""
    t = window.time - window.origin
    n = len(t)
    even = np.linspace(t[0], t[-1], n)
    h = (t[-1] - t[0]) / (n - 1)
    if step is None and is_even and np.abs(t - even).max() > _UNEVEN * h:
        raise LogError(
            f"{window.name}: time stamps are {np.diff(t).min():g} to {np.diff(t).max():g} s apart, and the FMU cannot "
            f"vary its step; give --step {float(f'{np.median(np.diff(t)):.2g}'):g}."
        )
    if step is None:
        points = even if is_even or np.abs(t - even).max() < 1e-6 * h else t
        return Grid(points.tolist(), window.inputs[:-1].tolist(), None)
    points = t[0] + step * np.arange(int(np.ceil((t[-1] - t[0]) / step - 1e-9)) + 1)
    rounding = _UNEVEN * min(step, float(np.median(np.diff(t))))
    held = np.searchsorted(t, points[:-1] + rounding, side="right") - 1
    return Grid(points.tolist(), window.inputs[held].tolist(), t)


class RolloutResidual:
    """Residuals of candidates over all windows: simulated minus measured, in standard deviations of the noise."""

    def __init__(self, rollouts: Rollouts, space: ParameterSpace, windows: Sequence[LogWindow], noise: Vector) -> None:
        """noise: (c,), standard deviation of each output, in its unit."""
        self._rollouts, self._space, self._noise = rollouts, space, noise
        self._measured = [w.measured[: w.n_fit] for w in windows if w.n_fit]
        self.n_residuals = int(sum(np.isfinite(m).sum() for m in self._measured))
        """Number of residuals D."""
        known = [np.isfinite(m).sum(axis=0).tolist() for m in self._measured]
        self.series: list[int] = [n for window in known for n in window if n]
        """Numbers of residuals of one output in one window, in order."""
        self.evaluations: list[tuple[Vector, float, str | None]] = []
        """Candidates in order: theta (d,), sum of squares and, where it failed, the reason."""
        self.cross_misfits: list[Vector] = []
        """Sums of squares (c, c) of each output compared with each column, of each candidate that did not fail."""

    @property
    def n_evaluations(self) -> int:
        """Number of candidates simulated so far."""
        return len(self.evaluations)

    def __call__(self, theta: Vector) -> Vector:
        """Return the residual (D,) of theta (d,); NaN where the simulation failed."""
        return self.many([theta])[0]

    def many(self, thetas: Sequence[Vector]) -> list[Vector]:
        """Return the residual of each theta, several at a time."""
        found: list[Vector] = []
        for theta, rollouts in zip(
            thetas, self._rollouts.simulate([self._space.named(t) for t in thetas]), strict=True
        ):
            reason = next((r.reason for r in rollouts if r.reason is not None), None)
            residual = np.full(self.n_residuals, np.nan) if reason else self._whitened(rollouts)
            self.evaluations.append((theta, float(residual @ residual), reason))
            found.append(residual)
        return found

    def _whitened(self, rollouts: Sequence[Rollout]) -> Vector:
        simulated = [r.outputs for r in rollouts if r.outputs is not None]
        self.cross_misfits.append(cross_misfit(simulated, self._measured, self._noise))
        with np.errstate(over="ignore"):
            parts = [
                np.clip((y - measured) / self._noise, -LARGEST, LARGEST).T.reshape(-1)
                for y, measured in zip(simulated, self._measured, strict=True)
            ]
        residual = np.concatenate(parts)
        return residual[~np.isnan(residual)]


def noise_of(windows: Sequence[LogWindow]) -> Vector:
    """Return the standard deviation (c,) of each output's noise, from the changes from row to row in the fitted rows.

    White noise of variance s^2 has third differences of variance 20 s^2, in which a signal that is well sampled is
    small; their median absolute value, over 0.6745, is robust against jumps. At least a millionth of the signal's
    range; for a signal that mostly stays (it is quantised) the root mean square replaces the median. 0: constant.
    """
    noise: list[float] = []
    for i in range(windows[0].measured.shape[1]):
        fitted = [w.measured[: w.n_fit, i] for w in windows]
        differences = _third_differences(fitted) / np.sqrt(20.0)
        robust = float(np.median(np.abs(differences))) / 0.6745 if len(differences) else 0.0
        mean = float(np.sqrt(np.mean(differences**2))) if len(differences) else 0.0
        noise.append(robust or mean)
    return np.maximum(noise, least_noise(windows))


def least_noise(windows: Sequence[LogWindow]) -> Vector:
    """Return a millionth of each output's range (c,) in the fitted rows: no residual that matters exceeds `LARGEST`."""
    fitted = np.concatenate([w.measured[: w.n_fit] for w in windows])
    known = [y[np.isfinite(y)] for y in fitted.T]
    return np.array([1e-6 * float(np.ptp(y)) if len(y) else 0.0 for y in known])


def _third_differences(signals: Sequence[Vector]) -> Vector:
    """Return third differences of neighbouring rows or, where these are too few, of rows that have a value.

    They are too few where an output has a slower raster than the log.
    """
    found = np.concatenate([np.diff(y, 3) for y in signals])
    known = found[np.isfinite(found)]
    return known if len(known) >= _FEW else np.concatenate([np.diff(y[np.isfinite(y)], 3) for y in signals])
