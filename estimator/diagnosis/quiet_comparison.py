"""Comparison of hypotheses on quiet samples, none of which contradicts the parameters in force by itself."""

from collections.abc import Iterator
from math import log
from typing import Final

import numpy as np

from ..arrival_cost import ArrivalCost
from ..differences import OfMany
from ..hypotheses import USUAL_RATE, Weighing, changed_parameters, disturbance_of, plain_fit
from ..samples import Samples
from ..space import Vector
from .hidden_change import hidden_change
from .residual_scale import NOISY
from .settings import QUIET, Judgement
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState

_DRIFT: Final = WINDOW * USUAL_RATE
"""Longest move of a parameter that drifts over as many samples as are compared, as a share of the scaled bounds."""
_CALM: Final = 30
"""Number of quiet samples in a row, of which the newest are no more than noise, that show the noise to be known."""
_HIDDEN: Final = 50
"""Least number of quiet samples in which a change is sought that none of them shows, and how many pass between."""


class QuietComparison:
    """Judgement of new parameters, and search for a change or a noise, while no sample is suspicious."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals) -> None:
        self._state, self._residuals, self._space = state, residuals, residuals.space

    def judge(self, theta: Vector, held: Vector, *, is_filter: bool) -> Judgement:
        """Return whether parameters theta (d,), of a filter or not, in place of those in force (d,) are warranted."""
        n = min(len(self._state.samples), QUIET)
        is_explained = plain_fit(self._residuals.of_newest(theta, n), 0).is_explained
        may_drift = is_filter or self._state.in_force.have_changed
        return self._judged(theta, held, may_drift=may_drift) if is_explained else "refuted"

    def _judged(self, theta: Vector, held: Vector, *, may_drift: bool) -> Judgement:
        """Return whether parameters theta (d,), which explain the newest samples, may replace those in force (d,).

        A move that is too long for a drift must be proven, where no other parameters were in force since the onset, and
        no `hidden_change` has been found since. So must any that may not be a drift, as the first one of a search.
        Where the residuals are larger than declared, which may hide a change, the newest samples must speak for it,
        without the one that does so most; else it is possible. While the noise is not known yet every move must be
        proven, and coloured noise must explain the samples much less.
        """
        state, d = self._state, len(self._space)
        moved = np.abs(self._space.to_unit(theta) - self._space.to_unit(held)).max()
        is_known = state.is_noise_known
        if is_known and ((moved <= _DRIFT and may_drift) or state.has_moved or state.has_hidden_change):
            return "warranted"
        if is_known and np.any(state.scale.values > 1.0):
            n = len(state.samples)
            gains = np.sum(self._residuals.of_newest(held, n) ** 2 - self._residuals.of_newest(theta, n) ** 2, axis=1)
            are_many = gains.sum() - gains.max() > d * log(n * len(state.scale.values))
            return "warranted" if are_many or not state.has_lasted(held) else "possible"
        for n in shorter(len(state.samples)):
            before = self._residuals.of_newest(held, n)
            parameters = plain_fit(self._residuals.of_newest(theta, n), d)
            nothing, disturbance = plain_fit(before, 0), disturbance_of(before).fit
            weighing = Weighing(parameters, disturbance, nothing, coloured=state.coloured_noise(before))
            if weighing.are_parameters_proven:
                state.is_noise_known |= weighing.are_parameters_certain
                return "warranted"
        return "refuted"

    def learn_noise(self, held: Vector) -> None:
        """Take the noise for known once it explains the newest of many quiet samples; held (d,): in force."""
        state = self._state
        if not state.is_noise_known and state.n_quiet >= _CALM:
            state.is_noise_known = plain_fit(self._residuals.of_newest(held, WINDOW), 0).is_explained

    def hidden_change(self, held: Vector, drift: float) -> ArrivalCost | None:
        """Return what many quiet samples say of the parameters where they together contradict held (d,), in force.

        Now and then; else None. drift: standard deviation of a parameter's change from sample to sample, a share of
        the scaled bounds.
        """
        state = self._state
        if state.n_samples % _HIDDEN or len(state.quiet) < _HIDDEN:
            return None
        samples = Samples(self._residuals.corrected(sample) for sample in state.quiet)
        at = OfMany(lambda z: self._residuals.scaled_rows(self._space.beyond(z), samples))
        found = hidden_change(at, samples, self._space.to_unit(held), drift)
        state.has_hidden_change |= found is not None
        return found

    def admit_noise(self, held: Vector) -> bool:
        """Take the residuals before the newest sample for noise where nothing that changes smoothly explains them.

        Neither parameters, held (d,) or others, nor a disturbance: the declared noise is too small. They are those of
        quiet samples, none of which is too large by itself. Return whether their size has changed.
        """
        state = self._state
        n = min(len(state.samples), state.n_calm + 1)
        if n <= NOISY:
            return False
        rows = self._residuals.of_newest(held, n)[:-1]
        if plain_fit(rows, 0).is_explained or disturbance_of(rows).fit.is_explained:
            return False
        rows_at = self._residuals.at_newest(n)
        found = changed_parameters(OfMany(lambda z: rows_at(z)[..., :-1, :]), self._space.to_unit(held))
        return not found.fit.is_explained and state.admit_usual(rows)


def shorter(n: int) -> Iterator[int]:
    """Yield numbers of newest samples from n down to 6, each two thirds of the one before."""
    while n > QUIET:
        yield n
        n = 2 * n // 3
