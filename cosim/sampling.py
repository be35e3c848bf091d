"""What the estimator gets to see of the plant: state, held input and derivatives, with measurement noise."""

from collections.abc import Mapping, Sequence

import numpy as np

from estimator import Sample

from .scenario import Scenario
from .system import Plant


class Sampler:
    """Takes samples from the outputs' values. The noise has its own stream, drawn at every point, used or not."""

    def __init__(self, scenario: Scenario, plant: Plant, names: Sequence[str], noise: np.random.Generator) -> None:
        place = {name: i for i, name in enumerate(names)}
        states = [f"{plant.name}.{name}" for name in plant.states]
        sampling = scenario.sampling
        self._plant, self._rng = plant, noise
        self._derivatives = [place[name] for name in sampling.derivatives]
        self._states = [place[name] for name in states]
        on_derivatives = [n.noise for n in sampling.derivatives.values()]
        on_states = [sampling.states[name].noise if name in sampling.states else 0.0 for name in states]
        self._sigma = np.array(on_derivatives + on_states)
        self.columns = tuple(f"sampled.{name}" for name in sampling.derivatives)

    def take(self, t: float, values: Sequence[float], held: Mapping[str, float]) -> Sample:
        """The sample at t [s]; values of all outputs, and what the plant's connected inputs were held at up to t."""
        noise = self._sigma * self._rng.standard_normal(len(self._sigma))
        return self._sample(t, values, held, noise.tolist())

    def exact(self, t: float, values: Sequence[float]) -> Sample:
        """The sample before the first step: without noise, inputs at their start."""
        return self._sample(t, values, {}, [0.0] * len(self._sigma))

    def _sample(self, t: float, values: Sequence[float], held: Mapping[str, float], noise: Sequence[float]) -> Sample:
        n = len(self._derivatives)
        xdot = tuple(values[i] + e for i, e in zip(self._derivatives, noise[:n], strict=True))
        x = tuple(values[i] + e for i, e in zip(self._states, noise[n:], strict=True))
        return Sample(t, x, tuple(held.get(name, start) for name, start in self._plant.inputs.items()), xdot)
