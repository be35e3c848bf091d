"""Pictures of what an estimator believes: the densities of the parameters, and its surrogate of the residual."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes

from estimator import Estimate, ParameterSpace, Vector

from ..runs.result import Run
from .canvas import label, tidy
from .palette import BLACK, BLUE, GREEN, RUNS

_N: Final = 201
"""Number of places at which a curve is drawn."""
_WIDE: Final = 4.0
"""Half the width of an axis in standard deviations."""
_MOST_OUTPUTS: Final = 4
"""Number of components of the residual whose surrogate is drawn."""


def plot_belief(of: Run | Estimate, space: ParameterSpace | None = None, axes: Any = None) -> Any:
    """Draw the density of each parameter, a pair of axes each; return the axes, in the form in which they were given.

    of: a run, whose final estimate is drawn with the truth, or an estimate with its space. On a log scale the density
    is that of the logarithm. What the data do not determine is drawn dashed: it is as wide as the bounds.
    Raises ValueError for a run in which nothing was estimated, for an estimate without its space, for too few axes.
    """
    theta, std, is_known, truth, space = _content(of, space)
    places, axes = _places(axes, len(space))
    for i, (place, p) in enumerate(zip(places, space, strict=False)):
        is_log = p.scale == "log"
        centre, width = (np.log(theta[i]), std[i] / theta[i]) if is_log else (theta[i], std[i])
        width = max(float(width), 1e-12)
        x = np.linspace(centre - _WIDE * width, centre + _WIDE * width, _N)
        density = np.exp(-0.5 * ((x - centre) / width) ** 2)
        values = np.exp(x) if is_log else x
        inside = (values >= p.lower) & (values <= p.upper)
        tidy(place)
        place.plot(values[inside], density[inside], color=BLUE, linestyle="-" if is_known[i] else "--", label="belief")
        place.fill_between(values[inside], density[inside], color=BLUE, alpha=0.15, linewidth=0)
        if truth is not None and np.isfinite(truth[i]):
            place.axvline(truth[i], color=GREEN, linestyle=":", label="truth")
        place.set_xlabel(label(p.name, p.unit))
        place.set_ylim(0.0, 1.08)
        place.set_yticks([])
    places[0].legend(frameon=False, fontsize=9)
    return axes


def plot_surrogate(estimator: Any, space: ParameterSpace, axes: Any = None) -> Any:
    """Draw the surrogate along each parameter through the estimate, a pair of axes each; return the axes.

    estimator: a `TargetVector` or `PaperBO` that has been told candidates. Drawn are mean and two standard deviations
    of its GPy model's outputs, four at most, and the candidates, which lie elsewhere in the other parameters.
    Raises NoEstimateError before any candidate has succeeded, ValueError for too few axes.
    """
    model, z = estimator.model, space.to_unit(estimator.estimate().theta)
    places, axes = _places(axes, len(space))
    for i, (place, p) in enumerate(zip(places, space, strict=False)):
        Z = np.tile(z, (_N, 1))
        Z[:, i] = np.linspace(0.0, 1.0, _N)
        x = space.from_unit(Z)[:, i]
        mean, variance = model.predict(Z)
        spread = 2.0 * np.sqrt(np.broadcast_to(variance, mean.shape))
        tidy(place)
        told = space.from_unit(np.asarray(model.X))[:, i]
        for k, (colour, dashes) in enumerate(RUNS[: min(mean.shape[1], _MOST_OUTPUTS)]):
            y, half = mean[:, k], spread[:, k]
            place.plot(x, y, color=colour, linestyle=(0, dashes) if dashes else "-")
            place.fill_between(x, y - half, y + half, color=colour, alpha=0.12, linewidth=0)
            place.plot(told, np.asarray(model.Y)[:, k], ".", color=colour, markersize=4)
        place.axvline(float(space.from_unit(z)[i]), color=BLACK, linewidth=0.8, linestyle=":")
        place.set_xlabel(label(p.name, p.unit))
        if p.scale == "log":
            place.set_xscale("log")
    places[0].set_ylabel("component of the residual, scaled")
    return axes


def _content(
    of: Run | Estimate, space: ParameterSpace | None
) -> tuple[Vector, Vector, Sequence[bool], Vector | None, ParameterSpace]:
    """Return estimate, standard deviations, which are known (d,), the truth if it is, and the space."""
    if isinstance(of, Run):
        last = of.final_estimate
        if last is None:
            raise ValueError(f"nothing was estimated in {of!r}.")
        truth = np.array([p["true"] for p in of.parameters_at(last.t)])
        return np.array(last.values), np.array(last.std), last.is_identifiable, truth, of.scenario.estimation.space
    if space is None:
        raise ValueError("an estimate needs its ParameterSpace: plot_belief(estimate, space).")
    return of.theta, of.std, of.is_identifiable, None, space


def _places(axes: Any, n: int) -> tuple[list[Axes], Any]:
    """Return n axes to draw on, and what to return: those given, or those of a new figure. Raises ValueError."""
    if axes is None:
        from matplotlib import pyplot  # only here: it chooses a backend for the whole process

        _, axes = pyplot.subplots(1, n, squeeze=False, figsize=(2.6 * n + 0.6, 2.6), layout="constrained")
        axes = axes[0, :] if n > 1 else axes[0, 0]
    places: list[Axes] = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(places) < n:
        raise ValueError(f"{n} parameters need as many axes, got {len(places)}.")
    return places, axes
