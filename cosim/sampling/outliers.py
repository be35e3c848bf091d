"""Detection of outliers: a sample whose residual jumps is suspect until the next shows whether the change persists."""

from collections.abc import Callable
from math import sqrt
from typing import Final

import numpy as np

from estimator import Sample, Vector

from .medians import column_medians

_MEMORY: Final = 31
"""Number of changes of the residual whose median is the usual change."""
_MOST_SUSPECTS: Final = 5
"""Largest number of suspects in a row: outliers are isolated."""
_PERSISTS: Final = 0.3
"""Share of a jump that must persist in the next sample; the controller may have responded to it already."""

_FEW: Final = 5
"""Number of changes below which they do not show what is usual."""
_LARGER: Final = 3.0 * 10.0 * sqrt(2.0)
"""Change that is no noise of ten times the declared size: three standard deviations of it."""


class Outliers:
    """Detector of outliers, which keeps the last good sample and the suspect one."""

    def __init__(
        self,
        limit: float,
        names: tuple[str, ...],
        noise: tuple[float, ...],
        residual: Callable[[Vector, Sample], Vector],
    ) -> None:
        """limit: of a change, in robust standard deviations of the changes so far, at least of the noise; names, noise:
        of the channels (c,); residual: whitened, (c,) of one sample."""
        self._limit, self._names, self._noise, self._residual = limit, names, np.array(noise), residual
        self._last: Sample | None = None
        self._suspect: Sample | None = None
        self._theta = np.empty(0)  # in force at the suspect
        self._was_far = np.zeros(len(noise), dtype=bool)  # channels that had jumped at the suspect
        self._n_suspects = 0
        self._changes = np.empty((0, len(noise)))
        self._known = (np.empty(0), np.empty(0))  # parameters, and the residual of the last good sample there

    def step(self, sample: Sample, theta: Vector) -> tuple[bool, list[str]]:
        """Return whether the sample is suspect, and the sensors for which the suspect before it was an outlier.

        A derivative that is missing now, or was in the sample before, is no jump: its limit is not a number.
        theta (d,): parameters in force. After a suspect those in force at it are used instead, and what was far then
        is: a write due to it has changed the inputs, which with wrong parameters makes residuals jump as well.
        """
        residual = self._residual
        if self._suspect is not None:
            theta = self._theta
        now = residual(theta, sample)
        if self._last is None or not np.isfinite(now).all():
            return self._accept(sample, theta, now), []
        last = self._known[1] if theta is self._known[0] else residual(theta, self._last)
        measured = np.subtract(sample.xdot, self._last.xdot) / self._noise  # NaN where one of them is missing
        change = np.where(np.isnan(measured), 0.0, np.abs(now - last))
        of_model = np.abs(measured - (now - last))  # the change of the model, whose error may change by as much
        limit = self._limit * sqrt(2.0) + of_model
        if self._suspect is not None or not (change <= limit).all():  # what is usual only widens it
            limit = np.maximum(self._limit * np.maximum(self._usual(change), sqrt(2.0)), self._least) + of_model
        is_far, names = change > limit, list[str]()
        if np.isfinite(last).all():  # else none of the limits to come would be a number
            self._changes = np.concatenate([self._changes[1 - _MEMORY :], [change]])
        if self._suspect is not None:
            before = residual(theta, self._suspect)
            # By what is usual by now; where the model has moved by more than that, only if all channels are back.
            is_gone = bool((change <= limit - of_model).all())
            was_far = self._was_far & (np.abs(before - last) > (limit - of_model if is_gone else limit))
            persists = (now - last) / np.where(was_far, before - last, 1.0) >= _PERSISTS
            is_far &= ~(persists & was_far)
            names = [self._names[i] for i in np.flatnonzero(was_far & ~persists)]
        if np.count_nonzero(is_far) and self._n_suspects < _MOST_SUSPECTS:
            self._suspect, self._theta, self._was_far = sample, theta, is_far
            self._n_suspects += 1
            return True, names
        return self._accept(sample, theta, now), names

    @property
    def _least(self) -> float:
        """Change below which a suspect is no outlier, as few others show what is usual."""
        return _LARGER if self._suspect is not None and len(self._changes) < _FEW else 0.0

    def _usual(self, newest: Vector) -> Vector:
        """Return the usual change of the residual (c,), as a standard deviation.

        A suspect is judged by the changes of others: as the only one so far its own would excuse it. newest (c,): since
        the last good sample.
        """
        changes = self._changes
        if self._suspect is not None and np.isfinite(newest).all():
            changes = np.concatenate([changes[:-1], [newest]])
        return 1.4826 * column_medians(changes) if len(changes) else np.zeros(len(self._noise))

    def _accept(self, sample: Sample, theta: Vector, residual: Vector) -> bool:
        self._known = theta, residual
        self._last, self._suspect, self._n_suspects = sample, None, 0
        return False
