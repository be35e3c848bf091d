"""Samples of the plant, and the residuals of a model at one of them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from traceback import walk_tb
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .space import ParameterSpace, Vector

_FEW: Final = 6
"""Number of points up to which a model that needs no NumPy is faster without it."""

_RESOLVED: Final = 3.0
"""Standard deviations by which the mean over a sample's nodes may be off where the model has no corner."""

Model = Callable[..., Sequence[float]]
"""xdot (n,) = model(x, u, **parameters): state (n,), input (p,), parameters by name; SI units."""


class Node(NamedTuple):
    """Macro step that a filter's sample is the mean of, with others: a node of a quadrature by the midpoint rule."""

    weight: float
    """Weight in the mean; those of a sample sum to one."""
    dx: tuple[float, ...]
    """State (n,) in the middle of the step, less the sample's."""
    du: tuple[float, ...]
    """Input (p,) held over the step, less the sample's."""
    change: tuple[float, ...]
    """Change of the state (n,) over the step."""


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
    nodes: tuple[Node, ...] = ()
    """Macro steps that x, u and xdot are means over; none for a sample at one time."""


class Samples(tuple[Sample, ...]):
    """Samples whose arrays are made once, however many candidates they are compared with."""

    def __init__(self, samples: Iterable[Sample] = (), /) -> None:
        self.xdot: Vector = np.array([s.xdot for s in self], dtype=float)
        """Sampled derivatives (n, c); NaN where there are none."""
        is_missing = np.isnan(self.xdot)
        self.is_missing = is_missing if is_missing.any() else None
        """True where there is no derivative (n, c); None where there are all."""
        self.weights = np.array([[node.weight for node in s.nodes] for s in self]) if self and self[0].nodes else None
        """Weights (n, j) of the nodes, of which each sample has as many; None where they have none."""
        self._columns: dict[tuple[str, int], Vector] = {}
        self._all: Samples | None = None  # samples that these are the newest of, which have the columns

    def newest(self, n: int) -> "Samples":
        """Return the newest n of them, whose arrays are part of these."""
        if n >= len(self):
            return self
        newest = tuple.__new__(Samples, self[-n:])
        newest.xdot = self.xdot[-n:]
        newest.is_missing = None if self.is_missing is None else self.is_missing[-n:]
        newest.weights = None if self.weights is None else self.weights[-n:]
        newest._columns, newest._all = {}, self
        return newest

    @property
    def n_nodes(self) -> int:
        """Number of nodes of each sample; 1 where they have none."""
        return 1 if self.weights is None else self.weights.shape[1]

    def columns(self, name: Literal["x", "u"], k: int) -> Vector:
        """Return states or inputs as columns, k times over: (m, k n); at all j nodes of each sample (m, k n j)."""
        known = self._columns.get((name, k))
        if known is None:
            if k > 1:
                known = np.concatenate([self.columns(name, 1)] * k, axis=1)
            elif self._all is not None:
                known = self._all.columns(name, 1)[:, -len(self) * self.n_nodes :].copy()
            else:
                known = np.array([*zip(*self._rows_of(name), strict=True)], dtype=float)
            self._columns[name, k] = known
        return known

    def inputs_at_nodes(self, inputs: Vector) -> Vector:
        """Return inputs (k n, p) that are in place of the samples', at the nodes (p, k n j)."""
        if self.weights is None:
            return inputs.T
        k, j = len(inputs) // len(self), self.n_nodes
        moved = inputs - np.tile(np.array([s.u for s in self]), (k, 1))
        return moved.repeat(j, axis=0).T + self.columns("u", k)

    def means(self, table: Vector) -> Vector:
        """Return the means (k n, c) over the nodes of values (k n j, c) at each."""
        if self.weights is None:
            return table
        at_nodes = table.reshape(-1, *self.weights.shape, table.shape[-1])
        return np.einsum("nj,knjc->knc", self.weights, at_nodes).reshape(-1, table.shape[-1])

    def _rows_of(self, name: Literal["x", "u"]) -> Iterable[Sequence[float]]:
        if self.weights is None:
            return (getattr(s, name) for s in self)
        return (point[name == "u"] for s in self for point in points(s, s.u))


def points(sample: Sample, u: Sequence[float]) -> list[tuple[Sequence[float], Sequence[float]]]:
    """Return the states (n,) and inputs (p,) at a sample's nodes, where its input is u (p,); its own if it has none."""
    if not sample.nodes:
        return [(sample.x, u)]
    return [(_sum(sample.x, node.dx), _sum(u, node.du)) for node in sample.nodes]


def _sum(one: Sequence[float], other: Sequence[float]) -> tuple[float, ...]:
    return tuple([a + b for a, b in zip(one, other, strict=True)])


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
    Of a sample with nodes f is the mean over these: of x and u it would be another where the model is not linear.
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
        if 0 < k * n <= few and inputs is None and not samples[0].nodes:
            return np.array([[self._whitened(sample, named) for sample in samples] for named in self._named(thetas)])
        samples = samples if isinstance(samples, Samples) else Samples(samples)
        is_many = k * n * samples.n_nodes > few
        with np.errstate(all="ignore"):
            table = self._at_once(thetas, samples, inputs) if self.is_vectorised and is_many else None
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
            at = [[self.slopes(x, u, **named) for x, u in points(s, s.u)] for s in samples]
        except (ArithmeticError, ValueError):
            return None
        weights = np.array([[node.weight for node in s.nodes] or [1.0] for s in samples])
        table = np.einsum("nj,njcd->ncd", weights, np.array(at, dtype=float)[:, :, list(self.channels)])
        r = -table * self.space.slope(theta) / self._sigma[:, None]
        r[np.isnan(np.array([s.xdot for s in samples], dtype=float))] = 0.0
        return r if np.all(np.isfinite(r)) else None

    def _at_once(self, thetas: Vector, samples: Samples, inputs: Vector | None) -> Vector | None:
        """Return the modelled derivatives (k n, c) of candidates (k, d) at n samples; None where one has no value.

        NumPy's warnings are the caller's to ignore.
        """
        k, n = len(thetas), len(samples) * samples.n_nodes
        x = samples.columns("x", k)
        u = samples.columns("u", k) if inputs is None else samples.inputs_at_nodes(inputs)
        named = dict(zip(self.space.names, thetas.T.repeat(n, axis=1), strict=True))
        try:
            modelled: Any = self.model(x, u, **named)
        except (ArithmeticError, ValueError):
            return None
        table = np.empty((k * n, len(self.channels)))
        for column, i in zip(table.T, self.channels, strict=True):
            column[:] = modelled[i]
        return samples.means(table)

    def _one_by_one(self, thetas: Vector, samples: Sequence[Sample], inputs: Vector | None) -> Vector:
        """Return the modelled derivatives (k n, c) of candidates (k, d) at n samples; NaN where one has no value."""
        named, missing = self._named(thetas), [nan] * len(self.channels)
        held = [s.u for s in samples] * len(named) if inputs is None else map(tuple, inputs.tolist())
        asked = zip([(own, s) for own in named for s in samples], held, strict=True)
        return np.array([self._modelled(own, s, u) or missing for (own, s), u in asked], dtype=float)

    def _named(self, thetas: Vector) -> list[dict[str, float]]:
        """Return candidates (k, d) by name."""
        return [dict(zip(self.space.names, theta, strict=True)) for theta in thetas.tolist()]

    def _whitened(self, sample: Sample, named: Mapping[str, float]) -> list[float]:
        """Return r (c,) of one sample, as `__call__` does."""
        modelled = self._modelled(named, sample, sample.u)
        if modelled is None:
            return [nan] * len(self.channels)
        return [
            (y - f) / s if y == y else 0.0  # a NaN differs from itself
            for y, f, s in zip(sample.xdot, modelled, self.noise, strict=True)
        ]

    def _modelled(self, named: Mapping[str, float], sample: Sample, u: Sequence[float]) -> Sequence[float] | None:
        """Return the modelled derivatives (c,) of the channels with input u (p,); None where the model has no value."""
        try:
            if not sample.nodes:
                modelled = self.model(sample.x, u, **named)
                return [modelled[i] for i in self.channels]
            at = [self.model(x, held, **named) for x, held in points(sample, u)]
        except (ArithmeticError, ValueError):  # math.sqrt(-1.0) raises the latter
            return None
        return [sum(node.weight * f[i] for node, f in zip(sample.nodes, at, strict=True)) for i in self.channels]

    def has_corner(self, theta: Vector, sample: Sample) -> NDArray[np.bool_]:
        """Return where the model may have a corner within a step (c,), such as dry friction at a reversal.

        That is where the midpoint and the trapezoidal rule over the sample's nodes differ by more than three standard
        deviations: a jump within a step, wherever in it, is seen at its end, and the mean may be off by as much.
        """
        begin, end = ([_moved(node, share) for node in sample.nodes] for share in (-0.5, 0.5))
        ends = self.rows(theta, [replace(sample, nodes=(*begin,)), replace(sample, nodes=(*end,))])
        return np.abs(ends.mean(axis=0) - self(theta, sample)) > _RESOLVED


def _moved(node: Node, share: float) -> Node:
    """Return the node at another place in its step, a share of its length after the middle."""
    return node._replace(dx=tuple([x + share * c for x, c in zip(node.dx, node.change, strict=True)]))


_OF_MODEL: Final = frozenset(
    f.__code__
    for f in (RememberingModel.__call__, DerivativeResidual._modelled, DerivativeResidual._at_once)  # pyright: ignore[reportPrivateUsage]
)


def is_of_model(e: BaseException) -> bool:
    """Return whether an exception has come from a model, or from what it has returned, whoever has asked for it."""
    return any(frame.f_code in _OF_MODEL for frame, _ in walk_tb(e.__traceback__))
