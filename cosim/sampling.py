"""What the estimator gets to see of the plant: state, held input and derivatives, with measurement noise."""

from collections.abc import Mapping, Sequence
from itertools import chain
from operator import add, itemgetter
from typing import Any

import numpy as np

from estimator import Sample

from .scenarios.scenario import Scenario
from .scenarios.system import Plant
from .sensor_faults import SensorFaults


class Sampler:
    """Takes samples from the outputs' values. The noise has its own stream, drawn at every point, used or not."""

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
        sensors = {name: i for i, name in enumerate([*sampling.derivatives, *states])}
        self._faults = SensorFaults(sampling.faults, sensors, faults) if sampling.faults else None
        self._n_derivatives = len(sampling.derivatives)
        self._measured = itemgetter(*(place[name] for name in [*sampling.derivatives, *states]))
        on_derivatives = [n.noise for n in sampling.derivatives.values()]
        on_states = [sampling.states[name].noise if name in sampling.states else 0.0 for name in states]
        self._sigma = np.array(on_derivatives + on_states)
        x, u, xdot = sample_columns(scenario, plant)
        self._noisy = [i for i, name in enumerate(x) if name.startswith(SAMPLED)]  # or faulty
        self.columns = (*xdot, *(x[i] for i in self._noisy), *u)
        """Names of what `row` gives."""

    def take(self, t: float, values: Sequence[float], held: Mapping[str, float]) -> Sample:
        """The sample at t [s]; values of all outputs, and what the plant's connected inputs were held at up to t."""
        noise = self._sigma * self._rng.standard_normal(len(self._sigma))
        sample = self._sample(t, values, held, noise.tolist())
        return sample if self._faults is None else self._faults(sample)

    def exact(self, t: float, values: Sequence[float]) -> Sample:
        """The sample before the first step: without noise, inputs at their start."""
        return self._sample(t, values, {}, [0.0] * len(self._sigma))

    def row(self, sample: Sample) -> tuple[float, ...]:
        """What is recorded of a sample besides the plant's outputs."""
        return (*sample.xdot, *(sample.x[i] for i in self._noisy), *sample.u)

    def _sample(self, t: float, values: Sequence[float], held: Mapping[str, float], noise: Sequence[float]) -> Sample:
        n = self._n_derivatives
        measured = tuple(map(add, self._measured(values), noise))
        u = tuple([held.get(name, start) for name, start in self._plant.inputs.items()])
        return Sample(t, measured[n:], u, measured[:n])


SAMPLED, HELD = "sampled.", "held."
"""Prefixes of recorded columns."""


def sample_columns(scenario: Scenario, plant: Plant) -> tuple[list[str], list[str], list[str]]:
    """Recorded columns of a sample's x, u and xdot; a state without noise or fault is the plant's output itself."""
    states = [f"{plant.name}.{name}" for name in plant.states]
    faulty = [states if f.sensor is None else [f.sensor] for f in scenario.sampling.faults]
    noisy = {*scenario.sampling.states, *chain.from_iterable(faulty)}
    return (
        [SAMPLED + name if name in noisy else name for name in states],
        [f"{HELD}{plant.name}.{name}" for name in plant.inputs],
        [SAMPLED + name for name in scenario.sampling.derivatives],
    )


def recorded_samples(
    scenario: Scenario, plant: Plant, series: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]], rows: Sequence[int]
) -> list[Sample]:
    """The samples that a run's estimator got at these rows of its record. Raises KeyError for a missing column."""
    parts = [[series[name].tolist() for name in names] for names in sample_columns(scenario, plant)]
    t = series["time"].tolist()
    return [Sample(t[k], *(tuple(column[k] for column in part) for part in parts)) for k in rows]
