"""Samples of the plant, and the residuals of a model at one of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from .space import ParameterSpace, Vector

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


class RememberingModel:
    """Model that computes the newest sample's derivatives once for each theta, however many callers it has."""

    def __init__(self, model: Model) -> None:
        """model: a pure function."""
        self._model = model
        self._newest: Sample | None = None
        self._known: dict[tuple[float, ...], Sequence[float]] = {}

    def __call__(self, x: Sequence[float], u: Sequence[float], **parameters: float) -> Sequence[float]:
        """Return the model's xdot (n,). Exceptions of the model pass through."""
        newest = self._newest
        if newest is None or x is not newest.x or u is not newest.u:
            return self._model(x, u, **parameters)
        theta = tuple(parameters.values())
        xdot = self._known.get(theta)
        if xdot is None:
            xdot = self._known[theta] = tuple(self._model(x, u, **parameters))
        return xdot

    def remember(self, sample: Sample) -> None:
        """Set the newest sample; earlier derivatives are forgotten."""
        self._newest = sample
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

    def __call__(self, theta: Vector, sample: Sample) -> Vector:
        """Return r (c,) of one sample; 0 for a channel that was not sampled, NaN where the model has no value.

        Other exceptions of the model pass through.
        """
        modelled = self._modelled(self.space.named(theta), sample)
        if modelled is None:
            return np.full(len(self.channels), np.nan)
        return np.array([
            (y - f) / s if y == y else 0.0  # a NaN differs from itself
            for y, f, s in zip(sample.xdot, modelled, self.noise, strict=True)
        ])  # fmt: skip

    def rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return r (..., n, c) of candidates theta (..., d) at n samples, each as `__call__` does, but faster."""
        thetas, c = theta.reshape(-1, len(self.space)), len(self.channels)
        missing = [nan] * c
        table = [self._modelled(named, s) or missing for named in map(self.space.named, thetas) for s in samples]
        xdot = np.array([s.xdot for s in samples], dtype=float).reshape(len(samples), c)
        with np.errstate(invalid="ignore", over="ignore"):
            r = (xdot - np.array(table, dtype=float).reshape(len(thetas), len(samples), c)) / self.noise
        if not (is_sampled := xdot == xdot).all():
            r[:, ~is_sampled] = 0.0
            r[np.reshape([row is missing for row in table], r.shape[:2])] = nan
        return r.reshape(*theta.shape[:-1], len(samples), c)

    def _modelled(self, named: Mapping[str, float], sample: Sample) -> Sequence[float] | None:
        """Return the modelled derivatives (c,) of the channels; None where the model has no value."""
        try:
            modelled = self.model(sample.x, sample.u, **named)
        except (ArithmeticError, ValueError):  # math.sqrt(-1.0) raises the latter
            return None
        return [modelled[i] for i in self.channels]
