"""Diagnosis of samples that contradict the parameters in force: changed parameters, a disturbance, or neither.

quiet        the parameters in force explain the samples; the residuals' true size is learnt
suspicious   they do not, from an onset on; new parameters are warranted where they explain the samples since then

A suspicion ends when the parameters in force, new ones perhaps, explain the samples again; or with a search for
parameters that has found none: then either a constant disturbance explains them, and is subtracted from now on, or
nothing does, and the channels concerned rest. See `hypotheses` for the comparison.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from .contract import Estimate
from .diagnosis_settings import (
    BETTER,
    FORGOTTEN,
    MOST_NAMED,
    PATIENCE,
    DiagnosisSettings,
    Judgement,
    is_at_unseen_bound,
)
from .diagnosis_state import DiagnosisState
from .differences import OfMany
from .events import Event
from .evidence import Evidence
from .hypotheses import (
    FALSE_ALARM,
    MARGIN,
    USUAL_RATE,
    ChangedParameters,
    Disturbance,
    Fit,
    Weighing,
    changed_parameters,
    disturbance_of,
    n_channels_of,
    plain_fit,
)
from .jump import jump_to
from .residual_scale import ResidualScale, spread_of
from .samples import DerivativeResidual, Sample
from .significance import chi2_limit
from .space import ParameterSpace, Vector
from .wandering import agree

_WINDOW: Final = 20
"""Largest number of samples on which hypotheses are compared."""
_QUIET: Final = 5
"""Number of newest samples that the parameters in force must explain for a suspicion to end."""
_LONG: Final = 6
"""Least number of samples since the onset on which parameters are accepted."""
_FEWEST: Final = 3
"""Least number of samples that name a disturbance, or its end."""
_LENGTHS: Final = (5, 4, 3, 2, 1)
"""Numbers of newest samples on which the hypotheses are compared, until changed parameters explain them."""
_RATE: Final = 2.0 * USUAL_RATE
"""Largest change of a parameter from sample to sample, as a share of the scaled bounds: faster, it is none."""
_NOISY: Final = 8
"""Least number of samples since the onset that show a larger noise than the declared one."""
_LARGER: Final = 1.3
"""Factor by which it must be larger."""
_MUCH_LARGER: Final = 3.0
"""Factor where the parameters in force stay: they are not fitted, and a smaller one may be what the model lacks."""
_SPARE: Final = 10
"""Least number of explained values in excess of the fitted ones that makes good for a search in vain."""
_RENEWED: Final = 5
"""Number of samples after which a comparison that changed parameters have won is repeated."""


@dataclass(frozen=True)
class Settled:
    """End of a suspicion."""

    undo: Vector | None
    """Parameters (d,) from before the onset, to return to; None where those in force stay."""
    events: tuple[Event, ...] = ()
    ends_search: bool = False
    """True where the search for parameters is at its end, too."""


class Diagnosis:
    """Diagnosis on sampled derivatives. It owns the residuals' true size, the known disturbance and the rests."""

    def __init__(
        self,
        declared: DerivativeResidual,
        names: Sequence[str],
        sigma: Sequence[float],
        settings: DiagnosisSettings,
        space: ParameterSpace,
    ) -> None:
        """declared: residual (c,) in standard deviations of the declared noise; names, sigma (c,): of the channels,
        and that noise."""
        self._declared, self._names, self._settings = declared, tuple(names), settings
        self._sigma, self.space = np.array(sigma), space
        self.evidence = Evidence()
        c = len(self._names)
        zero = np.zeros(c, dtype=np.intp)
        self._state = DiagnosisState([], ResidualScale(c), np.zeros(c), zero, np.zeros(c, dtype=bool))

    @property
    def is_suspicious(self) -> bool:
        """True where the samples contradict the parameters in force."""
        return self._state.n_since > 0

    @property
    def is_resting(self) -> bool:
        """True where every channel rests."""
        return bool(self._state.is_resting.all())

    @property
    def n_since(self) -> int:
        """Number of samples since the onset of the suspicion, at most 20; 0 while quiet."""
        return self._state.n_since

    def snapshot(self) -> DiagnosisState:
        """Return the present state, for `restore`."""
        return self._state.copy()

    def restore(self, state: DiagnosisState) -> None:
        """Go back to a snapshot, which is used up."""
        self._state = state

    def summary(self) -> dict[str, Any]:
        """Return what is known of each channel, and the number of events of each kind, as JSON values."""
        return self._state.summary(self._names, self._sigma)

    def residual(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (c,) in standard deviations of its true size, less the known disturbance.

        It is 0 for a channel that rests or was not sampled.
        """
        return self.scaled(theta, self.corrected(sample))

    def rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return the residuals (..., n, c) of candidates theta (..., d) at n samples, each as `residual` does."""
        if self._is_correcting:
            samples = [self.corrected(sample) for sample in samples]
        return self.scaled_rows(theta, samples)

    @property
    def _is_correcting(self) -> bool:
        return bool(np.count_nonzero(self._state.offset) or np.count_nonzero(self._state.is_resting))

    def corrected(self, sample: Sample) -> Sample:
        """Return the sample less the known disturbance, and without the channels that rest."""
        if not self._is_correcting:
            return sample
        state = self._state
        xdot = np.where(state.is_resting, np.nan, np.array(sample.xdot) - state.offset * self._sigma)
        return replace(sample, xdot=tuple(xdot.tolist()))

    def scaled(self, theta: Vector, sample: Sample) -> Vector:
        """Return the residual (c,) of a corrected sample in standard deviations of its true size."""
        return self._declared(theta, sample) / self._state.scale.effective

    def scaled_rows(self, theta: Vector, samples: Sequence[Sample]) -> Vector:
        """Return the residuals (..., n, c) of candidates theta (..., d) at n samples, each as `scaled` does."""
        return self._declared.rows(theta, samples) / self._state.scale.effective

    def slopes(self, theta: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the slopes (n, c, d) of `rows` at theta (d,) in the unit cube; None where the model has none."""
        return self.scaled_slopes(theta, [self.corrected(sample) for sample in samples])

    def scaled_slopes(self, theta: Vector, samples: Sequence[Sample]) -> Vector | None:
        """Return the slopes (n, c, d) of `scaled_rows` at theta (d,) in the unit cube; None where there are none."""
        declared = self._declared.slope_rows(theta, samples)
        return None if declared is None else declared / self._state.scale.effective[:, None]

    def observe(self, sample: Sample, held: Vector) -> bool:
        """Take a sample, with the parameters in force (d,); return whether residuals are to be computed anew."""
        state = self._state
        state.n_samples += 1
        state.way = state.way.go(self.space.to_unit(held))
        has_woken = state.wake()
        declared = self._declared(held, self.corrected(sample))
        if state.is_resting.any():
            state.rested.append(self._declared(held, sample) - state.offset)
            state.resting = state.resting.take(np.where(state.is_resting, state.rested[-1], 0.0))
            if state.resting.is_outgrown:
                self.evidence.outgrown(self._names, state.resting)
                state.wake_early()
                has_woken = True
        missing = int(np.count_nonzero(state.is_resting | np.isnan(sample.xdot)))
        is_contradictory = not self._is_usual(declared / state.scale.values, len(declared) - missing)
        state.keep(sample, _WINDOW)
        if state.n_since or is_contradictory:
            if not state.n_since:
                state.reference, state.verdict, state.changed, state.has_moved = held, "refuted", None, False
                if state.lasting is None or state.n_samples >= state.suspected_at + FORGOTTEN:
                    state.lasting = held
                state.n_calm = state.n_samples - state.suspected_at - 1
                if state.n_samples >= state.suspected_at + _WINDOW:
                    state.way = state.way.begin(self.space.to_unit(held))
            state.n_since, state.n_quiet = min(state.n_since + 1, len(state.samples)), 0
            state.suspected_at = state.n_samples
            state.has_moved |= state.reference is None or not np.array_equal(held, state.reference)
            return has_woken
        state.n_quiet += not state.is_resting.any()
        if state.n_quiet >= FORGOTTEN:
            state.n_quiet, state.n_failures = 0, max(state.n_failures - 1, 0)
        return (not missing and state.scale.learn(declared)) or has_woken

    def settle(self, t: float, held: Vector) -> Settled | None:
        """End the suspicion where one hypothesis has won, from the samples since the onset; None where it goes on."""
        state = self._state
        n = state.n_since
        if not n:
            return None
        reference = held if state.reference is None else state.reference
        is_changed = not np.array_equal(reference, held)
        here = self._rows(held, n)
        is_explained = n >= _QUIET and plain_fit(here[-_QUIET:], 0).is_explained
        if is_explained and not is_changed:
            return self._explained(t, held, n)
        there = self._rows(reference, n) if is_changed else here
        if self._is_over(here, there, is_changed, is_explained) and not (is_explained and self._is_changing(held, n)):
            return self._passed(t, reference, there, is_changed)
        if n < _LONG:
            return None
        disturbance = disturbance_of(there, may_drift=False)
        parameters, nothing = plain_fit(here, self._n_free), plain_fit(there, 0)
        self.evidence.note(n, nothing=nothing, disturbance=disturbance.fit)
        if is_changed and nothing.is_explained and nothing.score <= min(parameters.score, disturbance.fit.score):
            state.n_since, state.verdict = 0, "refuted"  # the noise is larger than was known at the onset
            return Settled(self._undone(reference), ends_search=True)
        if is_changed and is_explained and parameters.is_explained:
            self.evidence.note(n, parameters=parameters)
            return self._changed(t, held) if disturbance.fit.score >= parameters.score + MARGIN else None
        is_named = disturbance.fit.is_explained and disturbance.fit.score + MARGIN <= nothing.score
        if is_named and n % 2 == 0 and not self._is_changing(held, n):
            before = self._before(reference, n)
            events = self._name(t, disturbance_of(self._rows(before, n), may_drift=False))
            return Settled(self._undone(before), events, True)
        return None

    def _explained(self, t: float, held: Vector, n: int) -> Settled:
        """End a suspicion, n samples long, as the parameters in force explain the samples again.

        Where searches have gone from those that lasted and have come back to them, a disturbance has passed.
        """
        state, lasting = self._state, self._state.lasting
        if state.has_moved and lasting is not None and agree(self.space.to_unit(lasting), self.space.to_unit(held)):
            there = self._rows(lasting, n)
            if plain_fit(there[-_QUIET:], 0).is_explained:
                return self._passed(t, lasting, there, True)
        state.n_since = 0
        return Settled(None)

    def _is_over(self, here: Vector, there: Vector, is_changed: bool, is_explained: bool) -> bool:
        """Return whether the reference explains the newest samples again, and those in force do not explain all.

        here, there: residuals (n, c) since the onset of the parameters in force and of the reference.
        """
        state = self._state
        without = there + np.where(state.is_resting, 0.0, state.offset / state.scale.effective)
        newest = slice(-_QUIET, None) if is_changed else slice(None)
        before = plain_fit(without[newest], 0)
        if not before.is_explained:
            return False
        if is_explained:
            return is_changed and not plain_fit(here, 0).is_explained
        return len(here) >= _FEWEST and before.score + MARGIN <= plain_fit(here[newest], 0).score

    def _changed(self, t: float, held: Vector) -> Settled:
        """End a suspicion that changed parameters, those in force, have won."""
        if self._is_restless(held):
            return self.give_up(t, rests=True)
        self._state.n_since, self._state.reference = 0, held
        return Settled(None)

    def give_up(self, t: float, *, rests: bool = False) -> Settled:
        """Return to the parameters that lasted, as others explain the samples for a while only.

        The third time, or where it rests at once, all channels rest.
        """
        state = self._state
        state.n_since, state.verdict = 0, "refuted"
        state.way = state.way.begin(None if state.lasting is None else self.space.to_unit(state.lasting))
        every = ~state.is_resting
        names = self._of(every)
        reason = f"parameters explain {', '.join(names)} for a few samples only"
        state.counts["unexplained"] += 1
        event = Event(t, "unexplained", {"channels": names, "reason": reason})
        state.n_failures = max(state.n_failures + 1, PATIENCE if rests else 0)
        if state.n_failures < PATIENCE:
            return Settled(state.lasting, (event,), True)
        state.findings = state.findings.forget()
        return Settled(state.lasting, (event, self._rest(t, every)), True)

    def expect(self, is_identifiable: Sequence[bool]) -> None:
        """Take a proposal that is passed on, with which of its parameters (d,) the samples determine."""
        state = self._state
        state.way = state.way.expect(np.array(is_identifiable) if state.n_since else None)

    def is_wandering(self, held: Vector) -> bool:
        """Return whether parameters have gone to and fro on the way to those in force (d,).

        By half of their bounds in excess of that way, each time determined by the samples: no change of the plant's
        does that.
        """
        return self._state.n_since > 0 and self._state.way.is_to_and_fro(self.space.to_unit(held))

    def judge(self, theta: Vector, held: Vector) -> Judgement:
        """Return whether parameters theta (d,) in place of those in force are warranted by the newest samples."""
        state = self._state
        if not state.n_since:
            n = min(len(state.samples), _QUIET)
            return "warranted" if plain_fit(self._rows(theta, n), 0).is_explained else "refuted"
        is_due = state.n_samples >= state.found_at + (_RENEWED if state.verdict == "warranted" else 1)
        if is_due or state.found_at < state.n_samples - state.n_since:
            self._weigh(theta, held)
        if state.verdict == "refuted":
            return "refuted"
        now = self._rows(theta, 1)
        if plain_fit(now, 0).is_explained or np.sum(now**2) < BETTER * np.sum(self._rows(held, 1) ** 2):
            return state.verdict
        return "refuted"

    def lags(self, theta: Vector) -> bool:
        """Return whether an estimate theta (d,) does not explain the newest samples, which other parameters may."""
        state = self._state
        if not state.n_since or state.verdict == "refuted":
            return False
        return not plain_fit(self._rows(theta, min(state.n_explained, _FEWEST)), 0).is_explained

    def jump(self, held: Vector, *, is_filter: bool) -> Estimate | None:
        """Return the parameters that explain the samples since the onset and are determined by them; None without such.

        A filter can go on from parameters that only the newest samples explain, and that they do not determine, too.
        For others there is nothing while the parameters drift: these seek again after a quarter as many samples.
        """
        state = self._state
        if not is_filter and state.n_samples < state.next_jump and state.n_since >= _QUIET:
            return None
        z = self.space.to_unit(held if state.reference is None else state.reference)
        lengths = (state.n_since, state.n_explained) if is_filter else (state.n_since,)
        found = jump_to(self._rows_at, dict.fromkeys(lengths), z, self.space)
        state.next_jump = state.n_samples + state.n_since // 4 if found is None else 0
        return found if found is None or is_filter or all(found.is_identifiable) else None

    @property
    def is_tested(self) -> bool:
        """True where the hypothesis of changed parameters has been proven, or could have been refuted."""
        return self._state.verdict == "warranted" or self._state.n_spare > 0

    def is_at_unseen_bound(self, theta: Vector, std: Vector, held: Vector) -> bool:
        """Return whether a parameter would move to a bound although its standard deviation is as wide as the bounds.

        Or anywhere, while channels rest.
        """
        return is_at_unseen_bound(self.space, theta, std, held, not self._state.is_resting.any())

    def suspend(self) -> Vector | None:
        """End the suspicion, whose samples are doubtful; return the parameters (d,) to go back to, None without one."""
        state = self._state
        if not state.n_since:
            return None
        state.n_since, state.verdict = 0, "refuted"
        return state.reference

    def accept(self, theta: Vector) -> None:
        """Take parameters (d,) that are warranted and in force for those that the next ones are compared with."""
        if self._state.n_since:
            self._state.reference, self._state.n_calm = theta, 0

    def _before(self, reference: Vector, n: int) -> Vector:
        """Return the parameters (d,) from before the newest n samples: those that lasted, or the reference.

        The reference, which a search has found since, only where it explains these, with a disturbance, and those since
        the suspicion before much better.
        """
        lasting = self._state.lasting
        if lasting is None or np.array_equal(lasting, reference):
            return reference
        if not disturbance_of(self._rows(reference, n)).fit.is_explained:
            return lasting
        n = min(n + self._state.n_calm, len(self._state.samples))
        found, other = (disturbance_of(self._rows(theta, n)).fit for theta in (reference, lasting))
        return reference if found.score + MARGIN <= other.score else lasting

    def _undone(self, reference: Vector) -> Vector:
        """Return the parameters (d,) to go back to: the reference, or the lasting ones where everything rests."""
        state = self._state
        return state.lasting if state.is_resting.all() and state.lasting is not None else reference

    def _weigh(self, theta: Vector, held: Vector) -> None:
        """Compare the hypotheses on the newest samples since the onset, fewer of them where nothing explains more."""
        state, space = self._state, self.space
        state.found_at, state.verdict = state.n_samples, "refuted"
        reference = held if state.reference is None else state.reference
        there = self._rows(theta, state.n_since)
        for n in _shorter(state.n_since):
            if self._wins(plain_fit(there[-n:], len(space)), reference, n):
                return
        z = space.to_unit(theta) if state.changed is None else state.changed
        for n in [n for n in _LENGTHS if n <= state.n_since]:
            found = changed_parameters(self._rows_at(n), z)
            if found.rate <= _RATE and self._wins(found.fit, reference, n):
                state.changed = found.z
                return

    def _wins(self, parameters: Fit, reference: Vector, n: int) -> bool:
        """Set the verdict where changed parameters are possible by their fit to the newest n samples."""
        is_recorded = n == min(self._state.n_since, _LENGTHS[0])
        if not (parameters.is_possible or is_recorded):
            return False
        before = self._rows(reference, n)
        weighing = Weighing(parameters, disturbance_of(before).fit, plain_fit(before, 0))
        if weighing.are_parameters_possible or is_recorded:
            self.evidence.note(n, **vars(weighing))
        if weighing.are_parameters_possible:
            self._state.n_explained = n
            self._state.n_spare = parameters.n_values - parameters.n_free
            unproven: Judgement = "refuted" if self._state.is_resting.any() else "possible"
            self._state.verdict = "warranted" if weighing.are_parameters_proven else unproven
        return weighing.are_parameters_possible

    def _best(self, held: Vector, n: int, *, may_drift: bool) -> ChangedParameters:
        """Return the parameters that explain the newest n samples best, whatever the search has found."""
        changed = self._state.changed
        z = self.space.to_unit(held) if changed is None else changed
        return changed_parameters(self._rows_at(n), z, may_drift=may_drift)

    def _is_changing(self, held: Vector, n: int) -> bool:
        """Return whether parameters, constant ones or slowly changing, explain the newest n samples."""
        found = self._best(held, n, may_drift=True)
        self.evidence.note(n, parameters=found.fit)
        return found.fit.is_explained and found.rate <= _RATE

    def _both(self, held: Vector, n: int) -> Disturbance | None:
        """Return the constant disturbance that explains the newest n samples together with changed parameters."""
        space = self.space

        def left(z: Vector) -> Vector:
            rows = self._rows(space.beyond(z), n)
            return rows - rows.mean(axis=-2, keepdims=True)

        best = changed_parameters(OfMany(left), space.to_unit(held), may_drift=False)
        rows = self._rows(space.beyond(best.z), n)
        n_channels, mean = n_channels_of(rows), rows.mean(axis=0)
        fit = plain_fit(best.rows, self._n_free + n_channels, n * n_channels)
        self.evidence.note(n, both=fit)
        return Disturbance(mean, np.abs(mean), fit, True) if fit.is_explained else None

    def _is_noise(self, held: Vector) -> bool:
        """Adopt a larger noise where that explains the samples since the onset, with those in force or the best ones.

        Noise is what differs from sample to sample by as much as in the whole: what a model lacks is smooth.
        """
        state = self._state
        if state.n_since < _NOISY:
            return False
        few = min(state.n_since, _WINDOW // 2)
        best = self._best(held, few, may_drift=False).z
        for n, z, least in ((state.n_since, self.space.to_unit(held), _MUCH_LARGER), (few, best, _LARGER)):
            rows_at = self._rows_at(n)
            rows = rows_at(z)
            larger = np.maximum(spread_of(rows), 1.0)
            if not np.all(np.isfinite(rows)) or np.all(larger < least):
                continue
            found = changed_parameters(OfMany(lambda z, f=rows_at, larger=larger: f(z) / larger), z)
            if found.rate <= _RATE and found.fit.is_explained:
                state.scale.enlarge(larger)
                return True
        return False

    @property
    def _n_free(self) -> int:
        return len(self.space)

    @property
    def has_failed(self) -> bool:
        """True where changed parameters do not explain the newest samples, however few."""
        return self._state.verdict == "refuted" or self._state.n_explained < _FEWEST

    def disturbance(self, held: Vector) -> Vector:
        """Return the disturbance (c,), in the derivatives' units, that may act in place of changed parameters."""
        state = self._state
        if not state.n_since:
            return state.offset * self._sigma
        reference = held if state.reference is None else state.reference
        found = disturbance_of(self._rows(reference, min(state.n_since, _QUIET)))
        return (state.offset + found.newest * state.scale.effective) * self._sigma

    def fail(self, t: float, theta: Vector | None, held: Vector) -> Settled | None:
        """Take the end of a search that has found no parameters, theta (d,) being the best; None for a false alarm.

        A disturbance is named where a constant one explains the samples. After the third time, one soon after the
        other, the channels that neither explains rest, longer each time.
        """
        state = self._state
        n = min(state.n_since, _QUIET)
        reference = held if state.reference is None else state.reference
        rows = self._rows(reference, n)
        found = disturbance_of(rows)
        self.evidence.note(n, nothing=plain_fit(rows, 0), disturbance=found.fit)
        if plain_fit(rows, 0).score <= found.fit.score:  # a false alarm
            state.n_since, state.verdict = 0, "refuted"
            return None
        is_doubtful = bool(state.is_resting.any())  # parameters need proof then
        if (not is_doubtful and self._is_changing(held, n)) or self._is_noise(held):  # which the search has not found
            return None
        explaining = [d for d in (found, self._both(held, n)) if d is not None and d.fit.is_explained]
        before = self._before(reference, n)
        if n >= _QUIET and explaining:
            best = min(explaining, key=lambda d: d.fit.score)
            if best is found:
                best = disturbance_of(self._rows(before, n))
            events = self._name(t, best)
            return Settled(self._undone(before), events, True)
        state.n_since, state.verdict = 0, "refuted"
        state.n_failures += 1
        best = rows if theta is None else self._rows(theta, n)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.nan_to_num(np.sum(best**2, axis=0), nan=np.inf)
        lacks = squares > chi2_limit(FALSE_ALARM / len(self._names), n)
        lacks = lacks if lacks.any() else ~state.is_resting
        names = self._of(lacks)
        reason = f"no parameters explain {', '.join(names)}"
        event = Event(t, "unexplained", {"channels": names, "reason": reason})
        state.counts["unexplained"] += 1
        events = (event,) if state.n_failures < PATIENCE else (event, self._rest(t, lacks))
        return Settled(self._undone(before), events, True)

    def _name(self, t: float, found: Disturbance) -> tuple[Event, ...]:
        """Take a disturbance for the explanation; return the events."""
        state = self._state
        state.n_since, state.verdict = 0, "refuted"
        state.n_failures += 1
        acts = _acting(found.largest)
        offset = state.offset + found.newest * state.scale.effective
        if found.is_constant:  # else it is another one in the next sample
            state.offset = offset
        how = "constant" if found.is_constant else "changing"
        event = self._named(t, offset, acts, f"a {how} disturbance explains the samples, changed parameters do not")
        return (event,) if state.n_failures < PATIENCE else (event, self._rest(t, acts))

    def _passed(self, t: float, before: Vector, rows: Vector, is_changed: bool) -> Settled:
        """End a suspicion as the parameters before it (d,), whose residuals are rows (n, c), explain the samples again.

        is_changed: true where others are in force. They are undone, and a disturbance that was not known is named.
        """
        state = self._state
        largest = rows[np.abs(rows).argmax(axis=0), np.arange(rows.shape[1])]
        acts, was_known = _acting(np.abs(largest)), bool(np.any(state.offset))
        n_unusual = sum(not self._is_usual(row, n_channels_of(rows)) for row in rows)
        lasting, n_newest = state.lasting, min(len(rows), _QUIET)
        if lasting is not None and plain_fit(self._rows(lasting, n_newest), 0).is_explained:
            before = lasting
        events: tuple[Event, ...] = ()
        if was_known:
            events = (Event(t, "disturbance", {"size": {}, "reason": "the disturbance is over"}),)
        elif is_changed and n_unusual >= _FEWEST:
            reason = "a disturbance has passed: the parameters before it explain the samples again"
            events = (self._named(t, largest * state.scale.effective, acts, reason),)
        state.offset, state.n_since = np.zeros(len(acts)), 0
        if not is_changed:
            return Settled(None, events, True)
        state.n_failures += 1
        if state.n_failures >= PATIENCE:
            events = (*events, self._rest(t, acts))
        return Settled(self._undone(before), events, True)

    def _named(self, t: float, offset: Vector, acts: NDArray[np.bool_], reason: str) -> Event:
        """Count a disturbance (c,), in standard deviations of the declared noise; return its event."""
        state = self._state
        size = {self._names[i]: float(offset[i] * self._sigma[i]) for i in np.flatnonzero(acts)}
        state.counts["disturbance"] += 1
        state.named = [*state.named, {"t": t, "size": size}][-MOST_NAMED:]
        return Event(t, "disturbance", {"size": size, "reason": reason})

    def succeed(self, t: float, theta: Vector) -> Settled | None:
        """Take the end of a search that has found parameters theta (d,).

        Earlier failures count less, if that proves anything. But parameters that are never proven and move on from
        search to search, by more than they may drift, explain nothing: the third time they are undone.
        """
        state = self._state
        if self._is_restless(theta):
            return self.give_up(t, rests=True)
        if state.n_spare >= _SPARE and not state.findings.has_moved:
            state.n_failures = max(state.n_failures - 1, 0)
        return None

    def _is_restless(self, theta: Vector) -> bool:
        """Take parameters (d,) that were found; return whether three of five such, soon one after the other, differ."""
        state = self._state
        state.findings = state.findings.take(state.n_samples, self.space.to_unit(theta))
        return state.findings.are_restless

    def _of(self, channels: NDArray[np.bool_]) -> list[str]:
        return [self._names[i] for i in np.flatnonzero(channels)]

    def _rest(self, t: float, channels: NDArray[np.bool_]) -> Event:
        """Let the channels rest, all of them where some do already, longer each time; return the event."""
        state = self._state
        channels = ~state.is_resting if state.is_resting.any() else channels
        length = self._settings.rest_length(state.n_failures)
        state.rest(channels, length)
        names = self._of(channels)
        reason = f"{state.n_failures} searches in vain: {', '.join(names)} left out for {length} samples"
        return Event(t, "rest", {"channels": names, "n_samples": length, "reason": reason})

    def _is_usual(self, row: Vector, n_sampled: int) -> bool:
        return not n_sampled or float(row @ row) <= chi2_limit(self._settings.false_alarm, n_sampled)

    def _rows(self, theta: Vector, n: int) -> Vector:
        """Return the residuals (..., n, c) of theta (..., d) at the newest n samples, from old to new."""
        return self.rows(theta, self._state.samples[-n:])

    def _rows_at(self, n: int) -> OfMany:
        """Return the residuals (..., n, c) at the newest n samples as a function of places (..., d)."""
        return OfMany(lambda z: self._rows(self.space.beyond(z), n))


def _acting(largest: Vector) -> NDArray[np.bool_]:
    """Return which channels (c,) a disturbance acts on, from its largest size (c,) there: one at least."""
    acts = largest > np.sqrt(chi2_limit(FALSE_ALARM, 1))
    return acts if acts.any() else largest >= largest.max()


def _shorter(n: int) -> Iterator[int]:
    """Yield numbers of newest samples from n down to 6, each two thirds of the one before."""
    while n > _LENGTHS[0]:
        yield n
        n = 2 * n // 3
