"""The final estimate of a run, for the report and the result."""

from dataclasses import dataclass, replace
from typing import Any, Final

from estimator import Estimate, ParameterSpace
from estimator.identifiability import IDENTIFIABLE_BELOW
from estimator.offline.identifiability_report import findings

from ..retuning.decision import Decision
from ..retuning.estimators import find_method
from ..scenarios.scenario import Scenario

_UNDONE: Final = "It has been taken back: other parameters, or none that have changed, explain the samples."


@dataclass(frozen=True)
class FinalEstimate:
    """The last estimate that a completed episode, or a sample after it, gave; where there is none, the last of all."""

    t: float
    """Communication point [s]."""
    names: tuple[str, ...]
    """Names of the parameters (d,)."""
    units: tuple[str, ...]
    """FMI unit strings (d,)."""
    values: tuple[float, ...]
    """Estimates (d,); the controller may hold others."""
    std: tuple[float, ...]
    """Root mean square errors (d,)."""
    is_identifiable: tuple[bool, ...]
    """True for each parameter that the data identify (d,)."""
    findings: tuple[str, ...]
    """Findings on bounds and on directions that the data do not identify, a sentence each."""

    def to_json(self) -> dict[str, Any]:
        """Return the estimate as JSON values."""
        columns = zip(self.names, self.units, self.values, self.std, self.is_identifiable, strict=True)
        keys = ("name", "unit", "value", "std", "is_identifiable")
        return {
            "t": self.t,
            "parameters": [dict(zip(keys, column, strict=True)) for column in columns],
            "findings": list(self.findings),
        }


class EstimateTracker:
    """Memory of the last estimate outside an unfinished episode; until one is completed, of the newest estimate."""

    def __init__(self, scenario: Scenario, estimator: str) -> None:
        """estimator: name of the estimator that re-tunes."""
        self._space = scenario.estimation.space
        self._identifiable_below = IDENTIFIABLE_BELOW
        if estimator not in ("none", "true"):
            settings = scenario.estimation.settings(estimator, find_method(estimator, scenario))
            self._identifiable_below = getattr(settings, "identifiable_below", IDENTIFIABLE_BELOW)
        self._newest: tuple[float, Estimate] | None = None
        self._has_ended = self._is_undone = False

    def take(self, t: float, decision: Decision) -> None:
        """Take the decision made at t [s]."""
        kinds = {event.kind for event in decision.events}
        is_complete = "end" in kinds or "candidate" not in kinds
        if decision.estimate is not None and (is_complete or not self._has_ended):
            self._newest, self._has_ended, self._is_undone = (t, decision.estimate), is_complete, False
        self._is_undone |= "undo" in kinds

    def final(self) -> FinalEstimate | None:
        """Return the estimate that is kept; None where nothing was estimated."""
        if self._newest is None:
            return None
        found = final_estimate(*self._newest, self._space, self._identifiable_below)
        return replace(found, findings=(_UNDONE,)) if self._is_undone else found


def final_estimate(t: float, estimate: Estimate, space: ParameterSpace, identifiable_below: float) -> FinalEstimate:
    """Return an estimate at t [s] with the findings on the identifiability of its parameters."""
    known = estimate.information and findings(estimate.information, space, estimate.theta, identifiable_below)
    return FinalEstimate(
        t,
        space.names,
        tuple(p.unit for p in space),
        tuple(estimate.theta.tolist()),
        tuple(estimate.std.tolist()),
        estimate.is_identifiable,
        tuple(known or ()),
    )


def final_estimate_from_json(content: dict[str, Any] | None) -> FinalEstimate | None:
    """Return the estimate whose `to_json` gave content."""
    if content is None:
        return None
    names, units, values, std, known = (
        tuple(p[key] for p in content["parameters"]) for key in ("name", "unit", "value", "std", "is_identifiable")
    )
    return FinalEstimate(content["t"], names, units, values, std, known, tuple(content["findings"]))
