"""Change of a parameter that no sample shows by itself, but many of them together.

A generalised likelihood ratio: Willsky and Jones (1976), "A generalized likelihood ratio approach to the detection and
estimation of jumps in linear systems". A disturbance, friction or lag that no sample shows by itself would change the
residuals as little, and has a chance to explain them on each channel.
"""

from collections.abc import Sequence
from math import log
from typing import Final

import numpy as np

from ..arrival_cost import ArrivalCost
from ..differences import OfMany, value_and_slope
from ..hypotheses import MARGIN, disturbance_of, plain_fit
from ..samples import Sample
from ..space import Vector
from .drift_rival import walk_deviances

_STEP: Final = 1e-5
"""Step of differences in the unit cube."""
_PROOF: Final = 2.0 * MARGIN
"""Lead over all else that proves a change."""
_MOST: Final = 0.95
"""Largest correlation that is counted."""


def hidden_change(rows_at: OfMany, samples: Sequence[Sample], z: Vector, drift: float) -> ArrivalCost | None:
    """Return what samples at equal intervals say of the parameters where they prove that one has changed; else None.

    rows_at: returns their residuals (..., n, c) at places (..., d), 0 where there is none; z (d,): place of the
    parameters in force; drift: rate of the parameters, for the filter that goes on.
    """
    before, slopes = value_and_slope(rows_at, z, _STEP)
    if not (np.isfinite(before).all() and np.isfinite(slopes).all()):
        return None
    along, power = before.reshape(-1) @ slopes, np.sum(slopes**2, axis=0)
    gains = np.divide(along**2, power, out=np.zeros(len(z)), where=power > 0.0)
    best, n_values = int(np.argmax(gains)), int(np.count_nonzero(before))
    if gains[best] < _PROOF + log(max(n_values, 2)):
        return None
    if _seen_beside(before, slopes[:, best].reshape(before.shape)) < _PROOF:
        return None
    left = before - (slopes[:, best] * (along[best] / power[best])).reshape(before.shape)
    by_channel = _left_by_others(before, _effects(samples)) - np.sum(left**2, axis=0)
    if np.sum(by_channel / _inflation(left)) - log(n_values) < _PROOF:
        return None
    known = ArrivalCost.of_window(z, OfMany(lambda places: _flat(rows_at(places))), drift)
    return known if plain_fit(rows_at(known.mean), len(z)).is_explained else None


def _seen_beside(rows: Vector, slope: Vector) -> float:
    """Return by how much the squares of rows (n, c) fall with the slopes (n, c) of the samples beside each.

    The noise of the states is in a sample's slope and in its residual, which correlates them while the plant rests.
    That of the samples beside it is another: they are instruments, Söderström and Stoica (1983).
    """
    beside, inner = slope[:-2] + slope[2:], rows[1:-1]
    power = float(np.sum(beside[inner != 0.0] ** 2))
    return float(np.sum(beside * inner)) ** 2 / power if power else 0.0


def _flat(rows: Vector) -> Vector:
    """Return rows (..., n, c) as (..., n * c)."""
    return rows.reshape(*rows.shape[:-2], -1)


def _effects(samples: Sequence[Sample]) -> Vector:
    """Return what a model may lack (n, e) but for a factor.

    Dry or quadratic friction in each state, which may be a speed, and a small lag of each input.
    """
    states, inputs = np.array([sample.x for sample in samples]), np.array([sample.u for sample in samples])
    return np.hstack([np.sign(states), np.abs(states) * states, np.diff(inputs, axis=0, prepend=inputs[:1])])


def _left_by_others(rows: Vector, effects: Vector) -> Vector:
    """Return the score (c,) on each channel of rows (n, c) of what explains it best beside changed parameters.

    Nothing, a smooth disturbance, one that walks, or one of the effects (n, e).
    """
    squares = np.sum(rows**2, axis=0)
    smooth = [disturbance_of(rows[:, [c]]).fit.score for c in range(rows.shape[1])]
    is_seen = rows != 0.0
    along, power = effects.T @ rows, (effects**2).T @ is_seen
    gains = np.divide(along**2, power, out=np.zeros(along.shape), where=power > 0.0).max(axis=0)
    of_effect = squares - gains + np.log(np.maximum(np.count_nonzero(is_seen, axis=0), 2))
    return np.minimum.reduce([squares, np.array(smooth), walk_deviances(rows), of_effect])


def _inflation(rows: Vector) -> Vector:
    """Return by how much (c,) sums of squares count less, as each of n rows (n, c) is correlated with the one before.

    A standard deviation more than they are, which n rows do not tell.
    """
    total, shared = np.sum(rows**2, axis=0), np.sum(rows[1:] * rows[:-1], axis=0)
    rho = np.divide(shared, total, out=np.zeros(len(total)), where=total > 0.0)
    rho = np.clip(rho + len(rows) ** -0.5, 0.0, _MOST)
    return (1.0 + rho) / (1.0 - rho)
