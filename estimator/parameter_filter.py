"""Extended Kalman filter that follows parameters between searches, from sample to sample."""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, runtime_checkable

import numpy as np

from .arrival_cost import ArrivalCost
from .contract import AskTell, Estimate, scaled_estimate
from .differences import OfMany
from .identifiability import IDENTIFIABLE_BELOW
from .significance import chi2_limit, is_explained
from .sliding_window import ResidualWindow
from .space import ParameterSpace, Vector

FILTERED = "filtered"
"""Reason of an estimate whose information is that of all samples since the parameters changed, and of nothing else."""
_AGREES = 4.0
"""Squared distance, in standard deviations and by parameter, up to which a filtered estimate is that of a write."""
_WORTH = 1.0
"""Standard deviations by which a parameter must differ for a write to move it."""
_DRIFTING = 0.01
"""Probability that parameters seem to have drifted since a search began, though they are constant."""


class ParameterFilter:
    """Filter of parameters that drift; a jump is for a search to find, which gives it a new beginning.

    While nothing drifts, all samples since then are linearised anew after 20, 40 and 80 of them.
    """

    def __init__(
        self, space: ParameterSpace, drift: float, significance: float, identifiable_below: float = IDENTIFIABLE_BELOW
    ) -> None:
        """drift: standard deviation of a parameter's change from sample to sample, as a share of the scaled bounds;
        significance: standard deviations by which an unknown direction must differ to be written; identifiable_below:
        share of the scaled bounds below which the standard deviation of a known one is."""
        self._space = space
        self._significance, self._identifiable_below = significance, identifiable_below
        self.drift = drift
        """Standard deviation of a parameter's change from sample to sample, as a share of the scaled bounds."""
        self.arrival_cost: ArrivalCost | None = None
        """What the samples so far say of the parameters, in the unit cube, frozen; None before an estimate."""
        self.before_search: ArrivalCost | None = None
        """What they said when the newest search began."""
        self._searched_from: Vector | None = None  # the parameters in force then (d,)

    def begin(self, theta: Vector, residual: Callable[[Vector], Vector]) -> None:
        """Begin with the least squares of a window about theta (d,).

        residual: (..., D) of theta (..., d) over the window, in standard deviations.
        """
        self.arrival_cost = self._least_squares(theta, residual)

    def begin_search(self, held: Vector) -> None:
        """Take the beginning of a search at the parameters in force (d,)."""
        self.before_search, self._searched_from = self.arrival_cost, held

    def begin_after_search(self, found: Vector, held: Vector, window: ResidualWindow) -> None:
        """Begin with what the samples of a search say, close to what it has found (d,) or to what is held (d,) now.

        These are all samples since the search began, where constant parameters explain them. Else those of the window,
        and older ones as far as they agree; it does not begin where any parameters explain so few of them.
        Where the search has ended where it began, nothing has changed: what was known before is known again.
        """
        if self._searched_from is not None and self._space.are_same(found, self._searched_from):
            self.recall(found)
            return
        places = np.array([found, held])
        residuals = window.residuals(places)
        costs = np.sum(residuals**2, axis=1)
        best_first, d = places[np.argsort(costs, kind="stable")], len(self._space)
        limit = float(costs.min()) + chi2_limit(_DRIFTING, d)
        of_all = (self._least_squares_of_all(place, window, limit) for place in best_first)
        known, n = next((known for known in of_all if known is not None), None), window.n_since_begin
        if known is None and residuals.shape[1] >= d:
            known = self._least_squares(best_first[0], lambda thetas: window.residuals([*thetas]))
            n = max(window.lengths)
        if known is not None:
            before = slice(0, window.n_kept - n)
            at = OfMany(lambda z: window.newest_residuals(self._space.beyond(z), window.n_kept)[:, before])
            known = replace(known, n_known=n).reaching_back(at)
        self.arrival_cost = known

    def _least_squares(self, theta: Vector, residual: Callable[[Vector], Vector]) -> ArrivalCost:
        at = OfMany(lambda places: residual(self._space.beyond(places)))
        return ArrivalCost.of_window(self._space.to_unit(theta), at, self.drift)

    def _least_squares_of_all(self, theta: Vector, window: ResidualWindow, limit: float) -> ArrivalCost | None:
        """Return what all samples since a search began say close to theta (d,); None where they are not explained.

        limit: of the sum of squares over the window, which is larger where the parameters have drifted since then.
        """

        def residual(thetas: Vector) -> Vector:
            return window.newest_residuals(thetas, window.n_since_begin).reshape(len(thetas), -1)

        known = self._least_squares(theta, residual)
        found = self._space.from_unit(known.mean)
        (of_all,), of_window = residual(found[None]), window.residual(found)
        is_known = len(of_all) >= len(theta) and is_explained(of_all) and of_window @ of_window <= limit
        return known if is_known else None

    def relinearise(self, newest: Callable[[Vector, int], Vector]) -> None:
        """Linearise all samples since the parameters changed anew, where it is time to.

        newest: returns the residuals (k, n, c) of theta (k, d) at the newest n samples, in standard deviations.
        """
        known = self.arrival_cost
        if known is not None and known.is_to_be_relinearised:
            at = OfMany(lambda places: newest(self._space.beyond(places), known.n_known))
            self.arrival_cost = known.relinearised(at)

    def expects(self, residual: Callable[[Vector], Vector]) -> bool:
        """Return whether the parameters that it knows, which do not drift, explain a sample that others may not.

        residual: (..., c) of theta (..., d), in standard deviations.
        """
        known = self.arrival_cost
        return known is not None and known.expects(OfMany(lambda z: residual(self._space.beyond(z))))

    def follow(self, residual: Callable[[Vector], Vector], is_triggered: bool) -> bool:
        """Take one more sample; return False where a search is needed.

        residual: (..., c) of theta (..., d), in standard deviations; is_triggered: true where a search would begin.
        """
        if self.arrival_cost is None:
            return False
        at = OfMany(lambda z: residual(self._space.beyond(z)))
        known = self.arrival_cost.drifted(at) if is_triggered else self.arrival_cost.updated(at)
        self.arrival_cost = self.arrival_cost if known is None else known
        return known is not None

    def estimate(self, held: Vector) -> Estimate | None:
        """Return the estimate after the newest sample; None where the samples do not tell it from held (d,).

        Parameters that do not differ from held by a standard deviation stay there, and so do directions that it does
        not know, and in which it does not differ significantly.
        """
        known, z = self.arrival_cost, self._space.to_unit(held)
        if known is None or known.distance(z) < _WORTH**2:  # then no parameter differs by so much
            return None
        seen = known.information
        away = seen.least_moved(known.mean - z, _WORTH)
        moved = seen.written(away, self._significance, self._identifiable_below)
        if not (len(moved) and away.any()):
            return None
        place = z + moved.T @ (moved @ away)
        std = np.minimum(np.hypot(seen.std(), known.mean - place), 1.0)
        return scaled_estimate(
            self._space, place, std, self._identifiable_below, seen,
            cost=known.cost, n_evaluations=0, reason=FILTERED,
        )  # fmt: skip

    def recall(self, held: Vector) -> None:
        """Go back to what was known before the newest search, where it agrees with the parameters held (d,)."""
        known = self.before_search
        agrees = known is not None and known.distance(self._space.to_unit(held)) < _AGREES * len(held)
        self.arrival_cost = known if agrees else None

    def forget(self) -> None:
        """Forget what the samples so far say of the parameters."""
        self.arrival_cost = self.before_search = None


@runtime_checkable
class Following(AskTell, Protocol):
    """Ask-tell estimator whose filter goes on with single samples between its episodes."""

    filter: ParameterFilter
