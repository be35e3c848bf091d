"""Rival of parameters that drift: a disturbance that walks at random on each channel, while the parameters stay.

Both follow whatever changes slowly. Which of them the samples are more likely with is told by their innovations:
Schweppe (1965), "Evaluation of likelihood functions for Gaussian signals". The rate of the walk is not known: a Kalman
filter for each of several, weighted by how likely they are, as Magill (1965) does.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from ..arrival_cost import ArrivalCost
from ..space import Vector

_WALKS: Final = np.array([0.003, 0.03, 0.3, 3.0])[:, None]
"""Variances (k, 1) of a disturbance's change from sample to sample, by that of the noise."""
_WIDE: Final = 100.0
"""Variance of a disturbance before the first sample."""
_WEIGHED: Final = 0.95
"""Factor by which the likelihoods of the walks fade from sample to sample."""
_RECENT: Final = 0.98
"""Factor by which the difference of the two likelihoods fades."""
_MOST: Final = 2.0
"""Largest lead on one sample: a filter that catches up with a jump is wrong by far for a few."""
_PROOF: Final = 50.0
"""Lead of the disturbance that refutes a drift, as fast as it is taken to be."""
_CLEAR: Final = 20.0
"""Lead of the drift over the newest samples with which correlated innovations do not refute it."""


@dataclass(frozen=True)
class DriftRival:
    """Disturbance of each channel by each of k walks, and its lead over drifting parameters: -2 log likelihoods."""

    mean: Vector
    """Mean (k, c), in standard deviations of the channel."""
    variance: Vector
    """Variance (k, c)."""
    unlikeliness: Vector
    """-2 log likelihood (k, c) of each walk on the newest samples, more than that of the best."""
    n_samples: int
    """Number of the newest sample in the run."""
    lead: float = 0.0
    """Largest lead of the disturbance on the samples since any one, Page's (1954) cumulative sum."""
    recent: float = 0.0
    """Its lead on the newest samples, fading; negative where the drift leads."""

    @classmethod
    def of_rows(cls, rows: Vector, n_samples: int) -> "DriftRival":
        """Return the rival that knows rows (n, c): residuals of the parameters that stay, up to the newest sample."""
        shape = len(_WALKS), rows.shape[1]
        rival = cls(np.zeros(shape), np.full(shape, _WIDE), np.zeros(shape), n_samples)
        for row in rows:
            rival = rival._with(row)[0]
        return rival

    def updated(self, row: Vector, known: ArrivalCost) -> "DriftRival":
        """Return the rival with one more sample: row (c,) of the parameters that stay; known: by the drifting ones."""
        rival, deviance = self._with(row)
        ahead = min(known.deviance - deviance, _MOST)
        lead, recent = max(0.0, self.lead + ahead), _RECENT * self.recent + ahead
        return DriftRival(rival.mean, rival.variance, rival.unlikeliness, self.n_samples + 1, lead, recent)

    def judged(self, known: ArrivalCost) -> tuple["DriftRival", ArrivalCost | None]:
        """Return the rival, and the drifting parameters to go on with: None where the samples refute a drift.

        A disturbance explains the samples better, also than parameters that drift faster, or neither does.
        """
        is_ahead = self.lead > _PROOF
        faster = known.hastened() if is_ahead and not known.is_refuted else None
        if faster is not None:
            return replace(self, lead=0.0), faster
        return self, None if is_ahead or (known.is_refuted and self.recent > -_CLEAR) else known

    def _with(self, row: Vector) -> tuple["DriftRival", float]:
        """Return the rival with a row (c,), 0 or NaN for channels without a value, and its -2 log likelihood."""
        mean, variance, found = _walked(self.mean, self.variance, np.where(np.isfinite(row), row, 0.0))
        faded = _WEIGHED * self.unlikeliness
        unlikeliness = faded + found
        after, before_it = _mixed(np.array([unlikeliness, faded]))
        beyond_best = unlikeliness - unlikeliness.min(axis=0)
        rival = DriftRival(mean, variance, beyond_best, self.n_samples, self.lead, self.recent)
        return rival, float((after - before_it).sum())


def walk_deviances(rows: Vector) -> Vector:
    """Return -2 log likelihoods (c,) of a disturbance that begins to walk on each channel of rows (n, c).

    Beside white noise of size one, whose own -2 log likelihood is the sum of squares. Zeros are missing values.
    """
    shape = len(_WALKS), rows.shape[1]
    mean, variance, unlikeliness = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    for row in rows:
        mean, variance, found = _walked(mean, variance, row)
        unlikeliness = unlikeliness + found
    return _mixed(unlikeliness)


def _walked(mean: Vector, variance: Vector, row: Vector) -> tuple[Vector, Vector, Vector]:
    """Return means and variances (k, c) of k walks after a row (c,), and its -2 log likelihoods (k, c).

    Each is a Kalman filter's, with a noise of variance one. 0 in the row is no value.
    """
    is_seen, before = row != 0.0, variance + _WALKS
    spread, innovation = before + 1.0, row - mean
    gain = np.where(is_seen, before / spread, 0.0)
    found = np.where(is_seen, innovation**2 / spread + np.log(spread), 0.0)
    return mean + gain * innovation, before * (1.0 - gain), found


def _mixed(unlikeliness: Vector) -> Vector:
    """Return the -2 log likelihood (..., c) of equally probable models (..., k, c), each with its own."""
    least = unlikeliness.min(axis=-2, keepdims=True)
    mean = np.exp(-0.5 * (unlikeliness - least)).sum(axis=-2) / unlikeliness.shape[-2]
    return least[..., 0, :] - 2.0 * np.log(mean)
