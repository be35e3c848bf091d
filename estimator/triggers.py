"""Conditions on which an idle loop begins an episode: a tracking error, or samples that contradict the parameters.

A trigger is two classes and a row of `TRIGGERS`: the trigger itself, and its settings, from which the scenario's
table, the parameters of an estimator FMU and the threshold in the figures are made.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Literal, Protocol, get_args

from .samples import Sample
from .significance import SAMPLE_FALSE_ALARM, chi2_limit
from .space import Vector


class Trigger(Protocol):
    """Condition on which an idle loop begins an episode."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return the reason to begin, or None. tracking_error: norm over the tracked outputs; theta: in force."""
        ...


@dataclass(frozen=True)
class TrackingTrigger:
    """Trigger of the paper: the tracking error reaches a threshold."""

    threshold: float
    """Threshold tau_e, in the unit of the tracked outputs' norm."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return a reason where tracking_error >= threshold, else None."""
        if tracking_error < self.threshold:
            return None
        return f"tracking error {tracking_error:.4g} reached {self.threshold:g}"


@dataclass(frozen=True)
class InnovationTrigger:
    """Trigger on a sample that contradicts the parameters in force: it detects a jump within one sample.

    The normalised innovation squared |r|^2 of the whitened residual exceeds its chi-square limit.
    Bar-Shalom, Li, Kirubarajan (2001), section 5.4.
    """

    residual: Callable[[Vector, Sample], Vector]
    """Whitened residual (c,) of theta on one sample, or on those that end with it; empty where there is none."""
    false_alarm: float
    """Probability of firing on one sample where nothing has changed."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return a reason where |r|^2 exceeds the limit, else None."""
        r = self.residual(theta, sample)
        squared, limit = float(r @ r), chi2_limit(self.false_alarm, len(r)) if len(r) else math.inf
        if squared <= limit:
            return None
        return f"normalised innovation squared {squared:.4g} exceeds {limit:.4g}"


@dataclass(frozen=True)
class AlwaysTrigger:
    """Trigger for recursive estimators: the only episode begins at the first sample."""

    def __call__(self, sample: Sample, tracking_error: float, theta: Vector) -> str | None:
        """Return a reason, always."""
        return "every sample"


def _limited(description: str, *, gt: float, lt: float | None = None, is_error: bool = False) -> dict[str, Any]:
    """Return metadata of a number: `gt`, `lt` and `description` as in pydantic, and `is_tracking_error`."""
    limits = {"gt": gt} if lt is None else {"gt": gt, "lt": lt}
    return {**limits, "description": description, "is_tracking_error": is_error}


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """Trigger on the tracking error."""

    kind: Literal["tracking"] = "tracking"
    """tracking"""
    threshold: float = field(
        metadata=_limited("Tracking error at which an episode of estimation begins", gt=0.0, is_error=True)
    )
    """Threshold tau_e, in the unit of the tracked outputs' norm."""
    is_endless: ClassVar = False

    @property
    def tracking_error(self) -> float:
        """Tracking error that begins an episode."""
        return self.threshold

    def trigger(self, residual: Callable[[Vector, Sample], Vector]) -> Trigger:
        """Return the trigger of these settings."""
        return TrackingTrigger(self.threshold)


@dataclass(frozen=True, kw_only=True)
class InnovationSettings:
    """Trigger on the residual of the newest sample."""

    kind: Literal["innovation"] = "innovation"
    """innovation"""
    false_alarm: float = field(
        default=SAMPLE_FALSE_ALARM,
        metadata=_limited(
            "Probability that a sample begins an episode of estimation although nothing has changed", gt=0.0, lt=1.0
        ),
    )
    """Probability of firing on one sample where nothing has changed."""
    is_endless: ClassVar = False
    tracking_error: ClassVar = None

    def trigger(self, residual: Callable[[Vector, Sample], Vector]) -> Trigger:
        """Return the trigger of these settings; residual: whitened, of theta on the samples that end with one."""
        return InnovationTrigger(residual, self.false_alarm)


@dataclass(frozen=True, kw_only=True)
class AlwaysSettings:
    """One episode from the first sample to the end, for recursive estimators."""

    kind: Literal["always"] = "always"
    """always"""
    is_endless: ClassVar = True
    tracking_error: ClassVar = None

    def trigger(self, residual: Callable[[Vector, Sample], Vector]) -> Trigger:
        """Return the trigger of these settings."""
        return AlwaysTrigger()


TriggerSettings = TrackingSettings | InnovationSettings | AlwaysSettings
"""Settings of any trigger. Each has, beside its fields: `is_endless`, true where its one episode lasts to the
end of the run; `tracking_error`, the one that begins an episode, or None; and `trigger`, which makes the trigger."""
TRIGGERS: Final[Mapping[str, Callable[..., TriggerSettings]]] = {
    settings.__dataclass_fields__["kind"].default: settings for settings in get_args(TriggerSettings)
}
"""Classes of settings by `kind`."""
