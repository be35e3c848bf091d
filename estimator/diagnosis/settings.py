"""Settings of a diagnosis, and what the diagnosis of samples and that of sequences have in common."""

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from ..hypotheses import n_channels_of
from ..significance import SAMPLE_FALSE_ALARM, chi2_limit
from ..space import ParameterSpace, Vector

PATIENCE: Final = 3
"""Number of failed searches, one soon after the other, after which re-tuning rests."""
FORGOTTEN: Final = 200
"""Number of quiet samples after which one failed search is forgotten."""
BETTER: Final = 0.5
"""Share of the sum of squares of the parameters in force, at the newest samples, that better ones may have."""
_LITTLE: Final = 1e-6
"""Distance, as a share of the scaled bounds, that is none."""
_MOVED: Final = 0.02
"""Share of the scaled bounds by which an unseen parameter may move even so."""
_WIDE: Final = 0.5
"""Standard deviation, as a share of the scaled bounds, that says nothing."""
_MOST: Final = 1_000_000_000
"""Largest number of samples of a rest: more is a mistake."""
LONG: Final = 6
"""Least number of samples since the onset on which parameters, or a lag, are accepted."""
FEWEST: Final = 3
"""Least number of samples that name a disturbance, or its end."""
QUIET: Final = 5
"""Number of newest samples that the parameters in force must explain for a suspicion to end."""
PASSED: Final = "a disturbance has passed: the parameters before it explain the samples again"
"""Reason of a disturbance that is named when it is over."""
CALM: Final = "the parameters in force had explained the samples for as long as they had not"
"""Reason of the end of a rest."""
MOST_NAMED: Final = 20
"""Largest number of disturbances in the summary."""
KINDS: Final = ("disturbance", "lag", "friction", "unexplained", "rest")
"""Kinds of events of a diagnosis."""
Judgement = Literal["warranted", "possible", "refuted"]
"""Changed parameters are warranted; possible beside a disturbance; refuted, or too few samples to tell."""


@dataclass(frozen=True, kw_only=True)
class DiagnosisSettings:
    """Settings of the diagnosis: its false alarms, and its rests after what nothing explains."""

    enabled: bool = True
    """True to write parameters only where they explain the samples and nothing else does as well."""
    false_alarm: float = field(default=SAMPLE_FALSE_ALARM, metadata={"gt": 0.0, "lt": 1.0})
    """Probability that a sample seems to contradict the parameters in force although nothing has changed."""
    rest: int = field(default=1000, metadata={"ge": 1, "le": _MOST})
    """Number of samples for which channels rest that nothing explained three times; each further time twice as many."""
    longest_rest: int = field(default=16000, metadata={"ge": 1, "le": _MOST})
    """Largest number of samples of a rest."""

    def __post_init__(self) -> None:
        if not 0.0 < self.false_alarm < 1.0:
            raise ValueError(f"false_alarm must be between 0 and 1, got {self.false_alarm}.")
        if not 1 <= self.rest <= self.longest_rest <= _MOST:
            raise ValueError(f"rest must be from 1 to longest_rest, got {self.rest} and {self.longest_rest}.")

    def is_usual(self, residual: Vector, n_sampled: int) -> bool:
        """Return whether the residual (c,) of a sample, on n_sampled channels, does not contradict the parameters."""
        return not n_sampled or float(residual @ residual) <= chi2_limit(self.false_alarm, n_sampled)

    def n_unusual(self, rows: Vector) -> int:
        """Return how many of n samples contradict the parameters by their residuals (n, c)."""
        n_sampled = n_channels_of(rows)
        return sum(not self.is_usual(row, n_sampled) for row in rows)

    def rest_length(self, n_failures: int) -> int:
        """Return the number of samples of the rest after so many failed searches, three or more."""
        return min(self.rest * 2 ** min(n_failures - PATIENCE, 20), self.longest_rest)


def is_at_unseen_bound(space: ParameterSpace, theta: Vector, std: Vector, held: Vector, may_move: bool = True) -> bool:
    """Return whether a parameter has moved from held (d,) to a bound, with a std as wide as the bounds.

    may_move: False where it may not move at all then.
    """
    z = space.to_unit(theta)
    is_at_bound = (z < _LITTLE) | (z > 1.0 - _LITTLE)
    moved = np.abs(z - space.to_unit(held))
    is_forbidden = moved > np.where(is_at_bound, _LITTLE, np.inf if may_move else _MOVED)
    return bool(np.any(is_forbidden & (std >= _WIDE * space.slope(theta))))
