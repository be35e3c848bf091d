"""Residuals of a model on a sliding window of samples."""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .samples import Sample
from .significance import FALSE_ALARM, chi2_limit
from .space import Vector

_OLDER: Final = 100
"""Largest number of samples that have left the window in an episode and are kept."""


class ResidualWindow:
    """Sliding window of samples; each channel reaches back as far as its residuals pass a chi-square test.

    A residual is computed once for each candidate and sample: a new sample costs one model call for each stored
    candidate, a new candidate one for each sample of the window.
    """

    is_rescoring_cheap = is_ready = True

    def __init__(
        self,
        residual: Callable[[Vector, Sample], Vector],
        n_channels: int,
        max_length: int = 10,
        rows: Callable[[Vector, Sequence[Sample]], Vector] | None = None,
        slopes: Callable[[Vector, Sequence[Sample]], Vector | None] | None = None,
    ) -> None:
        """residual: (c,) of a candidate at a sample; rows: (..., n, c) of candidates (..., d) at n samples, which is
        faster; None for one after the other; slopes: (n, c, d) in the unit cube of one candidate."""
        if max_length < 1:
            raise ValueError(f"max_length must be at least 1 sample, got {max_length}.")
        self._residual, self._rows_at = residual, rows or partial(_one_by_one, residual)
        self._slopes, self._max_length = slopes, max_length
        self._samples: list[Sample] = []
        self._older: deque[Sample] = deque(maxlen=_OLDER)
        self._n_since_begin = 0
        self._lengths = [0] * n_channels
        self._is_explained = [True] * n_channels
        self._rows: dict[bytes, list[Vector]] = {}
        self.n_model_calls = 0
        """Number of samples at which a candidate was evaluated; those of an evaluation depend on the re-scoring."""

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of samples in use, for each channel."""
        return tuple(self._lengths)

    @property
    def is_full(self) -> bool:
        """True where a channel has as many samples as it may have."""
        return max(self._lengths) == self._max_length

    @property
    def n_kept(self) -> int:
        """Number of samples in the window, and of those kept that have left it."""
        return len(self._older) + len(self._samples)

    @property
    def n_since_begin(self) -> int:
        """Number of samples kept since the episode began, the one that began it included."""
        return min(self._n_since_begin, self.n_kept)

    @property
    def newest(self) -> Sample:
        """The newest sample. Raises IndexError where there is none."""
        return self._samples[-1]

    def append(self, sample: Sample) -> None:
        """Add a sample, and drop the oldest where the window is full."""
        self._samples.append(sample)
        self._n_since_begin += 1
        self._lengths = [min(n + 1, self._max_length) for n in self._lengths]
        excess = len(self._samples) - max(self._lengths)
        if excess:
            self._older.extend(self._samples[:excess])
            del self._samples[:excess]
            for rows in self._rows.values():
                del rows[:excess]

    def begin(self, theta: Vector) -> None:
        """Begin an episode: the window slides, whether there is one or not, but what leaves it from now on is kept."""
        self._older.clear()
        self._n_since_begin = 1

    def end(self, theta: Vector) -> None:
        """Do nothing, as in `begin`."""

    def revert(self, theta: Vector) -> None:
        """Do nothing: no residual depends on parameters that were in force before."""

    def why_failed(self, theta: Vector) -> None:
        """Return None: a candidate fails where the model has no value, for no other reason."""

    def copy(self) -> "ResidualWindow":
        """Return an independent copy of the window."""
        other = copy(self)
        other._older = self._older.copy()
        other._samples, other._lengths, other._is_explained = [*self._samples], [*self._lengths], [*self._is_explained]
        other._rows = {key: [*rows] for key, rows in self._rows.items()}
        return other

    def clear(self) -> None:
        """Remove every sample, as after a jump of the parameters."""
        self._samples.clear()
        self._older.clear()
        self._rows.clear()
        self._lengths = [0] * len(self._lengths)

    def residual(self, theta: Vector) -> Vector:
        """Return the residuals of one candidate over the window (D,), channel by channel, each from old to new."""
        return np.array(self._rows_of(theta)).reshape(-1)[self._in_use()]

    def newest_residual(self, theta: Vector) -> Vector:
        """Return the residual (..., c) of candidates theta (..., d) at the newest sample."""
        return self.residual_at(theta, self._samples[-1])

    def residual_at(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (..., c) of candidates theta (..., d) at a sample, in the window or not."""
        if theta.ndim == 1:
            self.n_model_calls += 1
            return self._residual(theta, sample)
        self.n_model_calls += theta.size // theta.shape[-1]
        return self._rows_at(theta, [sample])[..., 0, :]

    def newest_residuals(self, thetas: Vector, n: int) -> Vector:
        """Return the residuals (k, n, c) of candidates (k, d) at the newest n samples, of those kept, old to new."""
        samples = [*self._older, *self._samples][-n:]
        self.n_model_calls += len(samples) * len(thetas)
        return self._rows_at(thetas, samples)

    def slopes(self, theta: Vector) -> Vector | None:
        """Return the slopes (D, d) of the residuals of theta (d,) in the unit cube; None where the model has none."""
        table = None if self._slopes is None else self._slopes(theta, self._samples)
        if table is None:
            return None
        self.n_model_calls += len(self._samples)
        return table.reshape(-1, table.shape[-1])[self._in_use()]

    def residuals(self, candidates: Iterable[Vector]) -> Vector:
        """Return the residuals of many candidates (n, D); rows kept for others are dropped."""
        thetas = list(candidates)
        self.keep(thetas)
        self._complete(thetas)
        table = np.array([self._rows_of(theta) for theta in thetas])
        return table.reshape(len(thetas), len(self._samples) * len(self._lengths))[:, self._in_use()]

    def _rows_of(self, theta: Vector) -> list[Vector]:
        """Return the residuals (c,) of one candidate at each sample."""
        self._complete([theta])
        return self._rows[theta.tobytes()]

    def _complete(self, candidates: Iterable[Vector]) -> None:
        """Compute the residuals that candidates lack, those that lack as many at once."""
        lacking: dict[int, dict[bytes, Vector]] = {}
        for theta in candidates:
            key = theta.tobytes()
            n = len(self._samples) - len(self._rows.setdefault(key, []))
            if n:
                lacking.setdefault(n, {})[key] = theta
        for n, thetas in lacking.items():
            self.n_model_calls += n * len(thetas)
            table = self._rows_at(np.array([*thetas.values()]), self._samples[-n:])
            for key, rows in zip(thetas, table, strict=True):
                self._rows[key].extend(rows)

    def _in_use(self) -> NDArray[np.intp]:
        """Return the indices (D,) of the residuals in use, channel by channel, in a flat (samples, channels) table."""
        end, n_channels = len(self._samples), len(self._lengths)
        return np.concatenate([np.arange(end - n, end) * n_channels + c for c, n in enumerate(self._lengths)])

    def keep(self, candidates: Iterable[Vector]) -> None:
        """Drop the rows kept for all but these candidates."""
        kept = {theta.tobytes() for theta in candidates}
        self._rows = {key: rows for key, rows in self._rows.items() if key in kept}

    def wait(self) -> None:
        """Take all samples for unexplained yet: they wait for a better incumbent, none is dropped."""
        self._is_explained = [False] * len(self._lengths)

    def explain(self, theta: Vector, patient: bool = True) -> None:
        """Restart, at the newest sample, each channel that stopped agreeing with the incumbent theta.

        A channel is explained while its sum of squared residuals passes a chi-square test.
        One that was explained and no longer is shows a jump or a drift, and its past samples mislead. So a
        drifting parameter is tracked with the newest sample, while channels of constant parameters average. One that
        was not explained yet waits for a better incumbent, unless patient is False.
        """
        first = 0
        residual = self.residual(theta)
        for c, n in enumerate(self._lengths):
            mine = residual[first : first + n]
            first += n
            is_explained = float(mine @ mine) <= chi2_limit(FALSE_ALARM, n)
            if not is_explained and n > 1 and (self._is_explained[c] or not patient):
                self._lengths[c] = 1
                is_explained = float(mine[-1] ** 2) <= chi2_limit(FALSE_ALARM, 1)
            self._is_explained[c] = is_explained


def _one_by_one(residual: Callable[[Vector, Sample], Vector], thetas: Vector, samples: Sequence[Sample]) -> Vector:
    """Return the residuals (k, n, c) of candidates (k, d) at n samples."""
    return np.array([[residual(theta, sample) for sample in samples] for theta in thetas])
