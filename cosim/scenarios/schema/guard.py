"""Table of a scenario file on the guard of what is written into the controller."""

from collections.abc import Mapping
from typing import ClassVar

from pydantic import Field

from .table import MOST, Table


class GuardSettings(Table):
    """Limits on what is written into the controller, and rules for reverting it. Shares are of the scaled bounds."""

    former_keys: ClassVar[Mapping[str, str]] = {"guard.foresight": "guard.lookahead"}

    enabled: bool = True
    """True to guard writes."""
    rate: float = Field(default=0.5, gt=0.0, le=1.0)
    """Largest change of a parameter in a macro step, as a share."""
    material: float = Field(default=0.05, ge=0.0, le=1.0)
    """Change since the last predicted write, as a share, below which a write is not watched, and rarely predicted."""
    unseen: float = Field(default=0.35, gt=0.0, le=1.0)
    """Standard deviation, as a share, above which a direction counts as unseen by the data and is not written."""
    lookahead: bool = True
    """True to simulate the closed loop ahead before a material write."""
    horizon: int = Field(default=50, ge=1, le=MOST)
    """Macro steps that are simulated ahead."""
    n_std: float = Field(default=2.0, ge=0.0)
    """Standard deviations by which the estimate is varied in that prediction, along the least certain direction."""
    growth: float = Field(default=1.5, ge=1.0)
    """Factor by which the predicted peak of the tracking error may exceed that without the write, and the error then
    the predicted one."""
    tolerance: float | None = Field(default=None, gt=0.0)
    """Tracking error below which no write is reverted, in the norm of the tracked outputs; by default a hundredth of
    `limits.divergence`. Where a disturbance explains the samples as well, `growth` times the largest error of late is
    tolerated, if that is less."""
    probation: int = Field(default=100, ge=1, le=MOST)
    """Macro steps for which the tracking error is watched after a write."""
    reverts: int = Field(default=3, ge=1, le=MOST)
    """Reverts after which re-tuning stops, with the parameters of the start; one in the rest after another is none."""

    def tolerance_at(self, divergence: float) -> float:
        """Return the tolerance that holds where `limits.divergence` is this."""
        return 0.01 * divergence if self.tolerance is None else self.tolerance
