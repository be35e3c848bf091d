"""The summary of a study: figures by scenario and estimator, and what re-tuning made better or worse."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import binomtest

NOMINAL: Final = "none"
"""Estimator that the others are compared with: the nominal controller."""
ALIKE: Final = 0.01
"""A run is better or worse than the nominal controller's if its mean squared error differs by more than this part."""
MOST_WORST: Final = 10
CONFIDENCE: Final = 0.95
Values = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Share:
    """A share of runs with its interval by Clopper and Pearson (1934), who make it exact: never too narrow."""

    n: int
    """Runs that are so."""
    of: int
    """Runs that were compared."""

    @property
    def interval(self) -> tuple[float, float]:
        """Limits of the interval, at 95 %."""
        found = binomtest(self.n, self.of).proportion_ci(CONFIDENCE, method="exact")
        return float(found.low), float(found.high)

    def __str__(self) -> str:
        if not self.of:
            return "-"
        low, high = self.interval
        return f"{self.n / self.of:.1%} [{low:.1%}, {high:.1%}]"


@dataclass(frozen=True)
class StudyRow:
    """Figures of one estimator in one scenario, over points and seeds."""

    scenario: str
    """Name of the scenario."""
    estimator: str
    """Name of the estimator."""
    statuses: Mapping[str, int]
    """Number of runs by status."""
    mse: tuple[float, float, float]
    """Median, 95 % quantile and largest mean squared error, summed over outputs, of the runs that are done."""
    ratio: float
    """Median of its ratio to the nominal controller's at the same point with the same seed; NaN without one."""
    better: Share
    """Runs that re-tuning made better."""
    worse: Share
    """Runs that it made worse: also those that are not done, although the nominal controller's is."""


@dataclass(frozen=True)
class StudySummary:
    """A study's table, compared with the nominal controller."""

    columns: Mapping[str, Values]
    """Columns of the table that are looked at, by name."""
    ratio: Values
    """Ratio of each run's mean squared error to the nominal controller's (n,); NaN where there is none."""
    is_compared: Values
    """True for each run (n,) of which it is known whether re-tuning made it better or worse."""
    is_better: Values
    """True for each run (n,) that re-tuning made better."""
    is_worse: Values
    """True for each run (n,) that re-tuning made worse."""

    def rows(self) -> list[StudyRow]:
        """Return the figures of each estimator in each scenario, in the order of the table."""
        scenario, estimator = self.columns["scenario"], self.columns["estimator"]
        pairs = dict.fromkeys(zip(scenario.tolist(), estimator.tolist(), strict=True))
        return [self._row(s, e, (scenario == s) & (estimator == e)) for s, e in pairs]

    def worst(self) -> list[int]:
        """Return the numbers of the worst runs of an estimator: those that did not end, then by ratio, or by error."""
        chosen = np.flatnonzero(~np.isin(self.columns["estimator"], (NOMINAL, "true")))
        status, mse, ratio = (a[chosen] for a in (self.columns["status"], self.columns["mse"], self.ratio))
        badness = np.where(np.isnan(ratio), np.nan_to_num(mse, nan=-1.0), ratio) if np.isnan(ratio).all() else ratio
        badness = np.where(np.isin(status, ("diverged", "faulted")), np.inf, np.nan_to_num(badness, nan=-1.0))
        badness = np.where(np.isin(status, ("queued", "leased", "refused", "lost")), -1.0, badness)
        order = np.argsort(-badness, kind="stable")
        return [int(chosen[k]) for k in order[:MOST_WORST] if badness[k] >= 0.0]

    def _row(self, scenario: str, estimator: str, chosen: Values) -> StudyRow:
        statuses, counts = np.unique(self.columns["status"][chosen].astype(str), return_counts=True)
        mse = self.columns["mse"][chosen & (self.columns["status"] == "done")]
        known = mse[np.isfinite(mse)]
        quantiles = np.quantile(known, [0.5, 0.95, 1.0]).tolist() if len(known) else [np.nan] * 3
        ratio = self.ratio[chosen]
        n = int(self.is_compared[chosen].sum())
        return StudyRow(
            scenario, estimator, dict(zip(statuses.tolist(), counts.tolist(), strict=True)),
            (quantiles[0], quantiles[1], quantiles[2]),
            float(np.median(ratio[np.isfinite(ratio)])) if np.isfinite(ratio).any() else np.nan,
            Share(int(self.is_better[chosen].sum()), n), Share(int(self.is_worse[chosen].sum()), n),
        )  # fmt: skip


def summarised(table: Any, names: Sequence[str] = ()) -> StudySummary:
    """Return the summary of a table; names: of further columns to keep."""
    wanted = dict.fromkeys(("scenario", "point", "seed", "estimator", "status", "mse", "largest error", *names))
    columns: dict[str, Values] = {
        name: table[name].to_numpy(zero_copy_only=False) if name in table.column_names else np.full(len(table), np.nan)
        for name in wanted
    }
    for name in ("mse", "largest error"):
        columns[name] = columns[name].astype(float)
    nominal = _nominal_of(columns)
    has_one = nominal >= 0
    is_done, mse = columns["status"] == "done", columns["mse"]
    has_ended = np.isin(columns["status"], ("done", "diverged", "faulted"))
    is_nominal_done = has_one & is_done[nominal]
    with np.errstate(all="ignore"):
        ratio = np.where(is_done & is_nominal_done, mse / mse[nominal], np.nan)
    is_compared = has_one & has_ended & has_ended[nominal] & (columns["estimator"] != NOMINAL)
    is_better = is_compared & is_done & (~is_nominal_done | (ratio < 1.0 - ALIKE))
    is_worse = is_compared & is_nominal_done & (~is_done | (ratio > 1.0 + ALIKE))
    return StudySummary(columns, ratio, is_compared, is_better, is_worse)


def _nominal_of(columns: Mapping[str, Values]) -> Values:
    """Return for each run (n,) the number of the nominal controller's at the same point with the same seed, or -1.

    No noise reaches the nominal controller: where it was not run with that seed, its first one counts.
    """
    _, scenario = np.unique(columns["scenario"].astype(str), return_inverse=True)
    triples = np.stack([scenario, columns["point"].astype(np.int64), columns["seed"].astype(np.int64)], axis=1)
    _, place = np.unique(triples, axis=0, return_inverse=True)
    found = np.full(int(place.max(initial=0)) + 1, -1)
    of_nominal = np.flatnonzero(columns["estimator"] == NOMINAL)
    found[place.reshape(-1)[of_nominal]] = of_nominal
    _, point = np.unique(triples[:, :2], axis=0, return_inverse=True)
    first = np.full(int(point.max(initial=0)) + 1, -1)
    first[point.reshape(-1)[of_nominal[::-1]]] = of_nominal[::-1]
    same = found[place.reshape(-1)]
    return np.where(same >= 0, same, first[point.reshape(-1)])
