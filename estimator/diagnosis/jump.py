"""Jump of the plant's parameters: to those that explain the samples since it happened.

A filter whose parameters walk by small steps follows a jump late, and through places that explain nothing; a search has
only so many evaluations a step. Where constant parameters explain the samples since the onset both can go on from them:
Willsky and Jones (1976), "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", section III.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Final

import numpy as np

from ..arrival_cost import ArrivalCost
from ..contract import Estimate, scaled_estimate
from ..differences import OfMany, forward_differences
from ..hypotheses import Fit, changed_parameters, plain_fit
from ..identifiability import IDENTIFIABLE_BELOW, Information, information
from ..space import ParameterSpace, Vector

_STEP: Final = 1e-6
"""Step of differences in the unit cube."""
_AFTER_JUMP: Final = 0.1
"""Share of a drift's rate at which parameters may walk after a jump, until the filter's corrections show less."""


def jump_to(
    rows_at: Callable[[int], OfMany],
    lengths: Iterable[int],
    z: Vector,
    space: ParameterSpace,
    *,
    may_be_exact: bool = False,
) -> Estimate | None:
    """Return the parameters within their bounds that explain the newest samples, more of them than they have values.

    rows_at: returns the residuals (..., n, c) at the newest n samples, in standard deviations, as a function of places
    (..., d) in the unit cube; lengths: numbers n to try, the best first; z (d,): place to begin at; may_be_exact: true
    where samples are enough that have no more values than there are parameters: those near z are taken, which the next
    sample has yet to prove. None without such parameters.
    """
    for n in lengths:
        found = changed_parameters(rows_at(n), z, may_drift=False, beyond=0.0)
        may_be = may_be_exact and found.rows.size <= len(space)
        if not (found.fit.is_explained or (may_be and plain_fit(found.rows, 0, found.rows.size).is_explained)):
            continue
        slope = forward_differences(rows_at(n), found.z, found.rows, _STEP)
        if np.all(np.isfinite(slope)):  # not where the model fails close by
            known = information(slope)
            return scaled_estimate(
                space, found.z, known.std(), IDENTIFIABLE_BELOW, known, cost=found.fit.squares, n_evaluations=0,
                reason=f"parameters that explain the newest {n} samples",
            )  # fmt: skip
    return None


def followed_jump(rows_at: OfMany, n: int, z: Vector, rate: float) -> tuple[ArrivalCost, Fit] | None:
    """Return what n samples after a jump say of the parameters, and the fit of parameters that drift since then.

    The first sample, which has more values than parameters, is explained by those nearest to z (d,), the others by a
    filter that goes on from there. None where they are not. rows_at: returns residuals (..., n, c) at places (..., d);
    rate: of a drift, at most. About z a parameter has a standard deviation of half the bounds before the first sample.
    """
    first = changed_parameters(OfMany(lambda places: rows_at(places)[..., :1, :]), z, may_drift=False, beyond=0.0)
    slope = forward_differences(OfMany(lambda places: rows_at(places)[..., 0, :]), first.z, first.rows[0], _STEP)
    if not (first.fit.is_explained and np.all(np.isfinite(slope))):
        return None
    unknown = ArrivalCost.of_estimate(z, Information(np.zeros(len(z)), np.eye(len(z))), rate)
    measured = unknown.updated(OfMany(lambda places: first.rows[0] + (places - first.z) @ slope.T))
    at_first = ArrivalCost.of_estimate(measured.mean, measured.information, rate)
    walk = np.full(len(z), (_AFTER_JUMP * rate) ** 2)
    known: ArrivalCost | None = replace(at_first, walk=walk, constant=at_first.belief, n_known=1)
    squares = first.fit.squares
    for i in range(1, n):
        known = known.drifted(OfMany(lambda places, i=i: rows_at(places)[..., i, :]))
        if known is None:
            return None
        squares += known.innovation_squared
    return known, Fit(squares, len(z), int(np.count_nonzero(rows_at(known.mean))))
