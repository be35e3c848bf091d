"""Comparison of late inputs with the other hypotheses: actuators that follow late are no changed parameters.

A lag has one value, and what arrives first where that is not known. It must explain samples that no disturbance,
constant or changing smoothly, explains.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final

import numpy as np

from .comparison import QUIET, HypothesisComparison
from .hypotheses import MARGIN, disturbance_of
from .input_lag import NO_LAG, FoundLag, Inputs
from .samples import Sample
from .space import Vector

LONG: Final = 6
"""Least number of samples since the onset on which parameters, or a lag, are accepted."""


@dataclass(frozen=True)
class LateInputs:
    """Lag that explains samples, with parameters and a disturbance."""

    found: FoundLag
    theta: Vector
    """Parameters (d,) with which it does."""
    offset: Vector
    """Disturbance (c,) with which it does, in standard deviations of the declared noise."""
    n: int
    """Number of samples."""


class LagComparison(HypothesisComparison):
    """Comparison that knows late inputs."""

    def _is_due(self) -> bool:
        """Return whether a lag is to be sought: half as many restless samples after the last time."""
        return self._state.n_samples >= self._state.next_lag

    def _late_inputs(self, reference: Vector, n: int) -> LateInputs | None:
        """Return the lag that explains all samples since it last was quiet, or the newest n; None without one."""
        state = self._state
        restless = state.n_samples - state.restless_since
        state.next_lag = state.n_samples + max(n // 2, restless // 2)
        longest = min(restless + 1, len(state.samples))
        found = (self._late_in(state.samples[-m:], reference) for m in dict.fromkeys((max(longest, n), n)))
        return next((late for late in found if late is not None), None)

    def _late_long(self, reference: Vector) -> LateInputs | None:
        """Return the lag that explains the samples since other parameters than the reference were tried, or None.

        A drift of parameters and a smooth disturbance explain the newest samples of a lag as well.
        """
        samples = [s for s in self._state.since_lasting if s.t >= self._state.inputs.begin]
        return self._late_in(samples, reference, is_long=True) if len(samples) >= LONG else None

    def _late_in(self, samples: Sequence[Sample], reference: Vector, *, is_long: bool = False) -> LateInputs | None:
        """Return the lag that explains samples which no disturbance explains, or as well if these are many; or None.

        With the reference (d,), with the parameters that lasted, or with these and no disturbance known.
        """
        state, n = self._state, len(samples)
        disturbance = disturbance_of(self.rows(reference, samples)).fit
        is_over = disturbance.is_explained and not is_long  # then, a known lag at most
        if is_over and not state.inputs.lag:
            return None
        lasting = reference if state.lasting is None else state.lasting
        none = np.zeros(len(self._names))
        bases = [(reference, state.offset), (lasting, state.offset), (lasting, none)]
        for theta, offset in {(theta.tobytes(), offset.tobytes()): (theta, offset) for theta, offset in bases}.values():
            found = self._lag(theta, samples, offset)
            self.evidence.note(n, lag=found.fit)
            if not (found.lag or state.inputs.lag):  # no lag, before or now
                continue
            margin = MARGIN if not is_over else inf if found.lag else 0.0
            if found.fit.is_explained and found.fit.score + margin <= disturbance.score:
                return LateInputs(found, theta, offset, n)
        return None

    def _is_lag_again(self, held: Vector) -> bool:
        """Take a better value of a lag that is known, where with it nothing contradicts parameters (d,) any more."""
        state = self._state
        samples = [sample for sample in state.samples if sample.t >= state.inputs.begin]
        lag = self._lag(held, samples, state.offset) if len(samples) >= QUIET else NO_LAG
        if not lag.lag or not lag.fit.is_explained:
            return False
        state.inputs.adopt(lag)
        return True

    def _lag(self, theta: Vector, samples: Sequence[Sample], offset: Vector) -> FoundLag:
        """Return the lag of the inputs, or none, that explains samples with parameters (d,).

        offset (c,): known disturbance, in standard deviations of the declared noise.
        """
        history = self._state.inputs
        if samples[0].t < history.begin:
            return NO_LAG
        corrected = [self._without(sample, {}, offset) for sample in samples]

        def rows_with(arriving: Inputs) -> Vector:
            return self.scaled_rows(theta, [replace(s, u=arriving.get(s.t, s.u)) for s in corrected])

        return history.search(rows_with, samples[0].t)
