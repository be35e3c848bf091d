"""The table on what may be written into the controller."""

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from .table import MOST, Table


class GuardSettings(Table):
    """What may be written into the controller, and what is taken back. Shares are of the scaled bounds."""

    former_keys: ClassVar[Mapping[str, str]] = {"guard.foresight": "guard.lookahead"}

    enabled: bool = True
    """Whether writes are guarded."""
    rate: float = Field(default=0.5, gt=0.0, le=1.0)
    """Most that a parameter may move in a macro step, as a share."""
    material: float = Field(default=0.05, ge=0.0, le=1.0)
    """Smaller changes since the last one looked into are neither predicted nor put on probation, as a share."""
    unseen: float = Field(default=0.35, gt=0.0, le=1.0)
    """A direction of which the standard deviation exceeds this share is not seen by the data, and not written."""
    lookahead: bool = True
    """Whether the closed loop is rolled ahead before a material write."""
    horizon: int = Field(default=50, ge=1, le=MOST)
    """Macro steps that it is rolled ahead."""
    n_std: float = Field(default=2.0, ge=0.0)
    """Standard deviations by which the estimate is widened for it, along the worst direction."""
    growth: float = Field(default=1.5, ge=1.0)
    """Predicted peaks of the tracking error may exceed that without the write, and errors the predicted, by this."""
    tolerance: float | None = Field(default=None, gt=0.0)
    """A tracking error below it is never a reason to revert, in the norm of the tracked outputs; none: a hundredth of
    limits.divergence."""
    probation: int = Field(default=100, ge=1, le=MOST)
    """Macro steps for which the tracking error is watched after a write."""
    reverts: int = Field(default=3, ge=1, le=MOST)
    """Reverts after which re-tuning stops, with the parameters of the start."""
