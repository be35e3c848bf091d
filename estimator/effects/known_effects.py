"""Effects on the plant beside its model: a disturbance, late or limited inputs, friction."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..hypotheses import Fit
from ..samples import Sample, Samples
from ..space import Vector
from .friction import FoundFriction, Friction
from .input_lag import FoundLag, Inputs


@dataclass(frozen=True)
class KnownEffects:
    """Known effects, which are taken out of a sample before the model is compared with it."""

    disturbance: Vector
    """Constant disturbance (c,) of the sampled derivatives, in their units."""
    arriving: Inputs
    """Inputs that arrive at the plant where they are not those that were sent."""
    friction: Friction
    is_resting: NDArray[np.bool_]
    """True for each channel (c,) that is left out."""

    def on_all_channels(self) -> "KnownEffects":
        """Return the effects without the disturbance, with no channel that rests."""
        none = np.zeros_like(self.disturbance)
        return replace(self, disturbance=none, is_resting=none.astype(bool))

    def __bool__(self) -> bool:
        return bool(
            self.arriving or self.friction or np.count_nonzero(self.disturbance) or np.count_nonzero(self.is_resting)
        )

    def without(self, sample: Sample) -> Sample:
        """Return the sample without them; NaN for channels that rest, or whose friction is not known."""
        xdot = np.where(self.is_resting, np.nan, np.array(sample.xdot) - self.disturbance)
        left = replace(sample, u=self.arriving.get(sample.t, sample.u), xdot=tuple(xdot.tolist()))
        return self.friction.without(left) if self.friction else left

    def without_all(self, samples: Sequence[Sample]) -> Samples:
        """Return samples without them, each as `without` does."""
        return Samples(map(self.without, samples) if self else samples)


@dataclass(frozen=True)
class Explanation:
    """Effect on the plant that its model lacks, and that explains samples with parameters and a disturbance."""

    found: FoundLag | FoundFriction
    theta: Vector
    """Parameters (d,) with which it does."""
    offset: Vector
    """Disturbance (c,) with which it does, in standard deviations of the declared noise."""
    n: int
    """Number of samples."""

    @property
    def has_limits(self) -> bool:
        """True where it is a limited or stuck input."""
        return isinstance(self.found, FoundLag) and bool(self.found.lag.limits)

    @property
    def fit(self) -> Fit:
        """Fit to the samples."""
        return self.found.fit
