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
_MOST: Final = 20
"""Most Gauss-Newton steps."""
_ENOUGH: Final = 0.1
"""Gain of the sum of squares below which the search ends."""
_MUCH: Final = 0.5
"""Share of the sum of squares that a step must fall below for the next one to keep its slopes."""


@dataclass(frozen=True)
class DisturbedInputs:
    """Sequence explained by the parameters in force and a constant disturbance of the inputs."""

    inputs: Vector
    """Disturbance (p,); 0 where none has an effect."""
    fit: Fit


def disturbed_inputs(window: EpisodeWindow, theta: Vector, driven: Sequence[int], n_inputs: int) -> DisturbedInputs:
    """Return the disturbance that explains a window's sequence best with theta (d,), by Gauss-Newton steps.

    driven: places of the inputs that it may act on, of n_inputs. Slopes are computed anew where a step from the last
    ones leaves something to explain, as where a state grows fast or the model is not linear in its inputs.
    """
    d = np.zeros(n_inputs)
    residual = window.whitened(theta)
    if not driven or not np.all(np.isfinite(residual)):
        return DisturbedInputs(d, NEVER)
    best = plain_fit(residual, len(driven), len(residual))
    slopes, is_new = _slopes(window, theta, d, driven, residual), True
    if slopes is None:
        return DisturbedInputs(d, NEVER)
    for _ in range(_MOST):
        before, tried = best.squares, d.copy()
        tried[driven] -= np.linalg.lstsq(slopes, residual, rcond=1e-7)[0]
        there = window.with_inputs(theta, tried)
        fit = plain_fit(there, len(driven), len(there))
        if fit.squares < before:
            d, residual, best = tried, there, fit
        if best.squares > before - _ENOUGH and (is_new or best.is_explained):
            break
        is_new = best.squares > _MUCH * before
        slopes = _slopes(window, theta, d, driven, residual) if is_new else slopes
        if slopes is None:
            break
    return DisturbedInputs(d, best)


def _slopes(window: EpisodeWindow, theta: Vector, d: Vector, driven: Sequence[int], residual: Vector) -> Vector | None:
    """Return the slopes (D, m) of the residual in each driven input; None where there are none."""
    slopes = np.column_stack([_slope(window, theta, d, i, residual) for i in driven])
    return slopes if np.all(np.isfinite(slopes)) and np.any(slopes) else None


def _slope(window: EpisodeWindow, theta: Vector, d: Vector, i: int, residual: Vector) -> Vector:
    """Return the slope (D,) of the residual, which inputs moved by d (p,) leave, in input i.

    By a difference of a hundredth of the largest input. Where that moves the residual by far more or less than noise
    does, it is taken again, so that input's unit does not matter.
    """
    step = _ASIDE * (window.largest_inputs()[i] or 1.0)
    aside = np.eye(len(d))[i]
    move = window.with_inputs(theta, d + step * aside) - residual
    size = float(np.sqrt(np.mean(move**2)))
    if size > 0.0 and not _SMALL < size < _LARGE:
        step = step / size if np.isfinite(size) else step * _SMALL
        move = window.with_inputs(theta, d + step * aside) - residual
    return move / step
