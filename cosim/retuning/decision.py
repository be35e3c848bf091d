"""Input of a policy at a communication point, and its decision."""

from collections.abc import Sequence
from dataclasses import dataclass

from estimator import Estimate, Sample, Vector
from estimator.events import Event


@dataclass(frozen=True)
class Point:
    """Data of one communication point, for a policy."""

    k: int
    """Index of the point; the first, 0, has no input that was held up to it."""
    t: float
    """Time [s]."""
    sample: Sample | None
    """Sample for the estimator: the plant as measured, or the output of a filter; None while it has none."""
    error: float
    """Norm of the tracking error."""
    measured: Sample | None = None
    """The plant as measured, where the FMUs run or samples are the output of a filter."""
    values: Sequence[float] = ()
    """Outputs of all FMUs, where they run, including the parameters read back."""
    reference: Sequence[float] = ()
    """Values that the tracked outputs are to follow, where the FMUs run."""


@dataclass(frozen=True)
class Decision:
    """Decision of a policy at one communication point."""

    write: Vector | None = None
    """Parameters (d,) to be written to the controller; None to leave it unchanged."""
    estimate: Estimate | None = None
    """Estimate on which the decision is based."""
    events: tuple[Event, ...] = ()
    """Events in order."""
    latencies: tuple[float, ...] = ()
    """Wall time of each evaluation [s]; the last one of a step includes diagnosis, checks and prediction."""
