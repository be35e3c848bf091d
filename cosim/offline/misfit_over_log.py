"""Misfit of an estimation part by part of the log: where the model fails."""

from typing import Final, NamedTuple

import numpy as np

from .estimate import Estimation

_PARTS: Final = 10
"""Number of parts of equal duration that each window is divided into."""
_FAILS: Final = 2.0
"""Ratio of the worst part's misfit to the median one, and to the noise, from which it is told."""


class PartMisfit(NamedTuple):
    """Root mean square residual of an output over a part of a window, in standard deviations of the noise."""

    window: int
    """Number of the window, from 0 on."""
    output: str
    begin: float
    """Time of the log [s]."""
    end: float
    is_held_out: bool
    misfit: float


def misfit_over_log(found: Estimation) -> list[PartMisfit]:
    """Return the misfit with the estimates of each output in each part of each window; empty parts are left out."""
    parts: list[PartMisfit] = []
    for number, (window, simulated) in enumerate(zip(found.windows, found.after, strict=True)):
        if simulated is None:
            continue
        residuals = found.fit.loss.shrunk((simulated - window.measured) / found.noise)
        edges = np.linspace(window.time[0], window.time[-1], _PARTS + 1)
        part = np.clip(np.searchsorted(edges, window.time, side="right") - 1, 0, _PARTS - 1)
        for k in range(_PARTS):
            rows = np.flatnonzero(part == k)
            for name, r in zip(found.request.measured, residuals[rows].T, strict=True):
                known = r[np.isfinite(r)]
                if len(known):
                    begin, end = float(edges[k]), float(edges[k + 1])
                    is_held_out = bool(rows[0] >= window.n_fit)
                    parts.append(PartMisfit(number, name, begin, end, is_held_out, float(np.sqrt(np.mean(known**2)))))
    return parts


def worst_part(found: Estimation) -> str | None:
    """Return a sentence on the part of the log that the model explains worst, if it stands out."""
    parts = misfit_over_log(found)
    if not parts:
        return None
    worst, usual = max(parts, key=lambda part: part.misfit), float(np.median([part.misfit for part in parts]))
    if worst.misfit < _FAILS * max(usual, 1.0):
        return None
    where = f" of {found.windows[worst.window].name}" if len(found.windows) > 1 else ""
    return (
        f"The model fails most from {worst.begin:.4g} to {worst.end:.4g} s{where}: the residuals of {worst.output} are "
        f"{worst.misfit:.2g} times the noise there, and {usual:.2g} times in the median part of the log."
    )
