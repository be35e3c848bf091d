"""Trial of the model before a run: it must give a derivative for each state, and have a value somewhere."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from estimator import ParameterSpace, Sample, Vector

from ..errors import ScenarioError, one_line
from ..system.plant import Plant
from ..text_table import counted

_POINTS: Final = 20
"""Points about the start at which a model is tried that has no value there."""


def try_derivatives(
    model: Callable[..., Sequence[float]], plant: Plant, space: ParameterSpace, theta: Vector, first: Sample, name: str
) -> None:
    """Call the model at the first sample with theta (d,) and, where it has no value there, at points about it.

    name: the model's, for messages. Exceptions of the model pass through, but for those that say that it has no value.
    Raises ScenarioError for a model of another number of derivatives than states, or without a value at any point.
    """
    reason = ""
    for at, sample in _points(space, theta, first):
        try:
            modelled: Any = model(sample.x, sample.u, **space.named(at))
        except (ArithmeticError, ValueError) as e:
            reason = reason or f": {type(e).__name__}: {one_line(str(e))}"
            continue
        values = np.asarray(modelled, dtype=float)
        if values.shape != (len(plant.states),):
            returned = counted(len(values), "derivative") if values.ndim == 1 else f"an array of shape {values.shape}"
            states = f"{counted(len(plant.states), 'state')}, {', '.join(plant.states)}"
            raise ScenarioError(f"estimation.model: '{name}' returns {returned} for {states}.")
        if np.all(np.isfinite(values[list(plant.channels)])):
            return
        reason = reason or f": it returns {values.tolist()}"
    where = "at the start, nor at any of 20 points about it, with parameters within the bounds"
    raise ScenarioError(f"estimation.model: '{name}' has no value {where}{reason}.")


def _points(space: ParameterSpace, theta: Vector, first: Sample) -> Iterator[tuple[Vector, Sample]]:
    """Yield the first sample with theta, then samples about it with other parameters, always the same."""
    yield theta, first
    rng = np.random.default_rng(0)
    for _ in range(_POINTS):
        x, u = (_about(rng, values) for values in (first.x, first.u))
        yield space.from_unit(rng.random(len(space))), Sample(first.t, x, u, first.xdot)


def _about(rng: np.random.Generator, values: Sequence[float]) -> tuple[float, ...]:
    spread = np.maximum(1.0, np.abs(values))
    return tuple((np.array(values) + spread * rng.standard_normal(len(values))).tolist())
