"""Checks of sampled values that need no model, and the health of their sensors."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence, Sized
from math import inf, isnan
from typing import Final, NamedTuple

from estimator.events import Event

from ..scenarios.schema.sampling import ObservationSettings
from ..scenarios.schema.toml_types import LARGEST

INPUT: Final = "input"
"""Name for all held inputs."""
LATE: Final = ("late", "sample")
SUMMED: Final = 20
"""Number of samples over which derivatives are summed, to be compared with the change of their states."""

_STANDS: Final = 3
"""Number of times that a reading must have stood still and gone on for that to be how its sensor reads."""
_WITHIN: Final = 50
"""Number of changes of a reading among which these must be: a sensor that is stuck now and then changes more often."""


class Standing(NamedTuple):
    """Number of samples for which a reading has stood still, and how it did before."""

    n: int
    """Number of samples for which it has stood still."""
    longest: int = 0
    """Largest such number before, of a sensor that often repeats a reading: a coarse or a slow one; else 0."""
    step: float = 0.0
    """Smallest step of such a sensor from one reading to the next, its resolution."""


class SensorChecks:
    """Detector of missing, infinite, late or stuck values. Keeps the last values and the newest time stamp."""

    def __init__(self, names: Sequence[str], stuck: int, macro_step: float) -> None:
        """names: of the sampled values (k,); stuck: samples with the same bits; macro_step [s]."""
        self._names, self._stuck, self._h = names, stuck, macro_step
        self._stamp = -inf
        self._previous: tuple[float, ...] = ()
        self._n_same = [0] * len(names)
        self._n_samples, self._n_repeats = 0, [0] * len(names)
        # The newest stands by place: number of changes before the end, of samples, and the step with which it ended.
        self._stands: dict[int, deque[tuple[int, int, float]]] = {}

    def step(
        self,
        t: float,
        stamp: float,
        values: tuple[float, ...],
        u: Sequence[float],
        moves: Callable[[int, Standing], bool],
    ) -> Iterator[tuple[str, str]]:
        """Yield (kind, sensor) of each fault at t [s]; stamp [s], values (k,), u (p,): of the sample.

        moves: function of a place and how the value there stands still, whether it should have changed.
        """
        is_late = stamp < t - 0.5 * self._h or stamp <= self._stamp
        self._stamp = max(self._stamp, stamp)
        if is_late:
            yield LATE
            return
        named = [*zip(self._names, values, strict=True), *((INPUT, value) for value in u)]
        bad = [("missing" if isnan(value) else "infinite", name) for name, value in named if not abs(value) <= LARGEST]
        yield from bad
        self._n_samples += 1
        if self._previous:
            rows = [*zip(self._n_same, values, self._previous, strict=True)]
            if any(self._n_same):
                self._end_stands(rows)
            self._n_same = [n + 1 if value == before else 0 for n, value, before in rows]
        self._previous = values
        if not bad and max(self._n_same, default=0) >= self._stuck:
            for i, n in enumerate(self._n_same):
                if n >= self._stuck and moves(i, self._standing(i, n)):
                    yield "stuck", self._names[i]

    def _end_stands(self, rows: Sequence[tuple[int, float, float]]) -> None:
        """Take how long each value has stood still, itself and the one before: where they differ a stand has ended."""
        for i, (n, value, before) in enumerate(rows):
            change = abs(value - before)
            if n and change > 0.0:
                self._n_repeats[i] += n
                ended = self._n_samples - self._n_repeats[i], n, change
                self._stands.setdefault(i, deque(maxlen=_STANDS)).append(ended)

    def _standing(self, i: int, n: int) -> Standing:
        """Return how a value stands still for n samples, and did before if that is how its sensor reads."""
        stands, n_changes = self._stands.get(i), self._n_samples - self._n_repeats[i] - n
        if stands is None or len(stands) < _STANDS or n_changes - stands[0][0] > _WITHIN:
            return Standing(n)
        return Standing(n, max(length for _, length, _ in stands), min(step for _, _, step in stands))


def is_most(n: int, sensors: Sized) -> bool:
    """Return whether n are more than half of the sensors, so that the rest is not used either."""
    return 2 * n > len(sensors)


class SensorHealth:
    """Health of the sensors: counts faults, reports the first of a series, and tracks sensors that have failed."""

    def __init__(self, settings: ObservationSettings, derivatives: tuple[str, ...] = ()) -> None:
        """derivatives: names of those without which the others may be used."""
        self._patience, self._derivatives = settings.patience, derivatives
        self._bad: deque[frozenset[tuple[str, str]]] = deque(maxlen=settings.patience)
        self.failed: dict[str, None] = {}
        """Sensors that are bad in more than half of the newest samples, until they are in less than a tenth."""
        self.counts: dict[str, int] = {}
        """Number of faults, by "KIND SENSOR"."""

    def take(self, t: float, found: Iterable[tuple[str, str]]) -> list[Event]:
        """Count the faults found at t [s], (kind, sensor); return the events to record."""
        now = sorted({*found})
        events: list[Event] = []
        for kind, name in now:
            self.counts[f"{kind} {name}"] = self.counts.get(f"{kind} {name}", 0) + 1
            if not any((kind, name) in bad for bad in self._bad):
                events.append(Event(t, "observation", {"fault": kind, "sensor": name}))
        self._bad.append(frozenset(now))
        return [*events, *self._judged(t, {name: kind for kind, name in now})]

    def n_doubtful(self, events: Sequence[Event], n_inconsistent: int = 0) -> int:
        """Return on how many samples before the newest one its events, from `take`, cast doubt.

        A sensor that has failed has perhaps done so for some time before that was seen; n_inconsistent: for how many
        samples a derivative or state that begins to be inconsistent may have been wrong.
        """
        has_failed = any(event.kind == "sensor" and event.detail["sensor"] in self.failed for event in events)
        is_inconsistent = any(event.detail.get("fault") == "inconsistent" for event in events)
        return max(2 * self._patience * has_failed, n_inconsistent * is_inconsistent)

    def _judged(self, t: float, now: dict[str, str]) -> Iterator[Event]:
        for name in {**now, **self.failed}:
            n_bad = sum(any(name == sensor for _, sensor in bad) for bad in self._bad)
            if name not in self.failed and n_bad > self._patience / 2:
                self.failed[name] = None
                then = "re-tuning is suspended" if self._is_suspending(name) else "the others are used without it"
                reason = f"{name} was bad in {n_bad} of {len(self._bad)} samples, now {now[name]}: {then}"
                yield Event(t, "sensor", {"sensor": name, "reason": reason})
            elif name in self.failed and n_bad <= self._patience / 10:
                then = "re-tuning resumes" if self._is_suspending(name) else "it is used"
                del self.failed[name]
                yield Event(t, "sensor", {"sensor": name, "reason": f"{name} is good again: {then}"})

    def _is_suspending(self, name: str) -> bool:
        """Return whether too little is left while a sensor has failed: it is no derivative's, or most of these have."""
        return name not in self._derivatives or is_most(len({*self._derivatives} & {*self.failed}), self._derivatives)
