"""Search for a constant disturbance of the plant's inputs that explains a sequence of samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..episode_window import EpisodeWindow
from ..hypotheses import NEVER, Fit, plain_fit
from ..space import Vector

_ASIDE: Final = 0.01
"""First step of differences in an input, as a share of its largest size."""
_SMALL, _LARGE = 0.01, 10.0
"""Root mean square moves of the residual, in standard deviations, that such a step may make."""


@dataclass(frozen=True)
class DisturbedInputs:
    """Sequence explained by the parameters in force and a constant disturbance of the inputs."""

    inputs: Vector
    """Disturbance (p,); 0 where none has an effect."""
    fit: Fit


def disturbed_inputs(window: EpisodeWindow, theta: Vector, driven: Sequence[int], n_inputs: int) -> DisturbedInputs:
    """Return the disturbance that explains a window's sequence best with theta (d,), by two Gauss-Newton steps.

    driven: places of the inputs that it may act on, of n_inputs.
    """
    d = np.zeros(n_inputs)
    residual = window.whitened(theta)
    if not driven or not np.all(np.isfinite(residual)):
        return DisturbedInputs(d, NEVER)
    slopes = np.column_stack([_slope(window, theta, i, n_inputs, residual) for i in driven])
    if not np.all(np.isfinite(slopes)) or not np.any(slopes):
        return DisturbedInputs(d, NEVER)
    best = plain_fit(residual, len(driven), len(residual))
    for _ in range(2):
        tried = d.copy()
        tried[driven] -= np.linalg.lstsq(slopes, residual, rcond=1e-7)[0]
        residual_there = window.with_inputs(theta, tried)
        fit = plain_fit(residual_there, len(driven), len(residual_there))
        if not fit.squares < best.squares:
            break
        d, residual, best = tried, residual_there, fit
    return DisturbedInputs(d, best)


def _slope(window: EpisodeWindow, theta: Vector, i: int, n_inputs: int, residual: Vector) -> Vector:
    """Return the slope (D,) of the residual at theta (d,) in input i, by a difference of that input.

    The difference is a hundredth of the largest input. Where that moves the residual by far more or less than noise
    does, it is taken again, so that input's unit does not matter.
    """
    step = _ASIDE * (window.largest_inputs()[i] or 1.0)
    aside = np.eye(n_inputs)[i]
    move = window.with_inputs(theta, step * aside) - residual
    size = float(np.sqrt(np.mean(move**2)))
    if size > 0.0 and not _SMALL < size < _LARGE:
        step = step / size if np.isfinite(size) else step * _SMALL
        move = window.with_inputs(theta, step * aside) - residual
    return move / step
