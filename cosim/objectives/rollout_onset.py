"""Roll-outs from a simulated state: what changed may have acted on it for some samples before the window begins."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from estimator import Evaluation, SampleSequence, Vector
from estimator.significance import is_explained

from .rollout import RolloutObjective

_LONGEST: Final = 10
"""Largest number of samples by which a window begins after what has changed."""
_SOON: Final = 5
"""Number of samples after an episode within which another one is about the same change."""


class Onset:
    """Evaluates candidates that act from before a window on, from where the samples are explained best.

    A window begins where the parameters in force stopped explaining the samples, which is after they were no longer
    true, and the state there is simulated with them. So other parameters, and a disturbance, act from up to ten
    samples before, the residual being taken for linear in their number. Where episodes have followed one another and
    changed nothing, these are counted from the first one's beginning; from its end, if it was explained.
    """

    def __init__(self, objective: RolloutObjective) -> None:
        self._objective = objective
        self._first: int | None = None
        """Place since which episodes have changed nothing: the first one's beginning, or its end if explained."""
        self._end = 0
        """Place of the newest sample when the last of these ended."""
        self._is_moved = False
        self._is_explained = False
        """True where the parameters in force explain the stretch that was evaluated last."""
        self._of: tuple[object, int] | None = None
        """First sample, and its place in the history, of the stretch that was evaluated last."""
        self._fitted: list[tuple[Vector, Vector, int]] = []
        """Candidates on it: parameters, moved inputs, and how many samples before it they act."""

    def evaluate(self, thetas: Sequence[Vector], stretch: SampleSequence) -> list[Evaluation]:
        """Return the evaluation of each candidate over the stretch."""
        objective, place, n = self._objective, stretch.origin.place, stretch.n_steps
        if self._of is None or self._of[0] is not stretch.samples[0]:
            self._of, self._fitted = (stretch.samples[0], place), []
            self._is_explained = False
        moved = objective.moved(stretch)
        is_changed = [bool(np.any(moved)) or not objective.is_held(theta, place) for theta in thetas]
        changed = [theta for theta, is_one in zip(thetas, is_changed, strict=True) if is_one]
        held = [theta for theta, is_one in zip(thetas, is_changed, strict=True) if not is_one]
        least = self._least(place)
        most = min(least + _LONGEST, place)
        late = objective.evaluate(changed, objective.begun_earlier(stretch, moved, least)) if changed else []
        early = objective.evaluate(changed, objective.begun_earlier(stretch, moved, most)) if changed else []
        fitted: list[Evaluation] = []
        for theta, a, b in zip(changed, late, early, strict=True):
            found, share = _best(a, b, len(stretch.samples[0].y), n)
            fitted.append(found)
            self._fitted.append((theta, moved, least + round(share * (most - least))))
        known = objective.evaluate(held, stretch) if held else []
        if known:
            self._is_explained = known[0].reason is None and is_explained(known[0].residual)
        of_held, of_changed = iter(known), iter(fitted)
        return [next(of_changed if is_one else of_held) for is_one in is_changed]

    def accept(self, theta: Vector, stretch: SampleSequence) -> int:
        """Take the end of an episode; return the number of samples before the stretch from which on theta (d,) acts."""
        objective, place = self._objective, stretch.origin.place
        is_same = objective.is_held(theta, place) and not self._is_moved
        n_before = 0 if objective.is_held(theta, place) else self._n_before(theta, objective.moved(stretch), place)
        if not is_same:
            self._first = None
        elif not self._least(place):
            self._first = place + (stretch.n_steps if self._is_explained else 0)
        self._end, self._is_moved = objective.newest_place, False
        return n_before

    def move_inputs(self, moved: Vector, stretch: SampleSequence) -> int:
        """Return the number of samples before the stretch from which on inputs moved by (p,) act."""
        self._is_moved, place = True, stretch.origin.place
        known = [one for one in self._fitted if self._objective.is_held(one[0], place)]
        return min(known, key=lambda one: float(np.sum((one[1] - moved) ** 2)))[2] if known else self._least(place)

    def _n_before(self, theta: Vector, moved: Vector, place: int) -> int:
        same = (n for t, m, n in reversed(self._fitted) if np.array_equal(t, theta) and np.array_equal(m, moved))
        return next(same, self._least(place))

    def _least(self, place: int) -> int:
        """Return the number of samples since the first of the episodes that changed nothing, up to a place."""
        if self._first is None or not self._first < place <= self._end + _SOON:
            return 0
        return place - self._first


def _best(late: Evaluation, early: Evaluation, n_channels: int, n_steps: int) -> tuple[Evaluation, float]:
    """Return the evaluation of the last steps with the least sum of squares between two, and the second's share."""
    if late.reason is not None or early.reason is not None:
        return late if late.reason is not None else early, 0.0
    a, b = (e.residual.reshape(n_channels, -1)[:, -n_steps:] for e in (late, early))
    change = b - a
    size = float(np.sum(change**2))
    share = float(np.clip(-np.sum(a * change) / size, 0.0, 1.0)) if size > 0.0 else 0.0
    best = a + share * change
    return Evaluation(best.reshape(-1), None, np.sum(best**2, axis=0)), share
