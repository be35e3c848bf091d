"""What a policy is given at a communication point, and what it decides there."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimator import Estimate, Sample, Vector
from estimator.events import Event


@dataclass(frozen=True)
class Point:
    """One communication point, as a policy sees it."""

    k: int
    """Its number; the first, 0, has no input that was held up to it."""
    t: float
    """Its time [s]."""
    sample: Sample | None
    """What the estimator gets: the plant as measured, or what a filter makes of it, if it has made anything."""
    error: float
    """Norm of the tracking error."""
    measured: Sample | None = None
    """The plant as measured, where it runs."""
    values: Sequence[float] = ()
    """Outputs of all FMUs, where they run; those that are read back among them."""


@dataclass(frozen=True)
class Decision:
    """What is done at one communication point."""

    write: Vector | None = None
    """theta (d,) for the controller; None to leave it."""
    estimate: Estimate | None = None
    """The estimate behind it."""
    events: tuple[Event, ...] = ()
    """What happened, in order."""
    latencies: tuple[float, ...] = ()
    """Wall time of each evaluation [s]."""
