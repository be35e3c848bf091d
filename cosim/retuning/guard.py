"""The guard between estimator and controller: checks before a write, and reverts after it.

An unassured function, the estimator, behind a monitor with a recovery: Sha (2001), "Using simplicity to control
complexity", IEEE Software 18(4); ASTM F3269. Before a write, parameters must be finite, inside the bounds, within the
rate, supported by the data and predicted safe. After it they are on probation until the tracking error has stayed as
small as it was, or was predicted to be; else the guard reverts to the last good ones, then to those of the start. No
decision depends on the wall clock.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import Any

import numpy as np

from estimator import Estimate, ParameterSpace, Vector, chi2_limit
from estimator.events import Event
from estimator.identifiability import IDENTIFIABLE_BELOW
from estimator.parameter_filter import FILTERED
from estimator.retuning.proposal import Proposal
from estimator.significance import FALSE_ALARM, SAMPLE_FALSE_ALARM

from ..scenarios.schema.guard import GuardSettings
from ..system.tunables import is_taken
from .data_support import DataSupport, NoDataSupport, Reason
from .decision import Point
from .probation import Probation, Trial

_NO_WORSE = 2.0
"""Largest ratio of one sum of squares to another, of a write's to that of the parameters held, that is no worse."""
_MOST_EXPECTED = 3.0
"""Largest peak that a write may lead to, as a multiple of the present error or of the tolerance: predicted in a plant
that is wrong, as where a sensor is, it may be anything."""
_POSTPONED = 2
"""Power of `growth` by which the error may pass its limit where the samples contradict what would return more."""
_AS_MANY_AGAIN = 2
"""Least number of values, by parameter, that parameters explain where they are more than fitted to them."""
_LITTLE = 0.01
"""Share of the scaled bounds below which a move in an unidentified direction, or an uncertainty, is ignored."""
_AWAY = 0.1
"""Share of the scaled bounds from a write beyond which parameters are others."""
_TRIED = 0.25
"""Share of its probation for which a write, or what is close to it, must have been in force."""
_UNDECIDED = "a disturbance explains the samples as well, and the loop is not simulated ahead"
"""Reason of a veto where nothing tells what a write would do if it was one."""


PredictedPeak = Callable[[Vector, Vector, Vector | None], float | None]
"""Function of theta (d,) in controller and in plant, and of a `Proposal.possible_disturbance` or None:
largest norm of the tracking error, or None if unknown."""


@dataclass(frozen=True)
class Ruling:
    """Decision of the guard on a proposal."""

    write: Vector | None
    """Parameters to be written (d,), or None."""
    events: tuple[Event, ...] = ()
    """Actions on the proposal, with reasons."""
    is_revert: bool = False
    """True where write is a revert, and not the proposal."""
    estimate: Estimate | None = None
    """What is known of the parameters written; None where they are not of a proposal."""


@dataclass(frozen=True)
class GuardSnapshot:
    """State of a guard, restored where a write turns out to be due to an outlier."""

    trials: tuple[Trial, ...]
    """Writes on probation, from old to new."""
    anchor: Vector
    """The last material write (d,)."""


@dataclass(frozen=True)
class _Verdict:
    """Result of the checks before a write."""

    theta: Vector | None
    """Parameters that may be written (d,), or None."""
    reasons: tuple[Reason, ...] = ()
    """Actions on the write, with reasons."""
    expected: float = 0.0
    """Predicted peak of the tracking error; 0 where nothing was predicted."""


class Guard:
    """Guard of a controller. Stores the last good writes and those on probation; the caller stores those in force."""

    def __init__(
        self,
        settings: GuardSettings,
        space: ParameterSpace,
        start: Vector,
        divergence: float,
        support: DataSupport | NoDataSupport,
        refusal: Callable[[Vector], str | None] = lambda theta: None,
    ) -> None:
        """start (d,): the controller's first parameters, for the last revert; divergence: limits.divergence; refusal:
        the reason why the controller does not take parameters (d,), or None."""
        self._refusal = refusal
        self._settings, self._space, self._start, self._support = settings, space, start, support
        tolerance = settings.tolerance_at(divergence)
        self._probation = Probation(tolerance, settings.growth, settings.probation, settings.horizon)
        self._good = self._anchor = start
        self._rests_until = -1
        self._n_reverted = 0  # but for those in the rest after another one, which are of the same event
        self._refused: tuple[bytes, bool, int] = (b"", False, 0)
        self.counts: Counter[str] = Counter()
        """Number of proposals written, undecided (written while a disturbance explained the samples as well), limited,
        held in part, vetoed, confirmed, reverted, retracted and undone."""
        self.stopped_at: float | None = None
        """Time [s] at which re-tuning stopped; None while it goes on."""

    def summary(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        kinds = ("written", "undecided", "limited", "held", "vetoed", "confirmed", "reverted", "retracted", "undone")
        return {kind: self.counts[kind] for kind in kinds} | {"stopped_at": self.stopped_at}

    def snapshot(self) -> GuardSnapshot:
        """Return the present state, for `restore`."""
        return GuardSnapshot(self._probation.trials, self._anchor)

    def restore(self, snapshot: GuardSnapshot) -> None:
        """Restore a snapshot: the writes since then are retracted."""
        self._probation.restore(snapshot.trials)
        self._anchor = snapshot.anchor
        self.counts["retracted"] += 1

    def undo(self, theta: Vector) -> None:
        """Take the return to earlier parameters (d,): other writes are on probation no longer."""
        self._probation.keep(theta)
        self._anchor = theta
        self.counts["undone"] += 1

    def not_taken(self, t: float, read: Sequence[float], held: Sequence[float], names: Sequence[str]) -> Event | None:
        """Stop re-tuning where the read-back differs from the parameters written; return the event, or None.

        read, held: values read back and written; names: of the variables.
        """
        for name, value, written in zip(names, read, held, strict=True):
            if not is_taken(value, written):
                self.stopped_at = t
                reason = f"{name} reads back as {value:.9g}, but {written:.9g} was written: re-tuning stops"
                return Event(t, "stop", {"reason": reason})
        return None

    def step(self, point: Point, proposal: Proposal, held: Vector, peak: PredictedPeak | None) -> Ruling:
        """Rule on a proposal at a communication point.

        held (d,): the controller's parameters; peak: None where nothing is predicted.
        """
        k, t, error = point.k, point.t, point.error
        self._probation.watch(error, point.reference, is_proposed=proposal.theta is not None)
        watched = self._watch(k, t, error, held)
        if watched is not None:
            return watched
        confirmed = self._confirmed(k, t)
        theta, estimate = proposal.theta, proposal.estimate
        if theta is None or estimate is None:
            return Ruling(None, confirmed)
        rival = proposal.possible_disturbance
        if rival is None:
            self._probation.prove()
        this = (theta.tobytes(), rival is None)
        if k < self._rests_until or (self._refused[:2] == this and k < self._refused[2]):
            return Ruling(None, confirmed)
        verdict = self._judge(proposal, theta, held, estimate, error, peak)
        events = tuple(Event(t, kind, {"theta": theta.tolist(), "reason": why}) for kind, why in verdict.reasons)
        self.counts.update(_COUNTED[kind] for kind, _ in verdict.reasons)
        if verdict.theta is not None and self._space.are_same(verdict.theta, held):  # all of the move was left out
            return Ruling(None, (*confirmed, *events))
        if verdict.theta is None:
            self._refused = (*this, k + self._settings.horizon // 2)
            return Ruling(None, (*confirmed, *events))
        self.counts["undecided"] += not proposal.is_warranted
        self._put_on_probation(k, verdict.theta, max(error, verdict.expected), is_proven=rival is None)
        return Ruling(verdict.theta, (*confirmed, *events), estimate=estimate_at(verdict.theta, estimate, self._space))

    def _watch(self, k: int, t: float, error: float, held: Vector) -> Ruling | None:
        """Return the revert, where a write on probation has raised the tracking error above its limit; or None."""
        allowed = self._probation.allowed
        if allowed is None or error <= allowed:
            return None
        is_other = k >= self._rests_until  # else nothing was written since the last: what had returned has failed
        n = self._n_reverted + is_other
        is_last = n >= self._settings.reverts
        is_good_bad = np.array_equal(held, self._good)  # the last good parameters are those that failed
        back = self._start if is_last or is_good_bad else self._good
        if error <= self._settings.growth**_POSTPONED * allowed and self._is_worse(back, held):
            return None
        self._n_reverted = n
        self.counts["reverted"] += 1
        reason = f"tracking error {error:.4g} exceeded {allowed:.4g} while on probation"
        if not is_last:
            reason = f"{reason}: nothing is written for {self._settings.probation} macro steps"
        events = [Event(t, "revert", {"theta": back.tolist(), "reason": reason, "n": n})]
        self._anchor = self._good = back
        self._probation.clear()
        self._rests_until = k + self._settings.probation
        if is_last:
            self.stopped_at = t
            reason = f"{n} reverts: re-tuning stops, with the parameters of the start"
            events.append(Event(t, "stop", {"reason": reason}))
        elif not np.array_equal(back, self._start):
            self._probation.begin(k, back, self._settings.growth * error, is_proven=True)
        return Ruling(back, tuple(events), is_revert=True)

    def _is_worse(self, back: Vector, held: Vector) -> bool:
        """Return whether the samples contradict the parameters to go back to (d,) more than those held (d,).

        The newest one by itself; or, as it may tell nothing, the newest ones together that those held explain, where
        these are proven: no disturbance explains the samples as well.
        """
        cost = self._support.cost(back)
        if isfinite(cost) and cost > max(self._limit, _NO_WORSE * self._support.cost(held)):
            return True
        if not self._probation.is_proven:
            return False
        return _is_refuted(self._support.residuals(back), self._support.residuals(held), len(back))

    @property
    def _limit(self) -> float:
        """Sum of squares at the newest sample that noise alone may reach."""
        return chi2_limit(SAMPLE_FALSE_ALARM, self._support.n_channels)

    def _confirmed(self, k: int, t: float) -> tuple[Event, ...]:
        """Confirm the writes whose probation ends at point k; return the events.

        Those that a later one soon went far away from have not been tried.
        """
        events: list[Event] = []
        for trial in self._probation.end(k):
            further = (later for later in self._probation.trials if self._distance(later.theta, trial.theta) > _AWAY)
            left = next(further, None)
            if left is not None and left.since - trial.since < _TRIED * self._settings.probation:
                continue
            self._good = trial.theta
            self.counts["confirmed"] += 1
            events.append(Event(t, "confirm", {"theta": self._good.tolist()}))
        return tuple(events)

    def _put_on_probation(self, k: int, theta: Vector, error: float, *, is_proven: bool) -> None:
        """Put a write on probation from point k on, if it is material; error: the larger of present and predicted.

        One of the last good parameters takes back those on probation: nothing shows any more what these would do.
        """
        self.counts["written"] += 1
        if self._space.are_same(theta, self._good):
            self._probation.clear()
            self._anchor = theta
        elif self._is_material(theta):
            self._anchor = theta
            self._probation.begin(k, theta, self._settings.growth * error, is_proven=is_proven)

    def _is_material(self, theta: Vector) -> bool:
        return self._distance(theta, self._anchor) > self._settings.material

    def _distance(self, one: Vector, other: Vector) -> float:
        """Return the largest difference of a parameter, as a share of the scaled bounds."""
        return float(np.abs(self._space.to_unit(one) - self._space.to_unit(other)).max())

    def _judge(
        self,
        proposal: Proposal,
        theta: Vector,
        held: Vector,
        estimate: Estimate,
        error: float,
        peak: PredictedPeak | None,
    ) -> _Verdict:
        """Return the result of the checks before a write, the cheap ones first; theta (d,): proposed.

        A small move is predicted only where it may be for noise, away from good parameters while nothing is on trial.
        """
        if refusal := outside(theta, self._space):
            return _Verdict(None, (("veto", refusal),))
        allowed, reasons = within_rate(theta, held, self._space, self._settings.rate)
        if is_material := self._is_material(allowed):
            unseen = self._settings.unseen
            is_known = estimate.reason == FILTERED and proposal.possible_disturbance is None
            known = estimate.information if is_known else None
            allowed, left_out = self._support.identifiable_part(allowed, held, estimate.theta, unseen, _LITTLE, known)
            reasons = (*reasons, *left_out)
        if refusal := self._refusal(allowed):
            return _Verdict(None, (*reasons, ("veto", refusal)))
        may_be_noise = proposal.if_noise is not None and np.array_equal(self._anchor, self._good)
        if not (is_material or may_be_noise):
            return _Verdict(allowed, reasons)
        if refusal := self._contradicted(allowed, held):
            return _Verdict(None, (*reasons, ("veto", refusal)))
        if peak is None:
            is_decided = proposal.is_warranted
            return _Verdict(allowed, reasons) if is_decided else _Verdict(None, (*reasons, ("veto", _UNDECIDED)))
        refusal, expected = self._predicted(proposal, allowed, held, estimate, error, peak)
        return _Verdict(None, (*reasons, ("veto", refusal))) if refusal else _Verdict(allowed, reasons, expected)

    def _contradicted(self, theta: Vector, held: Vector) -> str | None:
        """Return the reason why the newest sample contradicts a write, more than the parameters held; or None."""
        cost, before = self._support.cost(theta), self._support.cost(held)
        if cost <= max(self._limit, _NO_WORSE * before) or not isfinite(before):
            return None
        return f"explains the newest sample worse: sum of squares {cost:.4g}, with what is held {before:.4g}"

    def _predicted(
        self,
        proposal: Proposal,
        theta: Vector,
        held: Vector,
        estimate: Estimate,
        error: float,
        peak: PredictedPeak,
    ) -> tuple[str | None, float]:
        """Return the reason why a write is predicted to be unsafe in a plant that is still possible, or None.

        And its predicted peak.
        """
        expected = 0.0
        growth = self._settings.growth
        tolerated = max(growth * error, self._probation.tolerated(is_proven=False))
        most = _MOST_EXPECTED * max(error, self._probation.tolerated(is_proven=True))
        plants: list[tuple[str, Vector, Vector | None, float]] = []
        if proposal.if_noise is not None:
            plants.append(("noise larger than declared", proposal.if_noise, None, tolerated))
        if proposal.possible_disturbance is not None:
            plants.append(("parameters held, and a disturbance", held, proposal.possible_disturbance, tolerated))
        plausible = self._support.plausible_parameters(estimate.theta, self._settings.n_std, _LITTLE)
        plants += [(name, plant, None, growth * error) for name, plant in plausible]
        for name, plant, disturbance, harmless in plants:
            found = peak(theta, plant, disturbance)
            if found is None:
                if disturbance is not None and not proposal.is_warranted:
                    return "a disturbance explains the samples as well, and its effect cannot be predicted", expected
                continue
            if found > harmless and found > growth * ((stay := peak(held, plant, disturbance)) or 0.0):
                without = f"{stay:.4g}" if stay is not None else "unknown"
                reason = f"predicted peak of the tracking error {found:.4g}, without the write {without} ({name})"
                return reason, found
            if isfinite(found):  # a loop that diverges either way says nothing of what to expect
                expected = max(expected, min(found, most))
        return None, expected


_COUNTED: Mapping[str, str] = {"limit": "limited", "hold": "held", "veto": "vetoed"}


def estimate_at(theta: Vector, estimate: Estimate, space: ParameterSpace) -> Estimate:
    """Return an estimate with other parameters theta (d,), whose root mean square errors have their distance, too.

    What is further away from the estimate than an identifiable parameter's deviation is not identified.
    """
    if np.array_equal(theta, estimate.theta):
        return estimate
    away = np.abs(space.to_unit(theta) - space.to_unit(estimate.theta))
    std = np.minimum(np.hypot(estimate.std / space.slope(estimate.theta), away), 1.0) * space.slope(theta)
    is_near = (away <= IDENTIFIABLE_BELOW).tolist()
    identifiable = tuple(a and b for a, b in zip(estimate.is_identifiable, is_near, strict=True))
    return replace(estimate, theta=theta, std=std, is_identifiable=identifiable)


def _is_refuted(of_back: Vector, of_held: Vector, n_parameters: int) -> bool:
    """Return whether the newest samples refute other parameters than those held, which explain them.

    These are the samples up to the first, from the newest one on, with which those held do not pass the test. They have
    more values than are fitted. of_back, of_held: whitened residuals (n, c) at the samples kept, from old to new; a
    value that is 0 with both is none: its channel rests, or was not sampled.
    """
    n_values = np.cumsum(np.count_nonzero((of_back != 0.0) | (of_held != 0.0), axis=1)[::-1]).tolist()
    back, held = (np.cumsum(np.einsum("nc,nc->n", r, r)[::-1]).tolist() for r in (of_back, of_held))
    refuted = False
    for n, other, own in zip(n_values, back, held, strict=True):
        if not own <= chi2_limit(FALSE_ALARM, max(n, 1)):
            break
        least = max(chi2_limit(SAMPLE_FALSE_ALARM, max(n, 1)), _NO_WORSE * own)
        refuted = n >= _AS_MANY_AGAIN * n_parameters and least < other < inf
    return refuted


def outside(theta: Vector, space: ParameterSpace) -> str | None:
    """Return the reason why a candidate (d,) is not finite or outside the bounds, or None."""
    for parameter, value in zip(space, theta.tolist(), strict=True):
        if not isfinite(value):
            return f"{parameter.name} is {value}"
        if not parameter.contains(value):
            bounds = f"[{parameter.lower:g}, {parameter.upper:g}] {parameter.unit}"
            return f"{parameter.name} = {value:.6g} is outside {bounds}"
    return None


def within_rate(theta: Vector, held: Vector, space: ParameterSpace, rate: float) -> tuple[Vector, tuple[Reason, ...]]:
    """Return the candidate (d,), shortened to the move from held that the rate permits, and the reasons."""
    here = space.to_unit(held)
    change = space.to_unit(theta) - here
    largest = float(np.max(np.abs(change)))
    if largest <= rate:
        return theta, ()
    name = space.names[int(np.argmax(np.abs(change)))]
    reason = f"{name} would move by {largest:.2g} of its bounds in a macro step, at most {rate:g} is allowed"
    return space.from_unit(here + change * (rate / largest)), (("limit", reason),)
