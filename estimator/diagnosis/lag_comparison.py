"""Comparison of late or limited inputs with the other hypotheses.

A lag must explain samples that no disturbance explains; it has one value, and what arrives first where that is not
known. Limits, one value each, must explain them much better than a disturbance does.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Final

import numpy as np

from ..effects.input_lag import NO_LAG, FoundLag
from ..effects.known_effects import Explanation
from ..hypotheses import MARGIN, NEVER, Fit, changed_parameters, cubic_disturbance, disturbance_of, plain_fit
from ..samples import Sample
from ..space import Vector
from .evidence import Evidence
from .settings import FEWEST, LONG, QUIET
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState

_NOISE: Final = 5.0
"""Factor by which the noise may be larger than known before limits of the inputs explain samples."""
FEWEST_BESIDE: Final = 10
"""Least number of samples that tell a lag beside changed parameters."""
_FEW_STEPS: Final = 3
"""Number of Gauss-Newton steps to changed parameters, with each lag that is tried."""


class LagComparison:
    """Search for the lag that explains samples better than a disturbance, constant or changing smoothly."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals, evidence: Evidence) -> None:
        self._state, self._residuals, self._evidence = state, residuals, evidence
        self._late: tuple[Sample, bytes, FoundLag] | None = None  # of the newest sample and a reference

    @property
    def is_due(self) -> bool:
        """True where a lag is to be sought: half as many restless samples after the last time."""
        return self._state.n_samples >= self._state.next_lag

    def in_newest(self, reference: Vector, n: int) -> Explanation | None:
        """Return the lag that explains all samples since it last was quiet, or the newest n; None without one."""
        state = self._state
        restless = state.n_samples - state.restless_since
        state.next_lag = state.n_samples + max(n // 2, restless // 2)
        longest = min(restless + 1, len(state.samples))
        found = (self._explaining(state.samples[-m:], reference) for m in dict.fromkeys((max(longest, n), n)))
        return next((late for late in found if late is not None), None)

    def at_once(self, reference: Vector, rival: Fit) -> Explanation | None:
        """Return the lag that explains three to five samples since the onset far better than a rival, or None.

        reference (d,): parameters then. Only of a filter's first samples, as `may_be_late`.
        """
        n = self._state.n_since
        found = self._late_from_start(reference) if n >= FEWEST else NO_LAG
        if not found.fit.is_explained or found.fit.score + MARGIN > rival.score:
            return None
        return Explanation(found, reference, self._state.offset, n)

    def may_be_late(self, reference: Vector, parameters: Fit) -> bool:
        """Return whether a lag may explain the few samples since the onset, nearly as well as changed parameters.

        reference (d,): parameters then. Only of a filter's first samples: they last long, and what arrived before the
        inputs that are known is not; without a filter there are six samples soon.
        """
        late = self._late_from_start(reference).fit
        return late is not NEVER and late.is_possible and late.score <= parameters.score + MARGIN

    def _late_from_start(self, reference: Vector) -> FoundLag:
        state = self._state
        if not state.inputs.means or not state.n_since < LONG:
            return NO_LAG
        newest, theta = state.samples[-1], reference.tobytes()
        if self._late is None or self._late[0] is not newest or self._late[1] != theta:
            samples = state.samples[-state.n_since :]
            rows_with = self._residuals.by_inputs(reference, samples, state.offset)
            self._late = newest, theta, state.inputs.late_from_start(rows_with, [sample.t for sample in samples])
        return self._late[2]

    def since_lasting(self, reference: Vector) -> Explanation | None:
        """Return the lag that explains the samples since other parameters than the reference were tried, or None.

        A drift of parameters and a smooth disturbance explain the newest samples of a lag as well.
        """
        samples = [s for s in self._state.since_lasting if s.t >= self._state.inputs.begin]
        return self._explaining(samples, reference, is_long=True) if len(samples) >= LONG else None

    def beside_change(self, theta: Vector, *, is_early: bool) -> Explanation | None:
        """Return the lag that explains the samples since the onset together with changed parameters, or None.

        Where no disturbance does so nearly as well. theta (d,): parameters before; is_early: few samples tell no lag,
        but limited rates that the inputs have not passed before.
        """
        state, residuals = self._state, self._residuals
        if state.inputs.lag.limits:
            return None
        samples = state.samples[-state.n_since :]
        z, offset = residuals.space.to_unit(theta), state.offset

        def changed(inputs: Vector) -> Vector:
            at = residuals.with_inputs(inputs, samples, offset)
            return changed_parameters(at, z, iterations=_FEW_STEPS, may_drift=False).rows

        found = state.inputs.late(lambda inputs: np.array([*map(changed, inputs)]), [sample.t for sample in samples])
        if not found.lag or (is_early and not (found.lag.rates and state.inputs.were_slower(found.lag, samples[0].t))):
            return None
        fit = replace(found.fit, n_free=found.fit.n_free + len(z))
        self._evidence.note(len(samples), lag=fit)
        if not fit.is_explained or fit.score + MARGIN > disturbance_of(residuals.rows(theta, samples)).fit.score:
            return None
        return Explanation(replace(found, fit=fit), theta, offset, len(samples))

    def take_again(self, held: Vector) -> bool:
        """Take a better value of a lag that is known, where with it nothing contradicts parameters (d,) any more."""
        state = self._state
        samples = [sample for sample in state.samples if sample.t >= state.inputs.begin] if state.inputs.lag else []
        lag = self._best(held, samples, state.offset) if len(samples) >= QUIET else NO_LAG
        if not lag.lag or not lag.fit.is_explained:
            return False
        state.inputs.adopt(lag)
        return True

    def stuck_or_free(self, reference: Vector) -> Fit:
        """Return the fit to the samples since the onset of inputs being stuck, or arriving again, if that is known.

        reference (d,): parameters then.
        """
        samples = self._state.samples[-self._state.n_since :]
        rows_with = self._residuals.by_inputs(reference, samples, self._state.offset)
        return self._state.inputs.stuck_or_free(rows_with, [sample.t for sample in samples])

    def explains_more(self, stuck_or_free: Fit, reference: Vector, n: int) -> bool:
        """Return whether that explains all samples since the onset, more than n: changed parameters follow it.

        Inputs that arrive again need not explain more.
        """
        n_since = self._state.n_since
        if not self._state.inputs.lag.limits and (n == n_since or n_since < FEWEST):
            return False
        nothing = plain_fit(self._residuals.of_newest(reference, n_since), 0)
        return stuck_or_free.is_explained and stuck_or_free.score + MARGIN <= nothing.score

    def _explaining(self, samples: Sequence[Sample], reference: Vector, *, is_long: bool = False) -> Explanation | None:
        """Return the lag that explains samples which no disturbance explains, or as well if these are many; or None.

        With the reference (d,), with the parameters that lasted, or with these and no disturbance known.
        """
        state, n = self._state, len(samples)
        disturbance = disturbance_of(self._residuals.rows(reference, samples)).fit
        is_over = disturbance.is_explained and not is_long  # then, no other lag than a known one, but perhaps a limit
        lasting = reference if state.lasting is None else state.lasting
        bases = [(reference, state.offset), (lasting, state.offset), (lasting, np.zeros_like(state.offset))]
        for theta, offset in {(theta.tobytes(), offset.tobytes()): (theta, offset) for theta, offset in bases}.values():
            found = self._best(theta, samples, offset, is_late=bool(state.inputs.lag) or not is_over)
            self._evidence.note(n, lag=found.fit)
            if not (found.lag or state.inputs.lag):  # no lag, before or now
                continue
            margin = MARGIN if found.lag.limits or not is_over else inf if found.lag else 0.0
            if found.lag.limits and not state.inputs.lag and not self._is_certain(found, theta, samples):
                continue
            if found.fit.is_explained and found.fit.score + margin <= disturbance.score:
                return Explanation(found, theta, offset, n)
        return None

    def _is_certain(self, limits: FoundLag, theta: Vector, samples: Sequence[Sample]) -> bool:
        """Return whether limits explain samples with parameters theta (d,) far better than noise or a disturbance.

        Noise that is correlated from sample to sample, and a slow disturbance, look like anything for a few samples.
        The onset of a gust, against which the controller acts, is a cubic. Limits that inputs have passed before, when
        these arrived, must be new, and better by twice the margin.
        """
        rows = self._residuals.rows(theta, samples)
        if plain_fit(rows / _NOISE, 0).is_explained or limits.fit.score + MARGIN > cubic_disturbance(rows).score:
            return False
        are_old = self._state.inputs.were_within(limits.lag, samples[0].t)
        return limits.fit.score + (MARGIN if are_old else 2.0 * MARGIN) <= disturbance_of(rows).fit.score

    def _best(self, theta: Vector, samples: Sequence[Sample], offset: Vector, *, is_late: bool = True) -> FoundLag:
        """Return the lag of the inputs, or none, that explains samples with parameters (d,).

        offset (c,): known disturbance, in standard deviations of the declared noise. is_late: false for limits only.
        """
        history = self._state.inputs
        if samples[0].t < history.begin:
            return NO_LAG
        rows_with = self._residuals.by_inputs(theta, samples, offset)
        return history.search(rows_with, [sample.t for sample in samples], is_late=is_late)
