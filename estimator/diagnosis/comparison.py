"""Comparison of hypotheses on sampled derivatives: changed parameters, a disturbance, larger noise, or nothing.

See `hypotheses` for the evidence, and `diagnosis` for what follows from it.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..differences import OfMany, value_and_slope
from ..hypotheses import (
    LARGEST_RATE,
    MARGIN,
    NEVER,
    ChangedParameters,
    Disturbance,
    Fit,
    Weighing,
    changed_parameters,
    disturbance_of,
    mean_of,
    plain_fit,
)
from ..identifiability import information
from ..significance import FALSE_ALARM, chi2_limit
from ..space import Vector
from .evidence import Evidence
from .jump_comparison import JumpComparison
from .lag_comparison import LagComparison
from .noise_comparison import NoiseComparison
from .quiet_comparison import QuietComparison, shorter
from .residual_scale import (
    TOO_SMALL,
    larger_noise,
)
from .settings import BETTER, FEWEST, LONG, QUIET, Judgement
from .standardised_residuals import StandardisedResiduals
from .state import WINDOW, DiagnosisState
from .verdict import Verdict

_LENGTHS: Final = (5, 4, 3, 2, 1)
"""Numbers of newest samples on which the hypotheses are compared, until changed parameters explain them."""
_SPARE: Final = 8
"""Least number of values in excess of those fitted that show a known disturbance to have changed with parameters."""
_STEP: Final = 1e-6
"""Step of differences in the unit cube."""
_IN_REST: Final = 50
"""Number of samples of a rest after which changed parameters are sought, each time."""
_RENEWED: Final = 5
"""Number of samples after which a comparison that changed parameters have won is repeated."""
_DOUBTS: Final = 3
"""Number of times that samples have turned out to be doubtful from which on parameters need proof.

One sensor that fails is doubtful twice: first found to be inconsistent, and failed as it remains so. A third time the
noise is not the declared one, such as coloured noise, by which all evidence is measured.
"""


class HypothesisComparison:
    """Comparison of hypotheses on the newest samples, and the judgement of new parameters by it."""

    def __init__(
        self, state: DiagnosisState, residuals: StandardisedResiduals, evidence: Evidence, lag: LagComparison
    ) -> None:
        self._state, self._residuals, self._evidence, self._lag = state, residuals, evidence, lag
        self._space = residuals.space
        self.quiet = QuietComparison(state, residuals)
        """Comparison while no sample contradicts the parameters in force."""
        self.jumps = JumpComparison(state, residuals)
        """Comparison on the samples after a jump of the parameters."""
        self.noise = NoiseComparison(state, residuals, self.best)
        """Comparison with larger noise."""

    def judge(self, theta: Vector, held: Vector, *, is_filter: bool = False) -> Judgement:
        """Return whether parameters theta (d,) in place of those in force are warranted by the newest samples.

        is_filter: true for those of a filter, which only follows them where they have changed.
        """
        state = self._state
        if not state.n_since:
            return self.quiet.judge(theta, held, is_filter=is_filter)
        found_at = state.verdict.found_at
        is_due = state.n_samples >= found_at + (_RENEWED if state.verdict.is_warranted else 1)
        if is_due or found_at < state.n_samples - state.n_since:
            self._weigh(theta, held)
        if state.verdict.is_refuted:
            return "refuted"
        now = self._residuals.of_newest(theta, 1)
        if plain_fit(now, 0).is_explained or np.sum(now**2) < BETTER * np.sum(self._residuals.of_newest(held, 1) ** 2):
            return state.verdict.judgement
        return "refuted"

    def has_changed(self, held: Vector, n: int, *, at_most: float = inf) -> bool:
        """Return whether changed parameters explain the newest n samples, and nothing else nearly as well.

        held (d,): parameters in force, which explain them or not; at_most: largest rate at which they may have drifted.
        """
        found, before = self.best(held, n, may_drift=True), self._residuals.of_newest(held, n)
        weighing = Weighing(found.fit, disturbance_of(before).fit, plain_fit(before, 0))
        return found.rate <= at_most and weighing.are_parameters_proven

    def has_changed_slowly(self, held: Vector) -> bool:
        """Return whether `has_changed` on all newest samples, none of which contradicts those in force by itself.

        Now and then. held (d,): in force.
        """
        state = self._state
        return not state.n_samples % QUIET and self.has_changed(held, len(state.samples), at_most=LARGEST_RATE)

    def lags(self, theta: Vector) -> bool:
        """Return whether an estimate theta (d,) does not explain the newest samples, which other parameters may."""
        state = self._state
        if not state.n_since or state.verdict.is_refuted:
            return False
        return not plain_fit(self._residuals.of_newest(theta, min(state.verdict.n_explained, FEWEST)), 0).is_explained

    def has_changed_in_rest(self, held: Vector) -> bool:
        """Return whether changed parameters explain the newest hundred samples, and nothing else nearly as well.

        On all channels, while some rest; now and then: held (d,) are in force.
        """
        state = self._state
        if state.resting.n_samples % _IN_REST or not state.resting.n_samples:
            return False
        known = self._residuals.known.on_all_channels()
        samples = known.without_all(state.newest_hundred)
        at = OfMany(lambda z: self._residuals.scaled_rows(self._space.beyond(z), samples))
        z = self._space.to_unit(held)
        before = at(z)
        nothing = plain_fit(before, 0)
        if nothing.is_explained or len(samples) < 2 * WINDOW:
            return False
        parameters = changed_parameters(at, z, may_drift=False, beyond=0.0).fit
        return Weighing(parameters, disturbance_of(before).fit, nothing).are_parameters_certain

    @property
    def is_tested(self) -> bool:
        """True where the hypothesis of changed parameters has been proven, or could have been refuted."""
        return self._state.verdict.is_warranted or self._state.verdict.n_spare > 0

    def explains_newest_only(self, is_identifiable: Sequence[bool]) -> bool:
        """Return whether parameters, not proven, explain but the newest of three samples or more.

        Where it has as many values as they have, or more, and does not determine all of them, is_identifiable (d,).
        """
        state, verdict = self._state, self._state.verdict
        if verdict.judgement != "possible" or verdict.n_explained > 1 or verdict.n_spare < 0:
            return False
        return state.n_since >= FEWEST and not all(is_identifiable)

    @property
    def may_be_disturbed(self) -> bool:
        """True where a disturbance is to be thought of when parameters are written that are warranted."""
        return self._state.n_since > 0 and not self._state.verdict.is_certain

    @property
    def has_failed(self) -> bool:
        """True where changed parameters do not explain the newest samples, however few."""
        return self._state.verdict.is_refuted or self._state.verdict.n_explained < FEWEST

    def disturbance(self, held: Vector) -> Vector:
        """Return the disturbance (c,), in the derivatives' units, that may act in place of changed parameters."""
        state = self._state
        if not state.n_since:
            return state.offset * self._residuals.sigma
        reference = state.reference_or(held)
        found = disturbance_of(self._residuals.of_newest(reference, min(state.n_since, QUIET)))
        return (state.offset + found.newest * state.scale.effective) * self._residuals.sigma

    def _weigh(self, theta: Vector, held: Vector) -> None:
        """Compare the hypotheses on the newest samples since the onset, fewer of them where nothing explains more.

        No fewer than five, once none explain the samples that followed proven ones, even with ten times the noise: what
        the model lacks may look like other parameters for a few samples, again and again.
        """
        state, space = self._state, self._space
        was_proven = state.verdict.is_warranted and state.n_samples < state.verdict.found_at + state.n_since
        state.verdict = replace(state.verdict, found_at=state.n_samples, judgement="refuted")
        reference = state.reference_or(held)
        residuals = self._residuals.of_newest(theta, state.n_since)
        for n in shorter(state.n_since):
            if self._wins(plain_fit(residuals[-n:], len(space)), theta, reference, n):
                return
        z = space.to_unit(theta) if state.changed is None else state.changed
        for n in [n for n in _LENGTHS if n <= state.n_since]:
            if state.is_disproved and n < min(QUIET, state.n_since):
                return
            found = changed_parameters(self._residuals.at_newest(n), z, self._residuals.times_of_newest(n))
            if was_proven and n == min(QUIET, state.n_since) and not self.jumps.may_be_over(reference, n):
                state.is_disproved |= not plain_fit(found.rows / TOO_SMALL, 0).is_explained
            if found.rate <= LARGEST_RATE and self._wins(found.fit, space.from_unit(found.z), reference, n):
                state.changed = found.z
                return

    def _wins(self, parameters: Fit, theta: Vector, reference: Vector, n: int) -> bool:
        """Set the verdict where changed parameters, theta (d,), are possible by their fit to the newest n samples."""
        is_recorded = n == min(self._state.n_since, _LENGTHS[0])
        if not (parameters.is_possible or is_recorded):
            return False
        before = self._residuals.of_newest(reference, n)
        noise, coloured = larger_noise(before), self._state.coloured_noise(before)
        rivals = disturbance_of(before).fit, plain_fit(before, 0)
        weighing = Weighing(parameters, *rivals, noise=noise, coloured=coloured)
        inputs = self._lag.stuck_or_free(reference) if weighing.are_parameters_possible else NEVER
        if n == self._state.n_since:
            weighing = replace(weighing, inputs=inputs)
        is_possible = weighing.are_parameters_possible and not self._lag.explains_more(inputs, reference, n)
        is_possible = is_possible and not self._lag.may_be_late(reference, parameters)
        if is_possible or is_recorded:
            self._evidence.note(n, **weighing.fits)
        if is_possible:
            self._state.is_noise_known |= weighing.are_parameters_certain
            is_doubtful = weighing.may_be_coloured or self._state.n_doubts >= _DOUBTS
            needs_proof = is_doubtful or self._state.is_resting.any() or self._state.is_disturbed
            n_spare = rivals[1].n_values - parameters.n_free  # of parameters that are exact a value may be 0
            is_of_few = self._explains_few(theta, n, n_spare)
            unproven: Judgement = "refuted" if needs_proof or is_of_few else "possible"
            self._state.verdict = Verdict(
                "warranted" if weighing.are_parameters_proven else unproven,
                weighing.are_parameters_certain,
                n_spare=n_spare,
                n_explained=n,
                found_at=self._state.n_samples,
            )
        return is_possible

    def _explains_few(self, theta: Vector, n: int, n_spare: int) -> bool:
        """Return whether parameters theta (d,) that explain the newest n samples explain few of those since the onset.

        Several in a row, with n_spare values more than the parameters, but less than half of all, each by itself: what
        changes all the time, as a gust, looks like parameters for a few samples, again and again. Parameters that drift
        explain the newest half together. Not so of a filter's samples, between which they move far.
        """
        state = self._state
        if n_spare <= 0 or not 1 < n < state.n_since / 2 or state.inputs.means:
            return False
        rows = self._residuals.of_newest(theta, state.n_since)
        if sum(plain_fit(row, 0).is_explained for row in rows) >= state.n_since / 2:
            return False
        drifting = self.best(theta, (state.n_since + 1) // 2, may_drift=True)
        are_explained = all(plain_fit(row, 0).is_explained for row in drifting.rows)
        return not are_explained or drifting.rate > LARGEST_RATE

    def best(self, held: Vector, n: int, *, may_drift: bool) -> ChangedParameters:
        """Return the parameters that explain the newest n samples best, whatever the search has found."""
        changed = self._state.changed
        z = self._space.to_unit(held) if changed is None else changed
        times = self._residuals.times_of_newest(n) if may_drift else None
        return changed_parameters(self._residuals.at_newest(n), z, times, may_drift=may_drift)

    def determined(self, z: Vector) -> Vector:
        """Return the standard deviation (d,), in the unit cube, to which the samples since the onset determine z (d,).

        At most 1, as where the model has no value close by.
        """
        rows_at = self._residuals.at_newest(max(self._state.n_since, 1))
        _, slope = value_and_slope(rows_at, z, _STEP)
        return information(slope).std() if np.all(np.isfinite(slope)) else np.ones_like(z)

    def is_changing(self, held: Vector, n: int, *, may_drift: bool = True) -> bool:
        """Return whether parameters, constant ones or slowly changing, explain the newest n samples."""
        found = self.best(held, n, may_drift=may_drift)
        self._evidence.note(n, parameters=found.fit)
        return found.fit.is_explained and found.rate <= LARGEST_RATE

    def with_disturbance(self, held: Vector, n: int, channels: NDArray[np.bool_] | None = None) -> Disturbance | None:
        """Return the constant disturbance that explains the newest n samples together with changed parameters.

        channels (c,): those that it may act on; None for all.
        """
        space, acts = self._space, 1.0 if channels is None else channels

        def left(z: Vector) -> Vector:
            rows = self._residuals.of_newest(space.beyond(z), n)
            moved = rows - acts * mean_of(rows)[..., None, :]
            return moved if rows.all() else np.where(rows, moved, 0.0)

        best = changed_parameters(OfMany(left), space.to_unit(held), may_drift=False)
        rows = self._residuals.of_newest(space.beyond(best.z), n)
        mean = acts * mean_of(rows)
        n_free = int(np.count_nonzero(rows.any(axis=0) if channels is None else channels & rows.any(axis=0)))
        fit = plain_fit(best.rows, len(space) + n_free, int(np.count_nonzero(rows)))
        self._evidence.note(n, both=fit)
        return Disturbance(mean, np.abs(mean), fit, True) if fit.is_explained else None

    def changed_with_disturbance(self, held: Vector) -> Disturbance | None:
        """Return by how much a known disturbance has changed together with the parameters; None where it has not.

        What a constant force does to a derivative depends on the parameters. Nothing else may explain the samples since
        the onset nearly as well.
        """
        state, n = self._state, self._state.n_since
        both = self._with_known(held, n) if n >= LONG and n % 2 == 0 else None
        if both is None or both.fit.n_values - both.fit.n_free < _SPARE:
            return None
        parameters = self.best(held, n, may_drift=True).fit
        if parameters.is_explained:
            return None
        before = self._residuals.of_newest(state.reference_or(held), n)
        others = (parameters, disturbance_of(before).fit, plain_fit(before, 0))
        return both if both.fit.score + MARGIN <= min(fit.score for fit in others) else None

    def may_be_parameters(self, held: Vector, n: int, disturbance: Fit) -> bool:
        """Return whether changed parameters may explain the newest n samples that a disturbance explains.

        Alone, or with another size of a disturbance that was known before; the latter not after many samples.
        """
        if self.is_changing(held, n):
            return True
        both = self._with_known(held, n) if self._state.n_since < WINDOW // 2 else None
        return both is not None and both.fit.score < disturbance.score + MARGIN

    def _with_known(self, held: Vector, n: int) -> Disturbance | None:
        """Return the change of a known disturbance that explains the newest n samples with changed parameters."""
        acts = (self._state.offset != 0.0) & ~self._state.is_resting
        return self.with_disturbance(held, n, acts) if acts.any() else None

    def lacking_channels(self, rows: Vector) -> NDArray[np.bool_]:
        """Return the channels (c,) that residuals (n, c) are too large on; all that do not rest where there is none."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.nan_to_num(np.sum(rows**2, axis=0), nan=np.inf)
        lacks = squares > chi2_limit(FALSE_ALARM / rows.shape[1], len(rows))
        return lacks if lacks.any() else ~self._state.is_resting
