"""State of a diagnosis of sequences: all that changes from sample to sample."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ..space import Vector
from .residual_scale import ResidualScale
from .resting import RestingResiduals


@dataclass
class EpisodeState:
    """All that changes from sample to sample; arrays are replaced, never changed."""

    scale: ResidualScale
    inputs: Vector
    """Known disturbance (p,) of the plant's inputs."""
    lasting: Vector | None = None
    """Parameters (d,) in force when the samples contradicted them after a long time; None before that."""
    is_provisional: bool = False
    """Whether parameters were written as what they left was adopted as noise, and have explained no window since."""
    rival: Vector | None = None
    """Disturbance (p,) that explained, with those that lasted, what others were written for; or None."""
    suspected_at: int = 0
    """Number of the last sample that contradicted those in force."""
    n_failures: int = 0
    """Number of failed searches, one soon after the other."""
    n_quiet: int = 0
    """Number of samples that did not contradict those in force, whatever came between; after 200 it begins again."""
    n_calm: int = 0
    """Number of samples since the last that contradicted those in force, or that rested."""
    restless_since: int = 0
    """Number of the first sample that contradicted those in force after some quiet."""
    n_samples: int = 0
    rests_until: int = 0
    """Number of the sample at which a rest ends."""
    counts: Counter[str] = field(default_factory=Counter[str])
    """Number of events of each kind."""
    named: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])
    """The newest disturbances with their times [s] and sizes; replaced, never changed."""
    unexplained: "Unexplained | None" = None
    """The last failed search, until what it left has passed; None where there is none."""
    rested: list[Vector] = field(default_factory=list[Vector])
    """Residuals (c,) at the parameters in force since the last rest began."""
    resting: RestingResiduals = field(default_factory=RestingResiduals)
    """Their sizes."""


@dataclass(frozen=True)
class Unexplained:
    """Sequence that neither parameters nor a constant disturbance explained."""

    inputs: Vector
    """Disturbance (p,) of the inputs that came closest."""
    n_steps: int
    """Number of samples of the sequence: as many quiet ones show that the disturbance has passed."""
    held: Vector
    """Parameters (d,) that were returned to."""
    rows: Vector
    """Their residuals (n, c), in standard deviations of the declared noise; NaN where an output was not measured."""
