"""Which samples the estimator gets: those that are missing, late, stuck, inconsistent or outliers it does not.

They are named and counted. Gaussian processes take a NaN in silence, and every acquisition after it is NaN. A change of
the plant persists, an outlier does not: a sample that jumps away from the model is used at once, and where the next one
does not confirm it, it is taken back, with what was written on its account. A derivative that does not fit the motion
of its state is inconsistent. A constant bias of a state, or one of derivative and state that fit each other, looks like
another plant: nothing here can tell them apart.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any, Final, NamedTuple

from estimator import Sample, Vector
from estimator.events import Event

from ..scenarios.schema.sampling import ObservationSettings
from .consistency import Consistency
from .outliers import Outliers
from .sensor_checks import INPUT, LATE, SensorChecks, SensorHealth

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


class Screened(NamedTuple):
    """What a sample is good for."""

    sample: Sample | None
    """What the estimator gets; None where it is kept out."""
    is_suspect: bool = False
    """It has jumped: the next one confirms it, or it is taken back."""
    was_outlier: bool = False
    """The one before, which was suspect, was not confirmed: it is to be taken back."""
    events: tuple[Event, ...] = ()
    """What there is to say."""


class SampleScreen:
    """Of sampled derivatives: takes each sample, says whether the estimator gets it."""

    def __init__(self, settings: ObservationSettings, sensors: Sensors, macro_step: float) -> None:
        """macro_step [s]."""
        self._sensors, self._h = sensors, macro_step
        n = len(sensors.noise)
        self._outliers = Outliers(settings.outlier, sensors.names[:n], sensors.noise, sensors.residual)
        self._consistency = Consistency(
            sensors.channels, sensors.noise, sensors.state_noise, sensors.slope, settings.inconsistent, macro_step
        )
        self._plain, self._health = SensorChecks(sensors.names, settings.stuck, macro_step), SensorHealth(settings)
        self._n_kept_out = 0

    def step(self, t: float, sample: Sample, theta: Vector) -> Screened:
        """What the sample is good for; theta (d,): what is in force at t [s]."""

        def moves(i: int) -> bool:
            return self._sensors.is_noisy[i] or self._state_moves(i, sample, theta)

        found = {*self._plain.step(t, sample.t, (*sample.xdot, *sample.x), sample.u, moves)}
        if not found:
            found = {("inconsistent", self._sensors.names[i]) for i in self._consistency.step(sample, theta)}
        is_suspect, outliers = (False, []) if found else self._outliers.step(sample, theta)
        is_kept_out = bool(found or self._health.failed)
        self._n_kept_out += is_kept_out + bool(outliers)
        events = self._health.take(t, found | {("outlier", name) for name in outliers})
        return Screened(None if is_kept_out else sample, is_suspect, bool(outliers), tuple(events))

    def summary(self) -> dict[str, Any]:
        """The counts, as JSON values; failed: sensors that are bad at the end."""
        return _summary(self._n_kept_out, self._health)

    def _state_moves(self, i: int, sample: Sample, theta: Vector) -> bool:
        """Whether the model says that the state at that place, if it is one, has changed over the step."""
        place = i - len(sample.xdot)
        if place < 0:
            return False
        slope = self._sensors.slope(theta, sample)[place]
        return abs(slope) * self._h > _STILL * max(1.0, abs(sample.x[place]))


class OutputScreen:
    """Of sampled outputs, for roll-outs, which need every sample: a bad value becomes NaN, which is not judged.

    An outlier cannot be told from what other parameters would do: that takes a model of the outputs.
    """

    def __init__(
        self,
        settings: ObservationSettings,
        names: tuple[str, ...],
        is_noisy: tuple[bool, ...],
        macro_step: float,
    ) -> None:
        """names, is_noisy: of the outputs y (c,), and whether noise changes their bits; macro_step [s]."""
        self._names, self._is_noisy = names, is_noisy
        self._plain, self._health = SensorChecks(names, settings.stuck, macro_step), SensorHealth(settings)
        self._n_kept_out = 0

    def step(self, t: float, sample: Sample, theta: Vector) -> Screened:
        """The sample at t [s] without its bad values; while a sensor has failed, without any."""
        found = {*self._plain.step(t, sample.t, sample.y, sample.u, lambda i: self._is_noisy[i])}
        bad = {name for _, name in found}
        is_useless = bool(self._health.failed) or LATE in found or INPUT in bad
        y = tuple(
            nan if is_useless or name in bad else value for name, value in zip(self._names, sample.y, strict=True)
        )
        self._n_kept_out += bool(found) or is_useless
        return Screened(replace(sample, t=t, y=y), events=tuple(self._health.take(t, found)))

    def summary(self) -> dict[str, Any]:
        """As that of `SampleScreen`; kept_out: samples of which at least one value was."""
        return _summary(self._n_kept_out, self._health)


def _summary(n_kept_out: int, health: SensorHealth) -> dict[str, Any]:
    return {"kept_out": n_kept_out, "found": dict(sorted(health.counts.items())), "failed": [*health.failed]}
