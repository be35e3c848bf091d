"""Plans that bring a shadow to the beginning of a window and through it: pure functions of the samples."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from estimator import Sample, SampleSequence

from ..fmi.trial_batch import TrialLeg
from ..slaves.slave import Slave
from .rollout_fmu import Shadow, StartMethod
from .rollout_pool import Outputs, Pool


class Origin(NamedTuple):
    """A sample at which a simulation may begin."""

    place: int
    """Place of the sample in the history."""
    state: bytes | None
    """Saved state of the plant there."""


class Leg(NamedTuple):
    """Consecutive steps with one set of parameters."""

    times: Sequence[float]
    """Times (n + 1,) [s]: a step from each to the next."""
    inputs: Sequence[Sequence[float]]
    """Inputs (n, p), held from each time to the next."""
    tunables: Sequence[float] | None
    """Parameters set before the first step; None: none are set."""


@dataclass(frozen=True)
class Plan:
    """Plan of a roll-out: initialise, set the state if there is one, and step; the last leg's outputs are compared."""

    start: Mapping[str, Any]
    start_time: float
    stop_time: float
    state: bytes | None
    before: tuple[Leg, ...]
    last: Leg

    @property
    def legs(self) -> list[tuple[TrialLeg, Sequence[float] | None]]:
        """All legs, each with the tunables set before it."""
        return [(TrialLeg(leg.times, leg.inputs), leg.tunables) for leg in (*self.before, self.last)]

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return sum(len(leg.inputs) for leg in (*self.before, self.last))

    def begin(self, pool: Pool, slave: Slave, is_new: bool) -> None:
        """Bring a slave, which must be new unless there is a state, to the last leg. Raises SlaveError."""
        if is_new or self.state is None:
            slave.initialize(self.start, self.start_time, self.stop_time)
        if self.state is not None:
            slave.set_state(self.state)
        for leg in self.before:
            pool.through(slave, *leg)

    def run(self, pool: Pool, slave: Slave, is_new: bool) -> Outputs:
        """Return the outputs (n, c) after each step of the last leg. Raises SlaveError."""
        self.begin(pool, slave, is_new)
        return pool.through(slave, *self.last)


@dataclass
class History:
    """The inputs since the start, and the parameters accepted since then."""

    start_time: float
    theta: Sequence[float]
    """Parameters (d,) at the start."""
    times: list[float] = field(default_factory=list[float])
    inputs: list[Sequence[float]] = field(default_factory=list[Sequence[float]])
    """Inputs, held from each time to the next."""
    changes: list[tuple[int, Sequence[float]]] = field(default_factory=list[tuple[int, Sequence[float]]])
    """Accepted parameters, each with the place from which on they hold."""

    def __post_init__(self) -> None:
        self.times.append(self.start_time)

    def add_sample(self, sample: Sample) -> None:
        """Add a sample; it has the place len(inputs) then."""
        self.times.append(sample.t)
        self.inputs.append(sample.u)

    def accept(self, place: int, theta: Sequence[float]) -> None:
        """Take theta (d,) for the parameters from that place on."""
        self.changes = [*(b for b in self.changes if b[0] < place), (place, theta)]

    def revert(self, theta: Sequence[float]) -> int:
        """Take theta (d,), accepted before, for the parameters since others were; return the place where that was."""
        place, changes = len(self.inputs), [*self.changes]
        while changes and [*changes[-1][1]] != [*theta]:
            place, _ = changes.pop()
        self.changes = changes if changes or [*self.theta] == [*theta] else [(place, theta)]
        return place

    def move_inputs(self, place: int, moved: Sequence[float]) -> None:
        """Take inputs moved by (p,) for those from that place on."""
        later = [[u + d for u, d in zip(inputs, moved, strict=True)] for inputs in self.inputs[place:]]
        self.inputs = [*self.inputs[:place], *later]

    def legs(self, until: int, since: int = 0) -> tuple[Leg, ...]:
        """Return the legs from a place, by default the start, to another, with the parameters accepted on the way."""
        changes = [(since, None), *(b for b in self.changes if since <= b[0] < until)]
        ends = [*(place for place, _ in changes[1:]), until]
        return tuple(
            Leg(self.times[a : b + 1], self.inputs[a:b], theta)
            for (a, theta), b in zip(changes, ends, strict=True)
            if b > a
        )


def inputs_of(way: StartMethod, shadow: Shadow, samples: Sequence[Sample]) -> list[Sequence[float]]:
    """Return the inputs held up to each sample; from a saved state, its disturbances are overwritten too."""
    undisturbed = shadow.undisturbed.values() if way == "state" else ()
    return [(*s.u, *undisturbed) for s in samples]


def plan_of(
    way: StartMethod, shadow: Shadow, history: History, theta: Sequence[float], stretch: SampleSequence
) -> Plan:
    """Return the plan for simulating a stretch with parameters theta (d,)."""
    samples, origin = stretch.samples, stretch.origin
    times, inputs = [s.t for s in samples], inputs_of(way, shadow, samples[1:])
    if way == "state":
        return Plan(shadow.start, shadow.start_time, shadow.stop_time, origin.state, (), Leg(times, inputs, theta))
    if way == "measured":
        first = samples[0]
        start = {
            **shadow.start,
            **dict(zip(shadow.inputs, first.u, strict=True)),
            **dict(zip(shadow.states, first.x, strict=True)),
            **dict(zip(shadow.parameters, theta, strict=True)),
        }
        return Plan(start, times[0], shadow.stop_time, None, (), Leg(times, inputs, None))
    start = {**shadow.start, **dict(zip(shadow.parameters, history.theta, strict=True))}
    return Plan(start, shadow.start_time, shadow.stop_time, None, history.legs(origin.place), Leg(times, inputs, theta))
