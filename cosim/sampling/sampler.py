"""Sampling of the plant for the estimator: state, held input, derivatives and outputs, with measurement noise."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from estimator import Sample

from ..scenarios.scenario import Scenario
from ..scenarios.schema.sampling import Noise
from ..system.plant import Plant
from .derivative_filter import DerivativeFilter, averaged, kernel_of
from .fault_injection import FaultInjection


class Sampler:
    """Sampler of the outputs' values. The noise has a random stream of its own, drawn at every point, used or not."""

    def __init__(
        self,
        scenario: Scenario,
        plant: Plant,
        names: Sequence[str],
        noise: np.random.Generator,
        faults: np.random.Generator,
    ) -> None:
        """faults: the stream of the sensors' faults. Raises WiringError for a fault of an unknown sensor."""
        place = {name: i for i, name in enumerate(names)}
        states = [f"{plant.name}.{name}" for name in plant.states]
        sampling = scenario.sampling
        self._plant, self._rng = plant, noise
        self._filter, self._no_xdot = None, ()
        derivatives = list(sampling.derivatives)
        if sampling.filter is not None:
            self._filter = DerivativeFilter(sampling.filter, scenario.scenario.macro_step, plant.channels)
            derivatives, self._no_xdot = [], (0.0,) * len(derivatives)
        sensors = [*derivatives, *states, *sampling.outputs]
        self._faults = FaultInjection(sampling.faults, sensors, faults) if sampling.faults else None
        measured = [*derivatives, *states, *(name for name in sampling.outputs if name not in states)]
        self._measured = [place[name] for name in measured]
        known: dict[str, Noise] = {**sampling.derivatives, **sampling.states, **sampling.outputs}
        declared = np.array([known[name].noise if name in known else 0.0 for name in measured])
        self._sigma = sampling.noise_ratio * declared
        n = len(derivatives)
        self._xdot, self._x = slice(n), slice(n, n + len(states))
        self._y = [measured.index(name) for name in sampling.outputs]
        x, u, xdot, y = measured_columns(scenario, plant)
        self._noisy = [i for i, name in enumerate(x) if name.startswith(SAMPLED)]  # or faulty
        self._further = [i for i, name in enumerate(y) if name not in x]
        filtered = filtered_columns(scenario, plant)
        self._nothing = (math.nan,) * len(filtered)
        self.columns = (*xdot, *(x[i] for i in self._noisy), *u, *(y[i] for i in self._further), *filtered)
        """Names of the columns of `row`."""

    def take(self, t: float, values: Sequence[float], held: Mapping[str, float]) -> Sample:
        """Return the measurement at t [s]; values: of all outputs; held: of the plant's connected inputs up to t."""
        noise = self._sigma * self._rng.standard_normal(len(self._sigma))
        sample = self._sample(t, values, held, noise.tolist())
        return sample if self._faults is None else self._faults(sample)

    def filtered(self, measured: Sample) -> Sample | None:
        """Return the sample for the estimator: the measurement, or the filter's delayed output, or None."""
        return measured if self._filter is None else self._filter(measured)

    def exact(self, t: float, values: Sequence[float]) -> Sample:
        """Return the sample before the first step: without noise, inputs at their start values."""
        sample = self._sample(t, values, {}, [0.0] * len(self._sigma))
        return replace(sample, xdot=sample.xdot or self._no_xdot)

    def row(self, measured: Sample, sample: Sample | None) -> tuple[float, ...]:
        """Return the row to record besides the plant's outputs: the measurement and the filter's output."""
        noisy, further = [measured.x[i] for i in self._noisy], [measured.y[i] for i in self._further]
        row = (*measured.xdot, *noisy, *measured.u, *further)
        if self._filter is None:
            return row
        return row + ((sample.t, *sample.x, *sample.u, *sample.xdot) if sample else self._nothing)

    def _sample(self, t: float, values: Sequence[float], held: Mapping[str, float], noise: Sequence[float]) -> Sample:
        measured = tuple([values[i] + e for i, e in zip(self._measured, noise, strict=True)])
        u = tuple([held.get(name, start) for name, start in self._plant.inputs.items()])
        return Sample(t, measured[self._x], u, measured[self._xdot], tuple([measured[i] for i in self._y]))


SAMPLED, HELD, FILTERED = "sampled.", "held.", "filtered."
"""Prefixes of recorded columns."""


def measured_columns(scenario: Scenario, plant: Plant) -> tuple[list[str], list[str], list[str], list[str]]:
    """Return the columns of x, u, xdot and y as measured; a state without noise or fault is the plant's own output."""
    states = [f"{plant.name}.{name}" for name in plant.states]
    sampling = scenario.sampling
    faulty = [states if f.sensor is None else [f.sensor] for f in sampling.faults]
    noisy = {*sampling.states, *sampling.outputs, *chain.from_iterable(faulty)}
    return (
        [SAMPLED + name if name in noisy else name for name in states],
        [f"{HELD}{plant.name}.{name}" for name in plant.inputs],
        [] if sampling.filter else [SAMPLED + name for name in sampling.derivatives],
        [SAMPLED + name for name in sampling.outputs],
    )


def filtered_columns(scenario: Scenario, plant: Plant) -> list[str]:
    """Return the columns of the filter's time, x, u and xdot; none without a filter."""
    if scenario.sampling.filter is None:
        return []
    names = [f"{plant.name}.{name}" for name in (*plant.states, *plant.inputs)]
    return [FILTERED + name for name in ("time", *names, *scenario.sampling.derivatives)]


def recorded_samples(
    scenario: Scenario, plant: Plant, series: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]], rows: Sequence[int]
) -> list[Sample | None]:
    """Return the estimator's sample at each of these rows of a run's record; None where the filter had none.

    A filter's samples get their nodes from the measurements that it made them of. Raises KeyError for a missing column.
    """
    x, u, xdot, y = measured_columns(scenario, plant)
    time = "time"
    if filtered := filtered_columns(scenario, plant):
        n, m = 1 + len(x), 1 + len(x) + len(u)
        time, x, u, xdot = filtered[0], filtered[1:n], filtered[n:m], filtered[m:]
    parts = [[series[name].tolist() for name in names] for names in (x, u, xdot, y)]
    t = series[time].tolist()
    samples = [
        None if math.isnan(t[k]) else Sample(t[k], *(tuple(column[k] for column in part) for part in parts))
        for k in rows
    ]
    settings = scenario.sampling.filter
    if settings is None:
        return samples
    kernel = kernel_of(settings, scenario.scenario.macro_step)
    n, measured = len(kernel.weights), recorded_measurements(scenario, plant, series)
    made_of = ([m for m in measured[k - n : k + 1] if m is not None][::-1] for k in rows)
    return [
        sample and replace(sample, nodes=averaged(kernel, points, []).nodes)
        for sample, points in zip(samples, made_of, strict=True)
    ]


def recorded_measurements(
    scenario: Scenario, plant: Plant, series: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]]
) -> list[Sample | None]:
    """Return the measurement at each row of a run's record, which a filter makes samples of; None without a filter.

    Raises KeyError for a missing column.
    """
    t = series["time"].tolist()
    if scenario.sampling.filter is None:
        return [None] * len(t)
    columns = [[series[name].tolist() for name in names] for names in measured_columns(scenario, plant)]
    return [Sample(t[k], *(tuple(column[k] for column in part) for part in columns)) for k in range(len(t))]
