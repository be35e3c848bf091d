"""Directions that the samples do not determine, held where an episode has begun."""

from typing import NamedTuple

import numpy as np

from ..identifiability import Information, information
from ..space import Vector
from .search import VectorPosterior, least_change


class Model(NamedTuple):
    """Surrogate of the best and newest candidates so far."""

    Z: Vector
    """Candidates (n, d), in the unit cube."""
    Y: Vector
    """Their residuals' principal components (n, k)."""
    costs: Vector
    """Their sums of squared residuals (n,)."""
    posterior: VectorPosterior
    """Mean and variance of the components at any place."""
    is_cut: bool = False
    """True where the residuals may have more components than are modelled."""

    @property
    def missing(self) -> float:
        """Sum of squares of the best candidate's residual that no modelled component has."""
        y = self.Y[self.best]
        return max(float(self.costs[self.best] - y @ y), 0.0) if self.is_cut else 0.0

    @property
    def best(self) -> int:
        """Index of the candidate of least cost."""
        return int(np.argmin(self.costs))


class Hold(NamedTuple):
    """Best candidate with its insignificant changes from the start undone. Places (d,) are in the unit cube."""

    best: Vector
    """The best candidate."""
    least: float
    """Sum of squared residuals of the best candidate."""
    information: Information
    """Sensitivity there, in standard deviations of the misfit."""
    least_squares: Vector
    """Place of the linearised mean's least square; may lie outside the cube."""
    n_held: int
    """Number of directions that are held."""
    place: Vector
    """Place with these directions held; the best candidate where none is."""
    expected: float
    """Sum of squared residuals that the surrogate expects there, its variances included."""
    allowed: float
    """Largest sum of squared residuals that is allowed there."""

    @property
    def is_sure(self) -> bool:
        """True where the surrogate expects the place to be within the allowance."""
        return self.expected <= self.allowed


def hold_directions(model: Model, start: Vector, n_values: int, significance: float) -> Hold:
    """Return the best candidate with insignificant changes undone, and what is expected there.

    start (d,): place from which it has changed; n_values: number D of residuals; significance: standard deviations by
    which a change in a direction must exceed zero.
    """
    z, least = model.Z[model.best], float(model.costs[model.best])
    misfit = max(1.0, np.sqrt(least / max(n_values - len(z), 1)))
    mean, jacobian = model.posterior.mean_and_jacobian(z)
    seen_by_data = information(jacobian / misfit)
    least_squares = z + seen_by_data.step(jacobian.T @ mean / misfit**2)
    moved = seen_by_data.significant(z - start, significance)
    place, expected = z, least
    if len(moved) < len(z):
        place = start
        if len(moved):
            place = least_change(model.posterior, place + moved.T @ moved @ (z - place), len(moved))
        mean, variance = model.posterior.predict(place[None])
        expected = float(np.sum(mean * mean + variance)) + model.missing
    allowed = least + (significance * misfit) ** 2
    return Hold(z, least, seen_by_data, least_squares, len(z) - len(moved), place, expected, allowed)
