"""Residuals in standard deviations of their true size, less what is known to act on the plant.

That is a disturbance, late or limited inputs and friction; channels that rest have none. A sample without all that is
corrected.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import is_
from typing import Any, ClassVar, Final

import numpy as np

from ..differences import OfMany
from ..effects.known_effects import KnownEffects
from ..effects.lag_search import RowsWith
from ..samples import DerivativeResidual, Sample, Samples
from ..space import Vector
from .settings import LONG
from .state import DiagnosisState

_LONGER: Final = 1.5
"""Ratio of the longest to the shortest interval between samples from which on some are missing."""


class StandardisedResiduals:
    """Residuals of samples by what the state knows of their size, and of effects on the plant beside its model.

    0 for a channel that rests or was not sampled.
    """

    made_anew: ClassVar = ("_basis", "_corrected", "_of_basis", "_known_rows")
    """Attributes that are in no checkpoint."""

    def __init__(self, declared: DerivativeResidual, state: DiagnosisState) -> None:
        """declared: residual (c,) in standard deviations of the declared noise."""
        self.declared, self._state = declared, state
        self.space = declared.space
        self.sigma = np.array(declared.noise)
        """Declared noise (c,)."""
        self._basis: tuple[Any, ...] = ()  # of the newest samples that are corrected
        self._corrected = Samples()  # these, all of them
        self._of_basis: dict[int, Samples] = {}  # the newest of them, by their number
        self._known_rows: dict[
            tuple[tuple[int, ...], bytes], Vector
        ] = {}  # declared residuals at the most of them asked for, by candidates

    @property
    def known(self) -> KnownEffects:
        """Known effects on the plant beside its model."""
        state = self._state
        return KnownEffects(state.offset * self.sigma, state.inputs.arriving, state.friction, state.is_resting)

    @property
    def _is_correcting(self) -> bool:
        state = self._state
        is_known = state.inputs.lag or state.friction or np.count_nonzero(state.offset)
        return bool(is_known or np.count_nonzero(state.is_resting))

    def corrected(self, sample: Sample) -> Sample:
        """Return the sample less what is known to act on the plant, and without the channels that rest."""
        return self.known.without(sample) if self._is_correcting else sample

    def scaled(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (c,) of a corrected sample in standard deviations of its true size."""
        return self.declared(theta, sample) / self._state.scale.effective

    def innovation(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (c,) of a corrected sample as one value is judged: correlation makes it no larger."""
        return self.declared(theta, sample) / self._state.scale.values

    def scaled_rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return the residuals (..., n, c) of candidates theta (..., d) at n corrected samples, as `scaled` does."""
        return self.declared.rows(theta, samples) / self._state.scale.effective

    def scaled_slopes(self, theta: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the slopes (n, c, d) of `scaled_rows` at theta (d,) in the unit cube; None where there are none."""
        declared = self.declared.slope_rows(theta, samples)
        return None if declared is None else declared / self._state.scale.effective[:, None]

    def rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return the residuals (..., n, c) of candidates theta (..., d) at n samples, corrected here."""
        return self.scaled_rows(theta, self.known.without_all(samples))

    def by_inputs(self, theta: Vector, samples: Sequence[Sample], offset: Vector) -> RowsWith:
        """Return the residuals (k, n, c) of theta (d,) at n samples as a function of what arrives, inputs (k, n, p).

        offset (c,): known disturbance, in standard deviations of the declared noise. No lag is known.
        """
        friction = self._state.friction
        known = replace(self.known, disturbance=offset * self.sigma, arriving={})
        corrected = known.without_all(samples)
        lost = np.array([friction.without(replace(s, u=(0.0,) * len(s.u))).u for s in samples]) if friction else 0.0

        def rows_with(inputs: Vector) -> Vector:
            return self.declared.rows_with(inputs + lost, theta, corrected) / self._state.scale.effective

        return rows_with

    def with_inputs(self, inputs: Vector, samples: Sequence[Sample], offset: Vector) -> OfMany:
        """Return the residuals (..., n, c) at n samples as a function of places (..., d), inputs (n, p) arriving.

        offset (c,): known disturbance, in standard deviations of the declared noise.
        """
        arriving = dict(zip((sample.t for sample in samples), map(tuple, inputs.tolist()), strict=True))
        known = replace(self.known, disturbance=offset * self.sigma, arriving=arriving)
        corrected = known.without_all(samples)
        return OfMany(lambda z: self.scaled_rows(self.space.beyond(z), corrected))

    def slopes(self, theta: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the slopes (n, c, d) of `rows` at theta (d,) in the unit cube; None where the model has none."""
        return self.scaled_slopes(theta, [self.corrected(sample) for sample in samples])

    def of_newest(self, theta: Vector, n: int) -> Vector:
        """Return the residuals (..., n, c) of theta (..., d) at the newest n samples, from old to new."""
        samples, of = self._newest(n), (theta.shape, theta.tobytes())
        known = self._known_rows.get(of)
        if known is None or known.shape[-2] < len(samples):
            compared = samples if n < LONG else self._corrected  # of many all, as more of them may be asked for next
            known = self._known_rows[of] = self.declared.rows(theta, compared)
        return known[..., known.shape[-2] - len(samples) :, :] / self._state.scale.effective

    def at_newest(self, n: int) -> OfMany:
        """Return the residuals (..., n, c) at the newest n samples as a function of places (..., d)."""
        samples = self._newest(n)
        return OfMany(lambda z: self.scaled_rows(self.space.beyond(z), samples))

    def times_of_newest(self, n: int) -> Vector | None:
        """Return the times (n,) of the newest n samples in sample intervals; None where none between them is missing.

        Older samples of a long suspicion are thinned out.
        """
        t = np.array([sample.t for sample in self._state.samples[-n:]])
        gaps = np.diff(t)
        if n < 3 or gaps.max() < _LONGER * gaps.min():
            return None
        return (t - t[0]) / gaps.min()

    def _newest(self, n: int) -> Samples:
        """Return the newest n samples, corrected, always the same ones while nothing new is known."""
        state = self._state
        inputs = state.inputs
        basis = state.samples[-1], inputs.lag, inputs.arriving, state.friction, state.offset, state.is_resting
        if not (self._basis and all(map(is_, basis, self._basis))):
            self._basis, self._of_basis, self._known_rows = basis, {}, {}
            self._corrected = self.known.without_all(state.samples)
        if n not in self._of_basis:
            self._of_basis[n] = self._corrected.newest(n)
        return self._of_basis[n]
