"""Comparison of friction with the other hypotheses: it must explain what neither a disturbance nor parameters do.

It has one value for each term.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from ..differences import OfMany
from ..effects.friction import NO_FRICTION, FoundFriction, Friction, find_friction
from ..effects.known_effects import Explanation
from ..hypotheses import MARGIN, Fit, changed_parameters, disturbance_of, plain_fit
from ..samples import Sample, Samples
from ..space import Vector
from .evidence import Evidence
from .jump import jump_to
from .settings import BETTER, QUIET
from .standardised_residuals import StandardisedResiduals
from .state import DiagnosisState

_ENOUGH: Final = 12
"""Least number of samples that show friction."""


class FrictionComparison:
    """Search for the friction that explains samples, and for its end."""

    def __init__(self, state: DiagnosisState, residuals: StandardisedResiduals, evidence: Evidence) -> None:
        self._state, self._residuals, self._evidence = state, residuals, evidence

    def since_lasting(self, reference: Vector) -> Explanation | None:
        """Return the friction that explains the samples since the parameters that lasted were contradicted; or None.

        With these or with the reference (d,), where neither a smooth disturbance nor constant parameters explain them.
        """
        state, samples = self._state, self._state.every_since_lasting
        bases = [reference] if state.lasting is None else [state.lasting, reference]
        for theta in {theta.tobytes(): theta for theta in bases}.values():
            found = self._best(theta, samples)
            self._evidence.note(len(samples), friction=found.fit)
            if found.friction and not self._is_plain(theta, samples, found.fit):
                return Explanation(found, theta, found.constant * state.scale.effective, len(samples))
        return None

    def take_again(self, held: Vector) -> bool:
        """Take better values of known friction, where with them nothing contradicts parameters (d,) any more."""
        state = self._state
        found = self._best(held, state.every_since_lasting) if state.friction else NO_FRICTION
        if not found.friction or np.any(found.constant):
            return False
        before, state.friction = state.friction, found.friction
        if plain_fit(self._residuals.of_newest(held, 1), 0).is_explained:
            return True
        state.friction = before
        return False

    def take_beside(self, reference: Vector) -> bool:
        """Take another size or form of known friction where changed parameters explain the samples with it.

        Friction in the units of an input, say, changes with the mass where it was taken for one in those of a
        derivative. The parameters are then found behind it.
        """
        state, samples = self._state, self._state.every_since_lasting
        if not state.friction:
            return False
        changed = self._beside(reference, samples)
        found = NO_FRICTION if changed is None else self._best(changed, samples)
        if not found.friction or np.any(found.constant) or found.friction.is_like(state.friction):
            return False
        state.friction = found.friction
        return True

    def doubt(self, theta: Vector) -> None:
        """Forget known friction where the samples are explained as well without it, with parameters theta (d,)."""
        state, samples = self._state, self._state.every_since_lasting
        if not state.friction or not samples:
            return
        without = self._frictionless(theta, samples)
        if np.sum(self._residuals.rows(theta, samples) ** 2) > BETTER * np.sum(without**2):
            state.friction = Friction()

    def end(self, theta: Vector, n: int) -> bool:
        """Forget known friction where parameters theta (d,) explain the newest n samples without it; return whether."""
        state = self._state
        if not state.friction or n < QUIET:
            return False
        if not plain_fit(self._frictionless(theta, state.samples[-n:]), 0).is_explained:
            return False
        state.friction = Friction()
        return True

    def _frictionless(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return the residuals (n, c) of theta (d,) at n samples less what is known, friction aside."""
        known = replace(self._residuals.known, friction=Friction())
        return self._residuals.scaled_rows(theta, known.without_all(samples))

    def _beside(self, reference: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the parameters (d,) that samples determine beside known friction of any size; or None."""
        raw, space = self._raw(samples), self._residuals.space
        if len(raw) < _ENOUGH:
            return None
        basis = np.linalg.qr(self._state.friction.laws_at(raw))[0]

        def left(z: Vector) -> Vector:
            rows = self._residuals.scaled_rows(space.beyond(z), raw)
            return rows - basis @ (basis.T @ rows)

        found = jump_to(lambda _: OfMany(left), [len(raw)], space.to_unit(reference), space)
        return found.theta if found is not None and all(found.is_identifiable) else None

    def _best(self, theta: Vector, samples: Sequence[Sample]) -> FoundFriction:
        """Return the friction that explains samples, enough of them, with parameters theta (d,)."""
        raw = self._raw(samples)
        if len(raw) < _ENOUGH:
            return NO_FRICTION
        return find_friction(partial(self._residuals.scaled_rows, theta), raw, self._residuals.declared.channels)

    def _raw(self, samples: Sequence[Sample]) -> Samples:
        """Return samples with the inputs that arrive, no friction or disturbance known, and all channels."""
        state, known = self._state, replace(self._residuals.known.on_all_channels(), friction=Friction())
        return known.without_all([s for s in samples if not state.inputs.lag or s.t >= state.inputs.begin])

    def _is_plain(self, theta: Vector, samples: Sequence[Sample], friction: Fit) -> bool:
        """Return whether a smooth disturbance, or other parameters than theta (d,), explain samples as well."""
        raw, space = self._raw(samples), self._residuals.space
        disturbance = disturbance_of(self._residuals.scaled_rows(theta, raw)).fit
        if disturbance.is_explained or friction.score + MARGIN > disturbance.score:
            return True
        at = OfMany(lambda z: self._residuals.scaled_rows(space.beyond(z), raw))
        return changed_parameters(at, space.to_unit(theta), may_drift=False).fit.is_explained
