"""Request of an offline estimation: the parameters, the FMU and its logs."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from estimator.offline.fit import OFFLINE
from estimator.offline.robust_loss import Loss
from estimator.space import Scale

from ..errors import CosimError
from ..scenarios.schema.estimation import MOST_ROLLOUTS
from .log_windows import Cut

HOLDOUT = 0.25
"""Share of each log's rows, the last ones, that parameters are not fitted to."""


class EstimateError(CosimError):
    """Error for an estimation that is impossible as requested."""


@dataclass(frozen=True)
class Sought:
    """A parameter to estimate, as the user asks for it; its unit is the FMU's."""

    name: str
    lower: float
    upper: float
    scale: Scale = "linear"


@dataclass(frozen=True)
class Request:
    """Request of an estimation: the parameters to estimate, the FMU and the logs."""

    fmu: Path
    logs: tuple[Path, ...]
    parameters: tuple[Sought, ...]
    measured: Mapping[str, str]
    """Column by output of the FMU."""
    inputs: Mapping[str, str] = field(default_factory=dict[str, str])
    """Column by input of the FMU."""
    start: Mapping[str, str | float] = field(default_factory=dict[str, "str | float"])
    """Column or value by variable: a state at the start of each window, or a parameter that is known."""
    noise: Mapping[str, float] = field(default_factory=dict[str, float])
    """Standard deviation by output, in its unit; estimated from the log where absent."""
    time: str | None = None
    """Column of time stamps."""
    time_unit: str | None = None
    """Unit of the time stamps; None: the log's, or s."""
    windows: tuple[Cut, ...] = ()
    """Parts of each log to use [s]; none: all of it."""
    validation: tuple[Path, ...] = ()
    """Logs that are held out as a whole."""
    holdout: float | None = None
    """Share of each log that is held out; None: `HOLDOUT`, or 0 where there are logs for validation."""
    step: float | None = None
    """Communication step [s]; None: from row to row."""
    method: str = "target"
    evaluations: int = 60
    """Candidates that the search may simulate."""
    seed: int = 0
    jobs: int = 1
    """Roll-outs at a time."""
    timeout: float = 10.0
    """Time that each call of the FMU may take [s]."""
    environment: tuple[str, ...] = ()
    """Environment variables that the FMU's processes are given beside those which every FMU is given."""
    own: tuple[str, ...] = ()
    """Parameters that have a value of their own in each log; the others have one for all logs."""
    loss: str = "linear"
    """SciPy's name of the loss of a residual: "linear" is its square, under the others outliers count for less."""
    f_scale: float = 1.0
    """Residual, in standard deviations of the noise, from which on it counts for less."""

    def __post_init__(self) -> None:
        if self.method not in OFFLINE:
            raise EstimateError(f"no method '{self.method}' for a log; there are {', '.join(OFFLINE)}.")
        if not (self.measured and self.parameters and self.logs):
            raise EstimateError("a log, a --parameter and a --measured output are needed, or more.")
        if self.evaluations < 1:
            raise EstimateError(f"--evaluations must be 1 or more, got {self.evaluations}.")
        if self.seed < 0:
            raise EstimateError(f"--seed must be 0 or more, got {self.seed}.")
        if not 1 <= self.jobs <= MOST_ROLLOUTS:
            raise EstimateError(f"--jobs must be from 1 to {MOST_ROLLOUTS}, got {self.jobs}.")
        if self.step is not None and not 0.0 < self.step < np.inf:
            raise EstimateError(f"--step must be positive, got {self.step:g} s.")
        if not 0.0 < self.f_scale < np.inf or (self.loss == "linear" and self.f_scale != 1.0):
            raise EstimateError(
                f"--f-scale must be positive, and goes with a --loss that is not linear, got {self.f_scale:g}."
            )
        try:
            Loss(self.loss, self.f_scale)
        except ValueError as e:
            raise EstimateError(f"{e}.") from e
        if not 0.0 < self.timeout < np.inf:
            raise EstimateError(f"--timeout must be positive, got {self.timeout:g} s.")
        if self.holdout is not None and not 0.0 <= self.holdout < 1.0:
            raise EstimateError(f"--holdout must be from 0 to below 1, got {self.holdout:g}.")
        if other := next((name for name in self.own if name not in {p.name for p in self.parameters}), None):
            raise EstimateError(f"--own {other} must be a --parameter too.")
        if self.own and self.validation:
            raise EstimateError("--own has no value for a log of --validate; hold rows out instead.")
        if low_high := next((w for w in self.windows if not w[0] < w[1]), None):
            raise EstimateError(f"--window must be FROM:TO with FROM < TO, got {low_high[0]:g}:{low_high[1]:g}.")
        bad = next((name for name, s in self.noise.items() if not (0.0 < s < np.inf and name in self.measured)), None)
        if bad is not None:
            raise EstimateError(f"--noise {bad} must be positive, and of a measured output.")

    @property
    def of_one_log(self) -> dict[str, tuple[str, Path]]:
        """Variable and log of each parameter that has a value of its own in each log, by the parameter's name."""
        names = Counter(path.name for path in self.logs)
        labels = {path: path.name if names[path.name] == 1 else str(path) for path in self.logs}
        return {f"{name} in {labels[path]}": (name, path) for name in self.own for path in self.logs}

    @property
    def constants(self) -> dict[str, float]:
        """Start values that are numbers, the same in every window."""
        return {name: float(value) for name, value in self.start.items() if not isinstance(value, str)}

    @property
    def start_columns(self) -> dict[str, str]:
        """Column by variable that starts as its column does."""
        return {name: value for name, value in self.start.items() if isinstance(value, str)}
