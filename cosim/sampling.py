"""What the estimator gets to see of the plant: state, held input, derivatives and outputs, with measurement noise."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from estimator import Sample

from .scenarios.scenario import Scenario
from .scenarios.system import Plant


class Sampler:
    """Takes samples from the outputs' values. The noise has its own stream, drawn at every point, used or not."""

    def __init__(self, scenario: Scenario, plant: Plant, names: Sequence[str], noise: np.random.Generator) -> None:
        place = {name: i for i, name in enumerate(names)}
        states = [f"{plant.name}.{name}" for name in plant.states]
        sampling = scenario.sampling
        self._plant, self._rng = plant, noise
        measured = [*sampling.derivatives, *states, *(name for name in sampling.outputs if name not in states)]
        self._measured = [place[name] for name in measured]
        known = sampling.derivatives | sampling.outputs | sampling.states
        self._sigma = np.array([known[name].noise if name in known else 0.0 for name in measured])
        n = len(sampling.derivatives)
        self._xdot, self._x = slice(n), slice(n, n + len(states))
        self._y = [measured.index(name) for name in sampling.outputs]
        x, u, xdot, y = sample_columns(scenario, plant)
        self._noisy = [i for i, name in enumerate(x) if name.startswith(SAMPLED)]
        self._further = [i for i, name in enumerate(y) if name not in x]
        self.columns = (*xdot, *(x[i] for i in self._noisy), *u, *(y[i] for i in self._further))
        """Names of what `row` gives."""

    def take(self, t: float, values: Sequence[float], held: Mapping[str, float]) -> Sample:
        """The sample at t [s]; values of all outputs, and what the plant's connected inputs were held at up to t."""
        noise = self._sigma * self._rng.standard_normal(len(self._sigma))
        return self._sample(t, values, held, noise.tolist())

    def exact(self, t: float, values: Sequence[float]) -> Sample:
        """The sample before the first step: without noise, inputs at their start."""
        return self._sample(t, values, {}, [0.0] * len(self._sigma))

    def row(self, sample: Sample) -> tuple[float, ...]:
        """What is recorded of a sample besides the plant's outputs."""
        noisy, further = [sample.x[i] for i in self._noisy], [sample.y[i] for i in self._further]
        return (*sample.xdot, *noisy, *sample.u, *further)

    def _sample(self, t: float, values: Sequence[float], held: Mapping[str, float], noise: Sequence[float]) -> Sample:
        measured = tuple([values[i] + e for i, e in zip(self._measured, noise, strict=True)])
        u = tuple([held.get(name, start) for name, start in self._plant.inputs.items()])
        return Sample(t, measured[self._x], u, measured[self._xdot], tuple([measured[i] for i in self._y]))


SAMPLED, HELD = "sampled.", "held."
"""Prefixes of recorded columns."""


def sample_columns(scenario: Scenario, plant: Plant) -> tuple[list[str], list[str], list[str], list[str]]:
    """Recorded columns of a sample's x, u, xdot and y; a state without noise is the plant's output itself."""
    states = [f"{plant.name}.{name}" for name in plant.states]
    sampling = scenario.sampling
    noisy = sampling.states | sampling.outputs
    return (
        [SAMPLED + name if name in noisy else name for name in states],
        [f"{HELD}{plant.name}.{name}" for name in plant.inputs],
        [SAMPLED + name for name in sampling.derivatives],
        [SAMPLED + name for name in sampling.outputs],
    )


def recorded_samples(
    scenario: Scenario, plant: Plant, series: Mapping[str, np.ndarray[Any, np.dtype[np.float64]]], rows: Sequence[int]
) -> list[Sample]:
    """The samples that a run's estimator got at these rows of its record. Raises KeyError for a missing column."""
    parts = [[series[name].tolist() for name in names] for names in sample_columns(scenario, plant)]
    t = series["time"].tolist()
    return [Sample(t[k], *(tuple(column[k] for column in part) for part in parts)) for k in rows]
