"""Parameters to estimate: bounds, units, scale, and the map to the unit cube in which estimators search."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Scale = Literal["linear", "log"]
Vector = NDArray[np.float64]
_ROUNDING = 1e-12
"""Share of the bounds by which values differ that are rounded only."""


@dataclass(frozen=True)
class Parameter:
    """Physical parameter, and the interval in which its value is sought."""

    name: str
    """Name of the model's keyword argument and the FMU's variable."""
    lower: float
    """Lower bound, in `unit`."""
    upper: float
    """Upper bound, in `unit`."""
    unit: str = "1"
    """FMI unit string."""
    scale: Scale = "linear"
    """Scale; `log` where the value's order of magnitude is unknown: masses, inertias, stiffnesses."""

    def __post_init__(self) -> None:
        if not (isfinite(self.lower) and isfinite(self.upper) and self.lower < self.upper):
            raise ValueError(
                f"Parameter '{self.name}' must have finite lower < upper, got [{self.lower}, {self.upper}] {self.unit}."
            )
        if self.scale not in get_args(Scale):
            raise ValueError(f"Parameter '{self.name}' must have scale 'linear' or 'log', got '{self.scale}'.")
        if self.scale == "log" and self.lower <= 0.0:
            raise ValueError(
                f"Parameter '{self.name}' must have lower > 0 on a log scale, got {self.lower} {self.unit}."
            )

    def contains(self, value: float) -> bool:
        """Return whether a value, in `unit`, is within the bounds."""
        return self.lower <= value <= self.upper


@dataclass(frozen=True)
class ParameterSpace:
    """Ordered set of parameters; theta (d,) holds their values, z (d,) their places in the unit cube."""

    parameters: tuple[Parameter, ...]
    """At least one parameter, all with different names."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.parameters:
            raise ValueError("A ParameterSpace must have at least one parameter.")
        repeated = sorted({n for n in self.names if self.names.count(n) > 1})
        if repeated:
            raise ValueError(f"Parameter names must differ, got '{repeated[0]}' twice.")

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def _is_log(self) -> NDArray[np.bool_]:
        return np.array([p.scale == "log" for p in self.parameters])

    @cached_property
    def _has_log(self) -> bool:
        return bool(self._is_log.any())

    @cached_property
    def _lower(self) -> Vector:
        return np.array([p.lower for p in self.parameters], dtype=float)

    @cached_property
    def _upper(self) -> Vector:
        return np.array([p.upper for p in self.parameters], dtype=float)

    @cached_property
    def _origin(self) -> Vector:
        return _scaled(self._lower, self._is_log)

    @cached_property
    def _width(self) -> Vector:
        return _scaled(self._upper, self._is_log) - self._origin

    def __len__(self) -> int:
        return len(self.parameters)

    def __iter__(self) -> Iterator[Parameter]:
        return iter(self.parameters)

    def to_unit(self, theta: ArrayLike) -> Vector:
        """Return the place in the unit cube of values (..., d); values outside the bounds go to the nearest bound."""
        clipped = np.minimum(np.maximum(theta, self._lower), self._upper)
        scaled = np.log(clipped, out=clipped, where=self._is_log) if self._has_log else clipped
        return (scaled - self._origin) / self._width

    def from_unit(self, z: ArrayLike) -> Vector:
        """Return the values at places (..., d) in the unit cube; never outside the bounds."""
        return np.minimum(np.maximum(self.beyond(z), self._lower), self._upper)

    def beyond(self, z: ArrayLike) -> Vector:
        """Return the values at places (..., d), which may lie outside the unit cube and so outside the bounds."""
        theta = self._origin + self._width * np.asarray(z, dtype=float)
        return np.exp(theta, out=theta, where=self._is_log) if self._has_log else theta

    def slope(self, theta: ArrayLike) -> Vector:
        """Return d theta / d z at theta (d,): change in each parameter's unit for a step in the unit cube."""
        return self._width * np.where(self._is_log, np.asarray(theta, dtype=float), 1.0)

    def are_same(self, theta: Vector, other: Vector) -> bool:
        """Return whether values (d,) differ by rounding only, as after a way to the unit cube and back."""
        return bool(np.all(np.abs(theta - other) <= _ROUNDING * self._width * np.where(self._is_log, other, 1.0)))

    def named(self, theta: ArrayLike) -> dict[str, float]:
        """Return theta (d,) by name."""
        return dict(zip(self.names, np.asarray(theta, dtype=float).tolist(), strict=True))

    def vector(self, values: Mapping[str, float]) -> Vector:
        """Return theta (d,) of named values. Raises KeyError for a missing name."""
        return np.array([values[name] for name in self.names], dtype=float)


def _scaled(theta: Vector, is_log: NDArray[np.bool_]) -> Vector:
    return np.log(theta, out=theta.copy(), where=is_log)


def one_at_a_time(z: Vector, step: float | Vector) -> list[Vector]:
    """Return places that differ from z (d,) in one coordinate each, by step (d,), towards the cube's middle."""
    return list(z + np.diag(np.where(z < 0.5, step, -step)))
