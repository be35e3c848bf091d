"""Jump of the plant's parameters: to those that explain the samples since it happened.

A filter whose parameters walk by small steps follows a jump late, and through places that explain nothing; a search has
only so many evaluations a step. Where constant parameters explain the samples since the onset both can go on from them:
Willsky and Jones (1976), "A generalized likelihood ratio approach to the detection and estimation of jumps in linear
systems", section III.
"""

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from .contract import Estimate, scaled_estimate
from .differences import OfMany, forward_differences
from .hypotheses import changed_parameters, plain_fit
from .identifiability import IDENTIFIABLE_BELOW, information
from .space import ParameterSpace, Vector

_STEP: Final = 1e-6
"""Step of differences in the unit cube."""


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
    where two samples or more are enough, though they have no more values than parameters: those near z are taken, which
    the next sample has yet to prove. None without such parameters.
    """
    for n in lengths:
        found = changed_parameters(rows_at(n), z, may_drift=False, beyond=0.0)
        may_be = may_be_exact and n > 1 and found.rows.size <= len(space)
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
