"""Screening of samples: the estimator gets no value that is missing, late, stuck, inconsistent or an outlier.

Of a sample with a bad derivative it gets the others; of one with a bad state, or mostly bad derivatives, nothing.

Rejected samples are reported and counted. Gaussian processes accept a NaN silently, and every acquisition after it is
NaN. A change of the plant persists, an outlier does not: a sample that jumps away from the model is used at once; if
the next one does not confirm it, it is retracted, with the writes due to it; once that has happened, the next such
sample waits for its confirmation. A derivative that does not fit the motion of its state is inconsistent, or its state
is, by `FaultIsolation`. A bias of a state that was there from the start, or consistent biases of derivative and state,
look like another plant and are not detected.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from math import nan
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator import Sample, Vector
from estimator.events import Event

from ..scenarios.schema.sampling import ObservationSettings
from .consistency import Consistency, Contradictions
from .fault_isolation import FaultIsolation, Pair, ResidualModel
from .outliers import Outliers
from .sensor_checks import LATE, SensorChecks, SensorHealth, Standing, is_most
from .spikes import Spikes

_STILL: Final = 1e-9
"""Change of a state over a step, relative to its size, below which its bits may stay the same."""
_STEPS: Final = 10.0
"""Steps of a coarse sensor by which its state must have moved, by a model that may lack something."""
_LONGER: Final = 10
"""Multiple of the longest time that a reading has stood still for which it is not stuck."""


@dataclass(frozen=True)
class Sensors:
    """Description of the sampled values for the screen, derivatives before states."""

    names: tuple[str, ...]
    """Names of xdot (c,), then of x (n,)."""
    is_noisy: tuple[bool, ...]
    """True for each value whose bits change by noise at every sample (c + n,)."""
    noise: tuple[float, ...]
    """Standard deviations of the derivatives (c,)."""
    channels: tuple[int, ...]
    """Places in x of the states whose derivatives are sampled (c,)."""
    state_noise: tuple[float, ...]
    """Standard deviations of all states (n,)."""
    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of one sample."""
    slope: Callable[[Vector, Sequence[float], Sequence[float]], Sequence[float]]
    """Modelled derivatives (n,) of the states at theta (d,), x (n,), u (p,)."""
    others: tuple[Vector, ...] = ()
    """Parameters (d,), apart from those in force, at which kinematics are the same."""


class Screened(NamedTuple):
    """Result of screening a sample."""

    sample: Sample | None
    """Sample for the estimator; None where it is kept out."""
    is_suspect: bool = False
    """True where the sample has jumped: the next one confirms it, or it is retracted."""
    was_outlier: bool = False
    """True where the sample before, a suspect, was not confirmed and must be retracted."""
    events: tuple[Event, ...] = ()
    """Events to record."""
    n_doubtful: int = 0
    """Number of samples before this one that turn out to be doubtful, as a sensor is found to be faulty."""
    before: Sample | None = None
    """The sample before this one without its isolated values, where it turns out to have had one; else None."""


class SampleScreen:
    """Screen of sampled derivatives and states, which decides on each sample."""

    def __init__(self, settings: ObservationSettings, sensors: Sensors, macro_step: float) -> None:
        """macro_step [s]."""
        self._sensors, self._h = sensors, macro_step
        n = len(sensors.noise)
        self._outliers = Outliers(settings.outlier, sensors.names[:n], sensors.noise, sensors.residual)
        self._consistency = Consistency(
            sensors.channels, sensors.noise, sensors.state_noise, sensors.slope, settings.inconsistent, macro_step,
            sensors.others,
        )  # fmt: skip
        pairs = tuple(
            Pair(i, place, (sensors.noise[i], own)) if i < n else Pair(None, place, (0.0, own))
            for i, place in enumerate(self._consistency.places)
            for own in [sensors.state_noise[place]]
        )
        self._isolation = FaultIsolation(pairs, ResidualModel(sensors.residual, sensors.slope, macro_step))
        self._plain = SensorChecks(sensors.names, settings.stuck, macro_step)
        self._health = SensorHealth(settings, sensors.names[:n])
        self._n_kept_out, self._n_outliers = 0, 0
        self._bad: set[str] = set()  # sensors that the newest sample's faults are of

    def step(self, t: float, sample: Sample, theta: Vector, were_isolated: Iterable[bool] = ()) -> Screened:
        """Return the screened sample; theta (d,): parameters in force at t [s].

        were_isolated: whether each state of the sample before was an isolated value, which is counted.
        """

        def moves(i: int, standing: Standing) -> bool:
            is_state, is_noisy = i >= len(sample.xdot), self._sensors.is_noisy[i]
            if is_noisy and not (is_state and standing.step):
                return noise_moves(standing)
            return is_state and self._state_moves(i, sample, theta, standing)

        channels = self._sensors.names[: len(sample.xdot)]
        found = {*self._plain.step(t, sample.t, (*sample.xdot, *sample.x), sample.u, moves)}
        faulty = {name for _, name in found}
        is_compared = faulty < {*channels} if channels else self._consistency.places
        if is_compared:  # else there is nothing to compare the motion of the states with
            contradictions = self._consistency.step(_without(sample, channels, faulty), theta)
            found |= {("inconsistent", name) for name in self._inconsistent(contradictions, sample, theta) - faulty}
            jumped = {self._sensors.names[len(channels) + self._consistency.places[i]] for i in contradictions.jumps}
            found |= {("jump", name) for name in jumped - {name for _, name in found}}
        bad = {name for _, name in found} | {*self._health.failed}
        is_kept_out = not bad <= {*channels} or is_most(len(bad), channels) or self._isolation.is_undecided
        sample = _without(sample, channels, bad)
        is_suspect, outliers = (False, []) if is_kept_out else self._outliers.step(sample, theta)
        if is_suspect and self._n_outliers:  # this one may be another
            is_kept_out, is_suspect = True, False
        self._n_outliers += len(outliers)
        was_outlier = bool(outliers)
        self._n_kept_out += (bool(bad) or is_kept_out) + was_outlier
        isolated = {name for name, was in zip(self._sensors.names[len(channels) :], were_isolated, strict=False) if was}
        outliers += isolated - self._bad
        self._bad = {name for _, name in found}
        events = self._health.take(t, found | {("outlier", name) for name in outliers})
        n_doubtful = self._health.n_doubtful(events, self._consistency.n_doubtful) if events else 0
        return Screened(None if is_kept_out else sample, is_suspect, was_outlier, tuple(events), n_doubtful)

    def _inconsistent(self, found: Contradictions, sample: Sample, theta: Vector) -> set[str]:
        """Return the names of the derivatives that are inconsistent, and of the states whose fault it is."""
        n, names, places = len(sample.xdot), self._sensors.names, self._consistency.places
        before, states = self._isolation.states, frozenset[int]()
        if n:  # else a motion is all that there is to compare, with the same model
            states = self._isolation.step(sample, theta, {*found.derivatives, *found.jumps})
        if before and not states:
            self._consistency.forget()
        elif not states:
            states = frozenset(places[i] for i in found.states)
        return {names[i] for i in found.derivatives if places[i] not in states} | {names[n + i] for i in states}

    def summary(self) -> dict[str, Any]:
        """Return the counts as JSON values; failed: sensors that have failed at the end."""
        return _summary(self._n_kept_out, self._health)

    def _state_moves(self, i: int, sample: Sample, theta: Vector, standing: Standing) -> bool:
        """Return whether, by the model, the state at place i has changed, by steps of its sensor if that is coarse."""
        place = i - len(sample.xdot)
        moved = abs(self._sensors.slope(theta, sample.x, sample.u)[place]) * self._h
        return moved > _STILL * max(1.0, abs(sample.x[place])) and moved * standing.n > _STEPS * standing.step


def noise_moves(standing: Standing) -> bool:
    """Return whether noise should have changed a reading that stands still: one that often does, after much longer."""
    return standing.n > _LONGER * standing.longest


def _without(sample: Sample, channels: Sequence[str], bad: Set[str]) -> Sample:
    """Return the sample with NaN for bad derivatives; channels (c,): their names."""
    if not bad:
        return sample
    pairs = zip(sample.xdot, channels, strict=True)
    return replace(sample, xdot=tuple(nan if name in bad else value for value, name in pairs))


class FilteredScreen:
    """Screen of the states that a filter makes derivatives of: none of its outputs passes that a bad sample is part of.

    A state is compared with its modelled motion, where neither parameters nor inputs matter to that. An isolated value
    is told by the next one; an output whose newest value may be one waits for that. A derivative is left out where the
    model has a corner within a macro step, of which points at its ends show too little; not two in a row, since then
    the step is long for all of the model.
    """

    def __init__(
        self,
        states: SampleScreen,
        noise: Sequence[float],
        n_points: int,
        every: int,
        has_corner: Callable[[Vector, Sample], NDArray[np.bool_]],
    ) -> None:
        """states: without derivatives; noise: standard deviation of each; n_points: of the filter; every: points from
        one of its outputs to the next; has_corner: of `DerivativeResidual`.
        """
        self._states, self._n_points, self._every, self._has_corner = states, n_points, every, has_corner
        self._had_corner = False  # the output before
        self._spikes = Spikes(noise)
        self._waiting: Sample | None = None  # an output whose newest value may be isolated
        self._n_good = 1  # the one before the first step is exact

    def step(self, t: float, sample: Sample | None, theta: Vector, measured: Sample) -> Screened:
        """Return the filter's output, if there is one; measured: the newest sample; theta (d,): in force at t [s]."""
        were_isolated = [mean == mean for mean in self._spikes.step(measured.x).tolist()]
        found = self._states.step(t, measured, theta, were_isolated)
        if any(were_isolated):
            self._n_good, self._waiting = 0, None
        self._n_good = 0 if found.sample is None else self._n_good + 1
        made = sample if sample is not None and self._n_good >= self._n_points else self._waiting
        self._waiting = made if self._spikes.is_suspect else None
        kept = None if self._spikes.is_suspect or made is None else self._resolved(theta, made)
        return Screened(kept, events=found.events, n_doubtful=-(-found.n_doubtful // self._every))

    def _resolved(self, theta: Vector, made: Sample) -> Sample | None:
        """Return the sample without derivatives that a corner of the model is in; None where none is left."""
        corners = self._has_corner(theta, made)
        self._had_corner = bool(corners.any()) and not self._had_corner
        if not self._had_corner:
            return made
        if corners.all():
            return None
        left = zip(corners.tolist(), made.xdot, strict=True)
        return replace(made, xdot=tuple([nan if is_lost else value for is_lost, value in left]))

    def summary(self) -> dict[str, Any]:
        """Return the counts as `SampleScreen` does."""
        return self._states.summary()


class OutputScreen:
    """Screen of sampled outputs, for roll-outs, which need every sample: a bad value becomes NaN, which is not scored.

    An isolated value is told by the next one. It is not scored either; of a state, in which a roll-out may begin, it
    becomes the mean of its neighbours.
    """

    def __init__(
        self,
        settings: ObservationSettings,
        outputs: Mapping[str, float],
        states: Mapping[str, float],
        macro_step: float,
        *,
        may_be_missing: bool = False,
    ) -> None:
        """outputs, states: standard deviation of each one's noise, by name, in the samples' order; macro_step [s].

        may_be_missing: whether a sample without some of them is no fault of their sensors, as in a log.
        """
        self._outputs, self._n_kept_out, self._may_be_missing = (*outputs,), 0, may_be_missing
        self._further = [i for i, name in enumerate(states) if name not in outputs and states[name]]
        self._names = (*outputs, *((*states,)[i] for i in self._further))
        self._noise = (*outputs.values(), *((*states.values(),)[i] for i in self._further))
        self._plain, self._health = SensorChecks(self._names, settings.stuck, macro_step), SensorHealth(settings)
        self._series, self._spikes = (*outputs, *states), Spikes((*outputs.values(), *states.values()))
        self._last: Sample | None = None

    def step(self, t: float, sample: Sample, theta: Vector) -> Screened:
        """Return the sample at t [s] with NaN for bad values; while a sensor has failed, or a state is bad, for all."""

        def moves(i: int, standing: Standing) -> bool:
            return self._noise[i] > 0.0 and noise_moves(standing)

        values = (*sample.y, *(sample.x[i] for i in self._further))
        found = {*self._plain.step(t, sample.t, values, sample.u, moves)}
        if self._may_be_missing:
            found -= {("missing", name) for name in self._names}
        bad = {name for _, name in found}
        is_useless = bool(self._health.failed) or LATE in found or not bad <= {*self._outputs}
        means = self._spikes.step((*sample.y, *sample.x)).tolist()
        isolated = {name for name, mean in zip(self._series, means, strict=True) if mean == mean}
        found |= {("outlier", name) for name in isolated}
        self._n_kept_out += bool(found) or is_useless
        events = tuple(self._health.take(t, found))
        named = zip(self._outputs, sample.y, strict=True)
        y = tuple(nan if is_useless or name in bad else value for name, value in named)
        before, self._last = self._last, replace(sample, t=t, y=y)
        corrected = _without_spikes(before, means) if isolated and before is not None else None
        return Screened(self._last, events=events, n_doubtful=self._health.n_doubtful(events), before=corrected)

    def summary(self) -> dict[str, Any]:
        """Return the counts as `SampleScreen` does; kept_out: samples with at least one value kept out."""
        return _summary(self._n_kept_out, self._health)


def _summary(n_kept_out: int, health: SensorHealth) -> dict[str, Any]:
    return {"kept_out": n_kept_out, "found": dict(sorted(health.counts.items())), "failed": [*health.failed]}


def _without_spikes(sample: Sample, means: Sequence[float]) -> Sample:
    """Return the sample without isolated values; means (c + n,): of their neighbours, NaN for those that are right."""
    y = tuple(nan if mean == mean else value for value, mean in zip(sample.y, means[: len(sample.y)], strict=True))
    x = tuple(mean if mean == mean else value for value, mean in zip(sample.x, means[len(sample.y) :], strict=True))
    return replace(sample, x=x, y=y)
