"""When an idle loop begins an episode: the paper's tracking error, or samples that contradict what is in force."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from . import Sample, Vector, chi2_limit


class Trigger(Protocol):
    """Decides whether an idle loop begins an episode."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """The reason to begin, or None. tracking_error: norm over the tracked outputs; theta: what is in force."""
        ...


@dataclass(frozen=True)
class TrackingTrigger:
    """The paper's: the tracking error reaches a threshold."""

    threshold: float
    """tau_e, in the norm of the tracked outputs' unit."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """A reason where tracking_error >= threshold."""
        if tracking_error < self.threshold:
            return None
        return f"tracking error {tracking_error:.4g} reached {self.threshold:g}"


@dataclass(frozen=True)
class InnovationTrigger:
    """The newest sample contradicts the parameters in force: sees a jump within one sample.

    The normalised innovation squared |r|^2 of the whitened residual exceeds its chi-square limit.
    Bar-Shalom, Li, Kirubarajan (2001), section 5.4.
    """

    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of one sample."""
    false_alarm: float
    """Probability of firing on one sample where nothing has changed."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """A reason where |r|^2 exceeds the limit."""
        r = self.residual(theta, sample)
        squared, limit = float(r @ r), chi2_limit(self.false_alarm, len(r))
        if squared <= limit:
            return None
        return f"normalised innovation squared {squared:.4g} exceeds {limit:.4g}"


@dataclass(frozen=True)
class WindowTrigger:
    """The same for residuals of several samples: those since some place contradict the parameters in force."""

    residual: Callable[[Vector], Vector]
    """Whitened residual (D,) of theta, on as many samples as there are; empty where it cannot be told."""
    false_alarm: float
    """Probability of firing on these samples where nothing has changed."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """A reason where |r|^2 exceeds the limit."""
        r = self.residual(theta)
        squared, limit = float(r @ r), chi2_limit(self.false_alarm, len(r)) if len(r) else math.inf
        if squared <= limit:
            return None
        return f"squared residuals of {len(r)} values, {squared:.4g}, exceed {limit:.4g}"


@dataclass(frozen=True)
class AlwaysTrigger:
    """For recursive estimators: at the first sample begins the one episode."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Always a reason."""
        return "every sample"
