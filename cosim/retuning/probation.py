"""Probation of what is written into a controller: the tracking error that each write may lead to, and for how long."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import dist, isfinite
from typing import Final

import numpy as np

from estimator import Vector

_MEMORY: Final = 1000
"""Number of macro steps without a write whose largest tracking error is the usual one."""


@dataclass(frozen=True)
class Trial:
    """A write on probation."""

    theta: Vector
    """Parameters written (d,)."""
    since: int
    """Communication point of the write."""
    expected: float
    """Norm of the tracking error that it may lead to, whatever is tolerated."""
    is_proven: bool
    """True where no disturbance explains the samples as well."""


class Probation:
    """Writes on probation, from old to new, and the tracking error that is tolerated of them.

    An error below `tolerance` is no reason to take a write back, nor to refuse it. Where the parameters may be the old
    ones, as a disturbance explains the samples as well, less is tolerated: `growth` times the largest error of late
    while nothing was written.
    """

    def __init__(self, tolerance: float, growth: float, n_steps: int, n_apart: int) -> None:
        """n_steps: macro steps that it lasts; n_apart: those before a proposal that are not usual, as the plant may
        have changed in them."""
        self._tolerance, self._growth, self._n_steps, self._n_apart = tolerance, growth, n_steps, n_apart
        self._trials: deque[Trial] = deque()
        self._ended = -1  # communication point of the newest write whose probation has ended
        self._reference: tuple[float, ...] = ()
        self._newest: deque[float] = deque()
        self._usual: deque[float] = deque(maxlen=_MEMORY)

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Writes on probation, from old to new."""
        return tuple(self._trials)

    @property
    def is_proven(self) -> bool:
        """True where no disturbance explains the samples as well as what is on probation."""
        return all(trial.is_proven for trial in self._trials)

    @property
    def allowed(self) -> float | None:
        """Norm of the tracking error above which the oldest write is to be taken back; None where there is none."""
        if not self._trials:
            return None
        oldest = self._trials[0]
        return max(self.tolerated(is_proven=oldest.is_proven), oldest.expected)

    def tolerated(self, *, is_proven: bool) -> float:
        """Return the norm of the tracking error that is no reason to refuse a write or to take it back."""
        if is_proven or not self._usual:
            return self._tolerance
        return min(self._tolerance, self._growth * max(self._usual))

    def watch(self, error: float, reference: Sequence[float], *, is_proposed: bool) -> None:
        """Take the norm of the tracking error at a communication point, and whether parameters are proposed there.

        reference: values that the tracked outputs are to follow; a jump of theirs is no fault of a write.
        """
        jump = dist(reference, self._reference) if self._reference and self._trials else 0.0
        self._reference = tuple(reference)
        if self.allowed is not None and jump > self.allowed:
            further = self._growth * jump
            self._trials = deque(replace(trial, expected=trial.expected + further) for trial in self._trials)
        if is_proposed or self._trials or not isfinite(error):
            if not self._usual:  # at the start of a run nothing else is known
                self._usual.extend(self._newest)
            self._newest.clear()
            return
        self._newest.append(error)
        if len(self._newest) > self._n_apart:
            self._usual.append(self._newest.popleft())

    def begin(self, k: int, theta: Vector, expected: float, *, is_proven: bool) -> None:
        """Put parameters (d,), written at communication point k, on probation."""
        self._trials.append(Trial(theta, k, expected, is_proven))

    def prove(self) -> None:
        """Take it that the parameters have changed: no disturbance explains the samples as well."""
        self._trials = deque(replace(trial, is_proven=True) for trial in self._trials)

    def end(self, k: int) -> list[Trial]:
        """Return the writes whose probation ends at communication point k."""
        ended: list[Trial] = []
        while self._trials and k - self._trials[0].since >= self._n_steps:
            trial = self._trials.popleft()
            self._ended = trial.since
            ended.append(trial)
        return ended

    def clear(self) -> None:
        """End it for all writes, as they are taken back."""
        self._trials.clear()

    def restore(self, trials: Sequence[Trial]) -> None:
        """Return to earlier trials, but for those that have ended since: later writes are forgotten, others go on."""
        present = {trial.since: trial for trial in self._trials}
        self._trials = deque(present.get(trial.since, trial) for trial in trials if trial.since > self._ended)

    def keep(self, theta: Vector) -> None:
        """Forget the writes of any parameters but theta (d,)."""
        self._trials = deque(trial for trial in self._trials if np.array_equal(trial.theta, theta))
