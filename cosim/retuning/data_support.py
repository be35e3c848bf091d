"""Support of a write by the newest samples: identifiable directions and residuals of the scenario's model."""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import numpy as np

from estimator import ParameterSpace, Sample, Vector
from estimator.differences import OfMany, central_differences
from estimator.identifiability import Information, information

Reason = tuple[Literal["limit", "hold", "veto"], str]
"""Action on a write, and its reason."""
_STEP = 1e-4
"""Step of central differences in the unit cube."""
_WIDEST = 0.25
"""Largest distance of a plausible parameter from the estimate, as a share of the scaled bounds."""


class NoDataSupport:
    """Support of every write, for objectives that do not score candidates sample by sample."""

    n_channels = 1

    def append(self, sample: Sample) -> None:
        """Discard the sample."""

    def snapshot(self) -> tuple[Sample, ...]:
        """Return no samples."""
        return ()

    def restore(self, snapshot: tuple[Sample, ...]) -> None:
        """Do nothing: no samples are kept."""

    def cost(self, theta: Vector) -> float:
        """Return 0: no sample contradicts."""
        return 0.0

    def residuals(self, theta: Vector) -> Vector:
        """Return those of no sample."""
        return np.empty((0, self.n_channels))

    def identifiable_part(
        self, theta: Vector, held: Vector, at: Vector, unseen: float, little: float, known: Information | None = None
    ) -> tuple[Vector, tuple[Reason, ...]]:
        """Return the candidate (d,) as it is."""
        return theta, ()

    def plausible_parameters(self, theta: Vector, n_std: float, little: float) -> Iterator[tuple[str, Vector]]:
        """Yield the estimate (d,)."""
        yield "estimate", theta


class DataSupport:
    """Support of parameters by the newest samples: identifiability, and fit to the newest sample."""

    def __init__(
        self,
        rows: Callable[[Vector, Sequence[Sample]], Vector],
        space: ParameterSpace,
        n_channels: int,
        length: int,
        slopes: Callable[[Vector, Sequence[Sample]], Vector | None] = lambda theta, samples: None,
    ) -> None:
        """rows: whitened residuals (..., n, c) of candidates (..., d) at n samples; length: number of samples kept;
        slopes: (n, c, d) of one candidate in the unit cube, None where only differences are to be had."""
        self._slopes, self._rows, self._space, self.n_channels = slopes, rows, space, n_channels
        self._samples: deque[Sample] = deque(maxlen=length)
        self._newest: tuple[bytes, Information] | None = None  # theta of the last information, and that

    def append(self, sample: Sample) -> None:
        """Append a sample, dropping the oldest where there are too many."""
        self._samples.append(sample)
        self._newest = None

    def snapshot(self) -> tuple[Sample, ...]:
        """Return the samples kept now."""
        return tuple(self._samples)

    def restore(self, snapshot: tuple[Sample, ...]) -> None:
        """Replace the samples by those of a snapshot."""
        self._samples = deque(snapshot, maxlen=self._samples.maxlen)
        self._newest = None

    def cost(self, theta: Vector) -> float:
        """Return the sum of squared residuals of theta (d,) at the newest sample; 0 before there is one."""
        if not self._samples:
            return 0.0
        r = self._rows(theta, [self._samples[-1]])[0]
        return float(r @ r)

    def residuals(self, theta: Vector) -> Vector:
        """Return the whitened residuals (n, c) of theta (d,) at the samples kept, from old to new."""
        return self._rows(theta, [*self._samples]) if self._samples else np.empty((0, self.n_channels))

    def information(self, theta: Vector) -> Information:
        """Return the information that the samples have at theta (d,), by the model's slopes or central differences."""
        if self._newest is None or self._newest[0] != theta.tobytes():
            self._newest = theta.tobytes(), self._information(theta)
        return self._newest[1]

    def _information(self, theta: Vector) -> Information:
        slopes = self._slopes(theta, [*self._samples])
        if slopes is not None:
            return information(slopes.reshape(-1, len(theta)))
        z = self._space.to_unit(theta)
        steps = np.full(len(z), _STEP)
        over_window = OfMany(lambda z: self._over_window(self._space.from_unit(z)))
        jacobian = central_differences(over_window, z, steps, 0.0, 1.0)
        return information(jacobian[np.isfinite(jacobian).all(axis=1)])

    def identifiable_part(
        self, theta: Vector, held: Vector, at: Vector, unseen: float, little: float, known: Information | None = None
    ) -> tuple[Vector, tuple[Reason, ...]]:
        """Return the candidate (d,) without moves in directions that the data do not identify, and the reasons.

        held (d,): start of the move; at (d,): where the information is taken; unseen: standard deviation beyond which
        a direction is not identified, and little: largest move that is ignored, both in the unit cube; known: what is
        known from more samples than those kept, or None. Without samples nothing is identified.
        """
        here = self._space.to_unit(held)
        change = self._space.to_unit(theta) - here
        seen = self.information(at) if known is None else known
        hidden = seen.directions[seen.singular_values < 1.0 / unseen]
        part = hidden.T @ (hidden @ change)
        size = float(np.linalg.norm(part))
        if size <= little:
            return theta, ()
        reason = f"the data do not identify {len(hidden)} of {len(here)} directions; a move of {size:.2g} is left out"
        return self._space.from_unit(np.clip(here + change - part, 0.0, 1.0)), (("hold", reason),)

    def plausible_parameters(self, theta: Vector, n_std: float, little: float) -> Iterator[tuple[str, Vector]]:
        """Yield the estimate (d,), and both ends of n_std standard deviations in its least certain direction."""
        yield "estimate", theta
        seen = self.information(theta)
        distance = min(n_std / max(float(seen.singular_values[-1]), 1e-12), _WIDEST)
        if distance > little:
            for sign, name in ((1.0, "+"), (-1.0, "-")):
                z = self._space.to_unit(theta) + sign * distance * seen.directions[-1]
                yield f"estimate {name} {n_std:g} std", self._space.from_unit(np.clip(z, 0.0, 1.0))

    def _over_window(self, theta: Vector) -> Vector:
        """Return the residuals (..., n c) of candidates (..., d) at all samples."""
        rows = self._rows(theta, [*self._samples])
        return rows.reshape(*theta.shape[:-1], -1)
