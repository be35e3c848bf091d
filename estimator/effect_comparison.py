"""Comparison of late inputs and friction with the other hypotheses: what a model lacks is no changed parameter.

A lag has one value, and what arrives first where that is not known; friction has one for each term. They must explain
samples that no disturbance, constant or changing smoothly, explains; friction, those that no parameters explain, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import Any, Final

import numpy as np

from .comparison import QUIET, HypothesisComparison
from .diagnosis_settings import BETTER
from .differences import OfMany
from .friction import NO_FRICTION, FoundFriction, Friction, find_friction
from .hypotheses import MARGIN, Fit, changed_parameters, disturbance_of, plain_fit
from .input_lag import NO_LAG, FoundLag
from .jump import jump_to
from .samples import Sample, Samples
from .space import Vector

LONG: Final = 6
"""Least number of samples since the onset on which parameters, or a lag, are accepted."""
_EARLIEST: Final = 16
"""Least number of samples since the parameters that lasted were contradicted, in which an effect is sought again."""
_ENOUGH: Final = 12
"""Least number of samples that show friction."""


@dataclass(frozen=True)
class Explanation:
    """Effect on the plant that its model lacks, and that explains samples with parameters and a disturbance."""

    found: FoundLag | FoundFriction
    theta: Vector
    """Parameters (d,) with which it does."""
    offset: Vector
    """Disturbance (c,) with which it does, in standard deviations of the declared noise."""
    n: int
    """Number of samples."""

    @property
    def fit(self) -> Fit:
        """Fit to the samples."""
        return self.found.fit


class EffectComparison(HypothesisComparison):
    """Comparison that knows late inputs and friction."""

    def _is_due(self) -> bool:
        """Return whether a lag is to be sought: half as many restless samples after the last time."""
        return self._state.n_samples >= self._state.next_lag

    def _friction_summary(self) -> list[dict[str, Any]]:
        """Return the known friction as JSON values."""
        state = self._state
        n_inputs = len(state.samples[-1].u) if state.samples else 0
        inputs = self._inputs or [f"input {j}" for j in range(n_inputs)]
        return state.friction.summary(self._names, self.residuals.declared.channels, inputs)

    def _is_effect_due(self) -> bool:
        """Return whether an effect is to be sought in the samples since the parameters that lasted were contradicted.

        That is after 16 samples, and then each time after half as many more.
        """
        state = self._state
        n = state.n_samples - state.lasting_at
        if n < _EARLIEST or state.n_samples < state.next_effect:
            return False
        state.next_effect = state.n_samples + n // 2
        return True

    def _late_inputs(self, reference: Vector, n: int) -> Explanation | None:
        """Return the lag that explains all samples since it last was quiet, or the newest n; None without one."""
        state = self._state
        restless = state.n_samples - state.restless_since
        state.next_lag = state.n_samples + max(n // 2, restless // 2)
        longest = min(restless + 1, len(state.samples))
        found = (self._late_in(state.samples[-m:], reference) for m in dict.fromkeys((max(longest, n), n)))
        return next((late for late in found if late is not None), None)

    def _late_long(self, reference: Vector) -> Explanation | None:
        """Return the lag that explains the samples since other parameters than the reference were tried, or None.

        A drift of parameters and a smooth disturbance explain the newest samples of a lag as well.
        """
        samples = [s for s in self._state.since_lasting if s.t >= self._state.inputs.begin]
        return self._late_in(samples, reference, is_long=True) if len(samples) >= LONG else None

    def _late_in(self, samples: Sequence[Sample], reference: Vector, *, is_long: bool = False) -> Explanation | None:
        """Return the lag that explains samples which no disturbance explains, or as well if these are many; or None.

        With the reference (d,), with the parameters that lasted, or with these and no disturbance known.
        """
        state, n = self._state, len(samples)
        disturbance = disturbance_of(self.residuals.rows(reference, samples)).fit
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
                return Explanation(found, theta, offset, n)
        return None

    def _is_lag_again(self, held: Vector) -> bool:
        """Take a better value of a lag that is known, where with it nothing contradicts parameters (d,) any more."""
        state = self._state
        samples = [sample for sample in state.samples if sample.t >= state.inputs.begin] if state.inputs.lag else []
        lag = self._lag(held, samples, state.offset) if len(samples) >= QUIET else NO_LAG
        if not lag.lag or not lag.fit.is_explained:
            return False
        state.inputs.adopt(lag)
        return True

    def _is_friction_again(self, held: Vector) -> bool:
        """Take better values of known friction, where with them nothing contradicts parameters (d,) any more."""
        state = self._state
        found = self._friction(held, state.every_since_lasting) if state.friction else NO_FRICTION
        if not found.friction or np.any(found.constant):
            return False
        before, state.friction = state.friction, found.friction
        if plain_fit(self.residuals.of_newest(held, 1), 0).is_explained:
            return True
        state.friction = before
        return False

    def _doubt_friction(self, theta: Vector) -> None:
        """Forget known friction where the samples are explained as well without it, with parameters theta (d,)."""
        state, samples = self._state, self._state.every_since_lasting
        if not state.friction or not samples:
            return
        without = self.residuals.scaled_rows(theta, self._frictionless(samples))
        if np.sum(self.residuals.rows(theta, samples) ** 2) > BETTER * np.sum(without**2):
            state.friction = Friction()

    def _is_friction_over(self, theta: Vector, n: int) -> bool:
        """Forget known friction where parameters theta (d,) explain the newest n samples without it; return whether."""
        state = self._state
        if not state.friction or n < QUIET:
            return False
        if not plain_fit(self.residuals.scaled_rows(theta, self._frictionless(state.samples[-n:])), 0).is_explained:
            return False
        state.friction = Friction()
        return True

    def _frictionless(self, samples: Sequence[Sample]) -> list[Sample]:
        """Return samples less what is known to act on the plant, friction aside."""
        known = replace(self.residuals.known, friction=Friction())
        return [known.without(sample) for sample in samples]

    def _lag(self, theta: Vector, samples: Sequence[Sample], offset: Vector) -> FoundLag:
        """Return the lag of the inputs, or none, that explains samples with parameters (d,).

        offset (c,): known disturbance, in standard deviations of the declared noise.
        """
        history, friction = self._state.inputs, self._state.friction
        if samples[0].t < history.begin:
            return NO_LAG
        known = replace(self.residuals.known, disturbance=offset * self.residuals.sigma, arriving={})
        corrected = Samples(known.without(sample) for sample in samples)
        lost = np.array([friction.without(replace(s, u=(0.0,) * len(s.u))).u for s in samples]) if friction else 0.0

        def rows_with(inputs: Vector) -> Vector:
            return self.residuals.scaled_rows_with(inputs + lost, theta, corrected)

        return history.search(rows_with, [sample.t for sample in samples])

    def _lacking(self, reference: Vector) -> Explanation | None:
        """Return the lag or the friction that explains the samples since the parameters that lasted, or None."""
        late = self._late_long(reference)
        return self._friction_long(reference) if late is None else late

    def _friction_long(self, reference: Vector) -> Explanation | None:
        """Return the friction that explains the samples since the parameters that lasted were contradicted; or None.

        With these or with the reference (d,), where neither a smooth disturbance nor constant parameters explain them.
        """
        state, samples = self._state, self._state.every_since_lasting
        bases = [reference] if state.lasting is None else [state.lasting, reference]
        for theta in {theta.tobytes(): theta for theta in bases}.values():
            found = self._friction(theta, samples)
            self.evidence.note(len(samples), friction=found.fit)
            if found.friction and not self._is_plain(theta, samples, found.fit):
                return Explanation(found, theta, found.constant * state.scale.effective, len(samples))
        return None

    def _take_friction_beside(self, reference: Vector) -> bool:
        """Take another size or form of known friction where changed parameters explain the samples with it.

        Friction in the units of an input, say, changes with the mass where it was taken for one in those of a
        derivative. The parameters are then found behind it.
        """
        state, samples = self._state, self._state.every_since_lasting
        if not state.friction:
            return False
        changed = self._beside_friction(reference, samples)
        found = NO_FRICTION if changed is None else self._friction(changed, samples)
        if not found.friction or np.any(found.constant) or found.friction.is_like(state.friction):
            return False
        state.friction = found.friction
        return True

    def _beside_friction(self, reference: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the parameters (d,) that samples determine beside known friction of any size; or None."""
        raw, space = self._raw(samples), self._space
        if len(raw) < _ENOUGH:
            return None
        basis = np.linalg.qr(self._state.friction.laws_at(raw))[0]

        def left(z: Vector) -> Vector:
            rows = self.residuals.scaled_rows(space.beyond(z), raw)
            return rows - basis @ (basis.T @ rows)

        found = jump_to(lambda _: OfMany(left), [len(raw)], space.to_unit(reference), space)
        return found.theta if found is not None and all(found.is_identifiable) else None

    def _friction(self, theta: Vector, samples: Sequence[Sample]) -> FoundFriction:
        """Return the friction that explains samples, enough of them, with parameters theta (d,)."""
        raw = self._raw(samples)
        if len(raw) < _ENOUGH:
            return NO_FRICTION
        return find_friction(partial(self.residuals.scaled_rows, theta), raw, self.residuals.declared.channels)

    def _raw(self, samples: Sequence[Sample]) -> Samples:
        """Return samples with the inputs that arrive, no friction or disturbance known, and all channels."""
        state, none = self._state, np.zeros(len(self._names))
        known = replace(self.residuals.known, disturbance=none, friction=Friction(), is_resting=none.astype(bool))
        return Samples(known.without(s) for s in samples if not state.inputs.lag or s.t >= state.inputs.begin)

    def _is_plain(self, theta: Vector, samples: Sequence[Sample], friction: Fit) -> bool:
        """Return whether a smooth disturbance, or other parameters than theta (d,), explain samples as well."""
        raw = self._raw(samples)
        disturbance = disturbance_of(self.residuals.scaled_rows(theta, raw)).fit
        if disturbance.is_explained or friction.score + MARGIN > disturbance.score:
            return True
        at = OfMany(lambda z: self.residuals.scaled_rows(self._space.beyond(z), raw))
        return changed_parameters(at, self._space.to_unit(theta), may_drift=False).fit.is_explained
