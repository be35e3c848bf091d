"""What a run's estimator believed in the end, for the report and the result."""

from dataclasses import dataclass
from typing import Any

from estimator import Estimate, ParameterSpace
from estimator.identifiability_report import findings


@dataclass(frozen=True)
class FinalEstimate:
    """The estimate at the end of a run's last episode that ended; where none did, the last one."""

    t: float
    """Communication point [s]."""
    names: tuple[str, ...]
    """Of the parameters (d,)."""
    units: tuple[str, ...]
    """FMI unit strings (d,)."""
    values: tuple[float, ...]
    """Estimates (d,); the controller may hold others."""
    std: tuple[float, ...]
    """Root mean square errors (d,)."""
    is_identifiable: tuple[bool, ...]
    """Whether the data fixed each parameter (d,)."""
    findings: tuple[str, ...]
    """On bounds and on directions that the data did not fix, a sentence each."""

    def to_json(self) -> dict[str, Any]:
        """JSON values."""
        columns = zip(self.names, self.units, self.values, self.std, self.is_identifiable, strict=True)
        keys = ("name", "unit", "value", "std", "is_identifiable")
        return {
            "t": self.t,
            "parameters": [dict(zip(keys, column, strict=True)) for column in columns],
            "findings": list(self.findings),
        }


def belief(t: float, estimate: Estimate, space: ParameterSpace, identifiable_below: float) -> FinalEstimate:
    """What an estimate at t [s] says, and what its data say of it."""
    told = estimate.information and findings(estimate.information, space, estimate.theta, identifiable_below)
    return FinalEstimate(
        t,
        space.names,
        tuple(p.unit for p in space),
        tuple(estimate.theta.tolist()),
        tuple(estimate.std.tolist()),
        estimate.is_identifiable,
        tuple(told or ()),
    )


def final_estimate_from_json(told: dict[str, Any] | None) -> FinalEstimate | None:
    """The belief that `to_json` gave; None of none."""
    if told is None:
        return None
    names, units, values, std, known = (
        tuple(p[key] for p in told["parameters"]) for key in ("name", "unit", "value", "std", "is_identifiable")
    )
    return FinalEstimate(told["t"], names, units, values, std, known, tuple(told["findings"]))
