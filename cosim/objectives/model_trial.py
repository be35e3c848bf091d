"""Trials of the model before a run: it gives a derivative for each state, somewhere, and arrays where it says so."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np

from estimator import ParameterSpace, Sample, Vector

from ..errors import ScenarioError, one_line
from ..system.plant import Plant
from ..text_table import counted
from ..user_code import USERS

_POINTS: Final = 20
"""Points about the start at which a model is tried that has no value there."""
_ROUNDING: Final = 1e-9
"""Largest difference, relative to values above one, of a derivative computed with arrays and with numbers."""


def try_derivatives(
    model: Callable[..., Sequence[float]],
    plant: Plant,
    space: ParameterSpace,
    theta: Vector,
    first: Sample,
    name: str,
    given: str,
) -> None:
    """Call the model at the first sample with theta (d,) and, where it has no value there, at points about it.

    name and given: the model's, and what x and u are, for messages. Exceptions of the model pass through, but for those
    that say that it has no value; of these a ValueError may be that of a function of other arguments.
    Raises ScenarioError for a model of another number of derivatives than states, or without a value at any point.
    """
    reason = ""
    for at, sample in _points(space, theta, first):
        try:
            modelled: Any = model(sample.x, sample.u, **space.named(at))
        except (ArithmeticError, ValueError) as e:
            of_arguments = f"; {given}" if isinstance(e, ValueError) else ""
            reason = reason or f": {type(e).__name__}: {one_line(str(e))}{of_arguments}"
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


def try_arrays(
    model: Callable[..., Sequence[float]], plant: Plant, space: ParameterSpace, theta: Vector, first: Sample, name: str
) -> None:
    """Call the model at several points at once, and compare with one call after the other; as `try_derivatives`.

    Raises ScenarioError where it does not take arrays, or gives others for them.
    """
    points = [(at, sample) for at, sample in _points(space, theta, first) if _has_value(model, space, at, sample)]
    if not points:
        return
    points = points[:1] * 2 + points[1:]  # two at least: of one value an array behaves like a number
    alone = np.array([model(sample.x, sample.u, **space.named(at)) for at, sample in points], dtype=float).T
    x, u = np.array([sample.x for _, sample in points]).T, np.array([sample.u for _, sample in points]).T
    named = dict(zip(space.names, np.array([at for at, _ in points]).T, strict=True))
    where = f"estimation.vectorised: '{name}'"
    try:
        together = np.array([np.broadcast_to(row, len(points)) for row in model(x, u, **named)], dtype=float)
    except USERS as e:
        raise ScenarioError(f"{where} does not take arrays: {type(e).__name__}: {one_line(str(e))}.") from e
    if together.shape != alone.shape:
        raise ScenarioError(f"{where} returns {len(together)} derivatives for arrays, {len(alone)} for numbers.")
    differ = np.abs(together - alone) > _ROUNDING * np.maximum(1.0, np.abs(alone))
    if differ.any():
        i, k = np.argwhere(differ)[0]
        values = f"{together[i, k]:.9g} at {len(points)} points at once, {alone[i, k]:.9g} at that one alone"
        raise ScenarioError(f"{where} gives der({plant.states[i]}) = {values}.")


def _has_value(model: Callable[..., Sequence[float]], space: ParameterSpace, at: Vector, sample: Sample) -> bool:
    try:
        return bool(np.all(np.isfinite(model(sample.x, sample.u, **space.named(at)))))
    except USERS:  # at inputs that the plant never has, perhaps
        return False


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
