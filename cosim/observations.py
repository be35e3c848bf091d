"""Which samples the estimator gets: those that are missing, late, stuck, inconsistent or outliers it does not.

They are named and counted. Gaussian processes take a NaN in silence, and every acquisition after it is NaN. A change of
the plant persists, an outlier does not: a sample that jumps away from the model is used at once, and where the next one
does not confirm it, it is taken back, with what was written on its account. A derivative that does not fit the motion
of its state is inconsistent. A constant bias of a state, or one of derivative and state that fit each other, looks like
another plant: nothing here can tell them apart.
"""

from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt
from typing import Any, Final, NamedTuple

import numpy as np

from estimator import Sample, Vector

from .consistency import Consistency
from .reconfigure import Event
from .scenarios.sampling_schema import ObservationSettings

_MEMORY: Final = 31
"""Changes of the residual whose median says what is usual."""
_MOST_SUSPECTS: Final = 5
"""Suspects in a row; more are no outliers, which are isolated."""
_PERSISTS: Final = 0.3
"""Share of a jump that must be there in the next sample; the controller may have answered to it already."""
_STILL: Final = 1e-9
"""Change of a state over a step, relative to its size, below which it may keep its bits."""


@dataclass(frozen=True)
class Sensors:
    """The sampled values, derivatives before states, as the screen sees them."""

    names: tuple[str, ...]
    """Of xdot (c,), then of x (n,)."""
    is_noisy: tuple[bool, ...]
    """Whether noise changes its bits at every sample (c + n,)."""
    noise: tuple[float, ...]
    """Standard deviations of the derivatives (c,)."""
    channels: tuple[int, ...]
    """Places in x of the states whose derivatives are sampled (c,)."""
    state_noise: tuple[float, ...]
    """Standard deviations of those states (c,)."""
    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of one sample."""
    slope: Callable[[Vector, Sample], Sequence[float]]
    """Modelled derivatives (n,) of the states."""


class Seen(NamedTuple):
    """What a sample is good for."""

    sample: Sample | None
    """What the estimator gets; None where it is kept out."""
    is_suspect: bool
    """It has jumped: the next one confirms it, or it is taken back."""
    was_outlier: bool
    """The one before, which was suspect, was not confirmed: it is to be taken back."""
    events: tuple[Event, ...]
    """What there is to say."""


class Screen:
    """Takes each sample, says whether the estimator gets it; counts those that it does not get, by kind and sensor."""

    def __init__(self, settings: ObservationSettings, sensors: Sensors, macro_step: float) -> None:
        """macro_step [s]."""
        self._settings, self._sensors, self._h = settings, sensors, macro_step
        self._outliers = Outliers(settings.outlier, sensors)
        self._consistency = Consistency(
            sensors.channels, sensors.noise, sensors.state_noise, sensors.slope, settings.inconsistent, macro_step
        )
        self._stamp = -inf
        self._previous: tuple[float, ...] = ()
        self._n_same = [0] * len(sensors.names)
        self._bad: deque[frozenset[tuple[str, str]]] = deque(maxlen=settings.patience)
        self._failed: dict[str, None] = {}
        self.counts: Counter[str] = Counter()
        """Findings, by "KIND SENSOR"."""
        self.n_kept_out = 0
        """Samples that the estimator did not get."""

    def step(self, t: float, sample: Sample, theta: Vector) -> "Seen":
        """What the sample is good for; theta (d,): what is in force at t [s]."""
        found = {*self._plain(t, sample, theta)}
        if not found:
            found = {("inconsistent", self._sensors.names[i]) for i in self._consistency.step(sample, theta)}
        is_suspect, outliers = (False, []) if found else self._outliers.step(sample, theta)
        is_kept_out = bool(found) or bool(self._failed)
        found |= {("outlier", name) for name in outliers}
        events: list[Event] = []
        for kind, name in sorted(found):
            self.counts[f"{kind} {name}"] += 1
            if not any((kind, name) in bad for bad in self._bad):  # the first of a series is told
                events.append(Event(t, "observation", {"fault": kind, "sensor": name}))
        self._bad.append(frozenset(found))
        events += self._judge(t, {name: kind for kind, name in found})
        self.n_kept_out += is_kept_out + bool(outliers)
        return Seen(None if is_kept_out else sample, is_suspect, bool(outliers), tuple(events))

    def summary(self) -> dict[str, Any]:
        """The counts, as JSON values; failed: sensors that are bad at the end."""
        return {"kept_out": self.n_kept_out, "found": dict(sorted(self.counts.items())), "failed": [*self._failed]}

    def _plain(self, t: float, sample: Sample, theta: Vector) -> Iterator[tuple[str, str]]:
        """What is wrong with a sample by itself, or beside the one before: (kind, sensor)."""
        is_late = sample.t < t - 0.5 * self._h or sample.t <= self._stamp
        self._stamp = max(self._stamp, sample.t)
        if is_late:
            yield "late", "sample"
            return
        values = (*sample.xdot, *sample.x)
        named = [*zip(self._sensors.names, values, strict=True), *(("input", u) for u in sample.u)]
        bad = [(("missing" if value != value else "infinite"), name) for name, value in named if not isfinite(value)]
        yield from bad
        if self._previous:
            pairs = zip(self._n_same, values, self._previous, strict=True)
            self._n_same = [n + 1 if value == before else 0 for n, value, before in pairs]
        self._previous = values
        if not bad and max(self._n_same) >= self._settings.stuck:
            yield from self._stuck(sample, theta)

    def _stuck(self, sample: Sample, theta: Vector) -> Iterator[tuple[str, str]]:
        """Sensors that kept their bits where noise, or the model's slope of a state, would have changed them."""
        n = len(sample.xdot)
        for i, n_same in enumerate(self._n_same):
            if n_same < self._settings.stuck:
                continue
            if self._sensors.is_noisy[i]:
                yield "stuck", self._sensors.names[i]
            elif i >= n:
                slope = self._sensors.slope(theta, sample)[i - n]
                if abs(slope) * self._h > _STILL * max(1.0, abs(sample.x[i - n])):
                    yield "stuck", self._sensors.names[i]

    def _judge(self, t: float, now: Mapping[str, str]) -> Iterator[Event]:
        """Sensors that have just failed, or recovered: bad in more than half, or a tenth, of the newest samples."""
        for name in {*now, *self._failed}:
            n_bad = sum(any(name == sensor for _, sensor in bad) for bad in self._bad)
            if name not in self._failed and n_bad > self._settings.patience / 2:
                self._failed[name] = None
                reason = f"{name} was bad in {n_bad} of {len(self._bad)} samples, now {now[name]}: re-tuning rests"
                yield Event(t, "sensor", {"sensor": name, "reason": reason})
            elif name in self._failed and n_bad <= self._settings.patience / 10:
                del self._failed[name]
                yield Event(t, "sensor", {"sensor": name, "reason": f"{name} is good again: re-tuning goes on"})


class Outliers:
    """Suspects a sample whose residual has jumped, until the next one shows whether the change persists."""

    def __init__(self, limit: float, sensors: Sensors) -> None:
        """limit: of a change, in robust standard deviations of the changes so far, at least of the noise."""
        self._limit, self._sensors = limit, sensors
        self._last: Sample | None = None
        self._suspect: Sample | None = None
        self._theta = np.empty(0)  # what was in force at the suspect
        self._n_suspects = 0
        self._changes: deque[Vector] = deque(maxlen=_MEMORY)

    def step(self, sample: Sample, theta: Vector) -> tuple[bool, list[str]]:
        """Whether the sample is suspect, and the sensors of which the sample before, suspect too, was an outlier.

        theta (d,): what is in force. After a suspect, what was in force at it: a write on its account has changed the
        inputs, which with wrong parameters makes residuals jump as well.
        """
        residual = self._sensors.residual
        if self._suspect is not None:
            theta = self._theta
        now = residual(theta, sample)
        if self._last is None or not np.isfinite(now).all():
            return self._accept(sample), []
        last = residual(theta, self._last)
        limit = self._limits(sample, now, last)
        is_far, outliers = np.abs(now - last) > limit, np.zeros(len(now), dtype=bool)
        if np.isfinite(last).all():  # else none of the limits to come would be a number
            self._changes.append(np.abs(now - last))
        if self._suspect is not None:
            before = residual(theta, self._suspect)
            was_far = np.abs(before - last) > limit
            persists = (now - last) / np.where(was_far, before - last, 1.0) >= _PERSISTS
            outliers, is_far = was_far & ~persists, is_far & ~(persists & was_far)
        names = [self._sensors.names[i] for i in np.flatnonzero(outliers)]
        if is_far.any() and self._n_suspects < _MOST_SUSPECTS:
            self._suspect, self._theta, self._n_suspects = sample, theta, self._n_suspects + 1
            return True, names
        return self._accept(sample), names

    def _limits(self, sample: Sample, now: Vector, last: Vector) -> Vector:
        """Changes of the residual (c,) that are usual; where the model moves much, its error may move as much."""
        usual = 1.4826 * np.median(self._changes, axis=0) if self._changes else np.zeros(len(now))
        assert self._last is not None
        measured = np.subtract(sample.xdot, self._last.xdot) / self._sensors.noise
        return self._limit * np.maximum(usual, sqrt(2.0)) + np.abs(measured - (now - last))

    def _accept(self, sample: Sample) -> bool:
        self._last, self._suspect, self._n_suspects = sample, None, 0
        return False
