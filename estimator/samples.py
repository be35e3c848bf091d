"""Samples of the plant, and the residuals of a model at one of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import nan
from traceback import walk_tb
from typing import Any, Final, Literal

import numpy as np

from .space import ParameterSpace, Vector

_FEW: Final = 6
"""Number of points up to which a model that needs no NumPy is faster without it."""

Model = Callable[..., Sequence[float]]
"""xdot (n,) = model(x, u, **parameters): state (n,), input (p,), parameters by name; SI units."""


@dataclass(frozen=True)
class Sample:
    """State, input, derivatives and outputs at one time."""

    t: float
    """Time [s]."""
    x: tuple[float, ...]
    """State (n,), in the model's order."""
    u: tuple[float, ...]
    """Input (p,) that was held up to t."""
    xdot: tuple[float, ...]
    """Sampled derivatives (c,), a number a channel; NaN where there is none."""
    y: tuple[float, ...] = ()
    """Measured outputs (o,)."""


class Samples(tuple[Sample, ...]):
    """Samples whose arrays are made once, however many candidates they are compared with."""

    def __init__(self, samples: Iterable[Sample] = (), /) -> None:
        self.xdot: Vector = np.array([s.xdot for s in self], dtype=float)
        """Sampled derivatives (n, c); NaN where there are none."""
        is_missing = np.isnan(self.xdot)
        self.is_missing = is_missing if is_missing.any() else None
        """True where there is no derivative (n, c); None where there are all."""
        self._columns: dict[tuple[str, int], Vector] = {}
        self._all: Samples | None = None  # samples that these are the newest of, which have the columns

    def newest(self, n: int) -> "Samples":
        """Return the newest n of them, whose arrays are part of these."""
        if n >= len(self):
            return self
        newest = tuple.__new__(Samples, self[-n:])
        newest.xdot = self.xdot[-n:]
        newest.is_missing = None if self.is_missing is None else self.is_missing[-n:]
        newest._columns, newest._all = {}, self
        return newest

    def columns(self, name: Literal["x", "u"], k: int) -> Vector:
        """Return states or inputs as columns, k times over: (m, k n)."""
        known = self._columns.get((name, k))
        if known is None:
            if k > 1:
                known = np.concatenate([self.columns(name, 1)] * k, axis=1)
            elif self._all is not None:
                known = self._all.columns(name, 1)[:, -len(self) :].copy()
            else:
                known = np.array([*zip(*(getattr(s, name) for s in self), strict=True)], dtype=float)
            self._columns[name, k] = known
        return known


class RememberingModel:
    """Model that computes the newest sample's derivatives once for each theta, however many callers it has."""

    def __init__(self, model: Model) -> None:
        """model: a pure function."""
        self.is_plain = False
        """True where the model computes a sample's derivatives without NumPy, in a microsecond."""
        self._model = model
        self._x: Sequence[float] | None = None
        self._u: Sequence[float] | None = None
        self._known: dict[tuple[float, ...], Sequence[float]] = {}

    def __call__(self, x: Sequence[float], u: Sequence[float], **parameters: float) -> Sequence[float]:
        """Return the model's xdot (n,). Exceptions of the model pass through."""
        if x is not self._x or u is not self._u:
            return self._model(x, u, **parameters)
        theta = tuple(parameters.values())
        xdot = self._known.get(theta)
        if xdot is None:
            xdot = self._known[theta] = tuple(self._model(x, u, **parameters))
            self.is_plain = type(xdot[-1]) is float
        return xdot

    def remember(self, sample: Sample) -> None:
        """Set the newest sample; earlier derivatives are forgotten."""
        self._x, self._u = sample.x, sample.u
        self._known.clear()


@dataclass(frozen=True)
class DerivativeResidual:
    """Sampled minus modelled derivatives, in standard deviations of the noise.

    r_i = (xdot_i - f_i(x, u; theta)) / sigma_i.  Khan and Chatterjee (2020), section III, before the norm is taken.
    """

    model: Model
    """Function f(x, u, **theta)."""
    space: ParameterSpace
    """Parameters that the model is called with, by name."""
    channels: tuple[int, ...]
    """Places in xdot of the sampled derivatives (c,)."""
    noise: tuple[float, ...]
    """sigma (c,), the standard deviation of each sampled derivative; ones leave the residual in physical units."""
    is_vectorised: bool = False
    """True where the model takes k points at once: x (n, k), u (p, k) and each parameter (k,)."""
    slopes: Callable[..., Sequence[Sequence[float]]] | None = None
    """Function df/dtheta (n, d) of x, u and **theta; None where only differences are to be had."""

    @cached_property
    def _sigma(self) -> Vector:
        return np.array(self.noise)

    def __call__(self, theta: Vector, sample: Sample) -> Vector:
        """Return r (c,) of one sample; 0 for a channel that was not sampled, NaN where the model has no value.

        Other exceptions of the model pass through.
        """
        return np.array(self._whitened(sample, self.space.named(theta)))

    def rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return r (..., n, c) of candidates theta (..., d) at n samples, each as `__call__` does, but faster."""
        r = self._rows(theta.reshape(-1, len(self.space)), samples, None)
        return r.reshape(*theta.shape[:-1], *r.shape[1:])

    def rows_with(self, inputs: Vector, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return r (k, n, c) of theta (d,) at n samples, with each of k sets of inputs (k, n, p) in place of theirs."""
        k, n, p = inputs.shape
        return self._rows(np.repeat(theta[None], k, axis=0), samples, inputs.reshape(k * n, p))

    def _rows(self, thetas: Vector, samples: Sequence[Sample], inputs: Vector | None) -> Vector:
        """Return r (k, n, c) of candidates (k, d) at n samples; inputs (k n, p): in place of theirs."""
        k, n, c = len(thetas), len(samples), len(self.channels)
        few = _FEW if isinstance(self.model, RememberingModel) and self.model.is_plain else 1
        if 0 < k * n <= few and inputs is None:
            return np.array([[self._whitened(sample, named) for sample in samples] for named in self._named(thetas)])
        samples = samples if isinstance(samples, Samples) else Samples(samples)
        with np.errstate(all="ignore"):
            table = self._at_once(thetas, samples, inputs) if self.is_vectorised and k * n > few else None
            if table is not None:
                return self._compared(samples, table.reshape(k, n, c))
        table = self._one_by_one(thetas, samples, inputs)
        with np.errstate(invalid="ignore", over="ignore"):
            return self._compared(samples, table.reshape(k, n, c))

    def _compared(self, samples: Samples, table: Vector) -> Vector:
        """Return r (k, n, c) at n samples, by the modelled derivatives (k, n, c) there."""
        r: Vector = (samples.xdot.reshape(table.shape[1:]) - table) / self._sigma
        if samples.is_missing is not None:
            r = np.where(samples.is_missing & ~np.isnan(table).all(axis=-1, keepdims=True), 0.0, r)
        return r

    def slope_rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return dr/dz (n, c, d), z in the unit cube, of theta (d,) at n samples; None where the model has none."""
        if self.slopes is None or not samples:
            return None
        named = self.space.named(theta)
        try:
            table = np.array([self.slopes(s.x, s.u, **named) for s in samples], dtype=float)[:, list(self.channels)]
        except (ArithmeticError, ValueError):
            return None
        r = -table * self.space.slope(theta) / self._sigma[:, None]
        r[np.isnan(np.array([s.xdot for s in samples], dtype=float))] = 0.0
        return r if np.all(np.isfinite(r)) else None

    def _at_once(self, thetas: Vector, samples: Samples, inputs: Vector | None) -> Vector | None:
        """Return the modelled derivatives (k n, c) of candidates (k, d) at n samples; None where one has no value.

        NumPy's warnings are the caller's to ignore.
        """
        k, n = len(thetas), len(samples)
        x = samples.columns("x", k)
        u = samples.columns("u", k) if inputs is None else inputs.T
        named = dict(zip(self.space.names, thetas.T.repeat(n, axis=1), strict=True))
        try:
            modelled: Any = self.model(x, u, **named)
        except (ArithmeticError, ValueError):
            return None
        table = np.empty((k * n, len(self.channels)))
        for column, i in zip(table.T, self.channels, strict=True):
            column[:] = modelled[i]
        return table

    def _one_by_one(self, thetas: Vector, samples: Sequence[Sample], inputs: Vector | None) -> Vector:
        """Return the modelled derivatives (k n, c) of candidates (k, d) at n samples; NaN where one has no value."""
        named, missing = self._named(thetas), [nan] * len(self.channels)
        held = [s.u for s in samples] * len(named) if inputs is None else map(tuple, inputs.tolist())
        points = zip([(own, s.x) for own in named for s in samples], held, strict=True)
        return np.array([self._modelled(own, x, u) or missing for (own, x), u in points], dtype=float)

    def _named(self, thetas: Vector) -> list[dict[str, float]]:
        """Return candidates (k, d) by name."""
        return [dict(zip(self.space.names, theta, strict=True)) for theta in thetas.tolist()]

    def _whitened(self, sample: Sample, named: Mapping[str, float]) -> list[float]:
        """Return r (c,) of one sample, as `__call__` does."""
        modelled = self._modelled(named, sample.x, sample.u)
        if modelled is None:
            return [nan] * len(self.channels)
        return [
            (y - f) / s if y == y else 0.0  # a NaN differs from itself
            for y, f, s in zip(sample.xdot, modelled, self.noise, strict=True)
        ]

    def _modelled(self, named: Mapping[str, float], x: Sequence[float], u: Sequence[float]) -> Sequence[float] | None:
        """Return the modelled derivatives (c,) of the channels; None where the model has no value."""
        try:
            modelled = self.model(x, u, **named)
        except (ArithmeticError, ValueError):  # math.sqrt(-1.0) raises the latter
            return None
        return [modelled[i] for i in self.channels]


_OF_MODEL: Final = frozenset(
    f.__code__
    for f in (RememberingModel.__call__, DerivativeResidual._modelled, DerivativeResidual._at_once)  # pyright: ignore[reportPrivateUsage]
)


def is_of_model(e: BaseException) -> bool:
    """Return whether an exception has come from a model, or from what it has returned, whoever has asked for it."""
    return any(frame.f_code in _OF_MODEL for frame, _ in walk_tb(e.__traceback__))
