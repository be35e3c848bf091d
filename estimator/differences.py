"""Slopes of functions that have no derivative at hand."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from .space import Vector


@dataclass(frozen=True)
class OfMany:
    """Function of places (..., d) that returns the values (..., D) at all of them, faster than one after the other."""

    function: Callable[[Vector], Vector]

    def __call__(self, z: Vector) -> Vector:
        """Return the values (..., D) at places z (..., d)."""
        return self.function(z)


def values_at(function: Callable[[Vector], Sequence[float] | Vector], places: Vector) -> Vector:
    """Return the values (..., D) of a function of one place (d,), or `OfMany`, at places (..., d)."""
    if isinstance(function, OfMany):
        return function(places)
    values = np.array([function(place) for place in places.reshape(-1, places.shape[-1])], dtype=float)
    return values.reshape(*places.shape[:-1], *values.shape[1:])


def central_differences(
    function: Callable[[Vector], Sequence[float] | Vector],
    z: Vector,
    steps: Vector,
    lower: float = -inf,
    upper: float = inf,
) -> Vector:
    """Return df/dz (D, d) at z (d,) by central differences, one-sided at a bound.

    function: f (D,) of a place (d,); steps (d,): to either side; lower, upper: of every coordinate of the places.
    """
    above, below = np.tile(z, (len(z), 1)), np.tile(z, (len(z), 1))
    np.fill_diagonal(above, np.minimum(z + steps, upper))
    np.fill_diagonal(below, np.maximum(z - steps, lower))
    values = values_at(function, np.stack([above, below], axis=1))
    return np.ascontiguousarray(((values[:, 0] - values[:, 1]) / (above - below).diagonal()[:, None]).T)


def forward_differences(function: Callable[[Vector], Vector], z: Vector, value: Vector, step: float) -> Vector:
    """Return df/dz (D, d) at z (d,) of the unit cube by steps towards the cube's middle; value: f(z), of any shape."""
    aside = _aside(z, step)
    return _slope(values_at(function, aside), value, aside.diagonal() - z)


def value_and_slope(function: Callable[[Vector], Vector], z: Vector, step: float) -> tuple[Vector, Vector]:
    """Return f(z) (D,) and its `forward_differences` (D, d), from one call of a function `OfMany`."""
    d = len(z)
    places = z[None].repeat(d + 1, axis=0)
    moved = places.reshape(-1)[d :: d + 1]  # the coordinate of each place but the first that is a step aside
    moved += np.where(z < 0.5, step, -step)
    values = values_at(function, places)
    return values[0], _slope(values[1:], values[0], moved - z)


def _aside(z: Vector, step: float) -> Vector:
    """Return the places (d, d) a step aside of z (d,) in one coordinate each, towards the cube's middle."""
    aside = z[None].repeat(len(z), axis=0)
    aside.reshape(-1)[:: len(z) + 1] += np.where(z < 0.5, step, -step)
    return aside


def _slope(values: Vector, value: Vector, moved: Vector) -> Vector:
    """Return the slope (D, d) from values at d places that were moved (d,) from that of value."""
    return np.ascontiguousarray(((values - value).reshape(len(moved), -1) / moved[:, None]).T)
