"""The paper's illustration of Bayesian optimisation in one dimension.

Khan and Chatterjee (2020), figure 1: unknown function, posterior, two-sigma envelope, observations, next sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.bayesian.acquisition import expected_improvement
from estimator.bayesian.surrogate import MaternBounds, ScalarSurrogate
from estimator.space import Vector

from ..plots.canvas import new_figure, save_png, tidy, top_legend
from ..plots.palette import BLACK, BLUE, GREEN, GREY, PURPLE, SKY, VERMILION, YELLOW

NOISE: Final = 0.02
"""Standard deviation of the noise on each observation."""
N_INITIAL: Final = 3
"""Number of random initial observations, one in each third of the interval."""
LENGTHSCALE_BOUNDS: Final = (0.1, 0.5)
"""Bounds of the length scale of the surrogate's Matern kernel, on the unit interval."""
_GRID: Final = np.linspace(0.0, 1.0, 501)


def unknown(x: Vector) -> Vector:
    """Return the function to minimise on [0, 1]: a global minimum at 0.242 and a local one at 0.868."""
    return np.cos(10.0 * x + 0.6) + 1.2 * (x - 0.3)


@dataclass(frozen=True)
class Stage:
    """Posterior after n observations, on a grid of m points."""

    x: Vector
    """Points observed (n,), in order."""
    y: Vector
    """Observations (n,), with noise."""
    mean: Vector
    """Posterior mean (m,)."""
    std: Vector
    """Posterior standard deviation (m,)."""
    improvement: Vector
    """Expected improvement (m,)."""

    @property
    def next_place(self) -> float:
        """Point of largest expected improvement."""
        return float(_GRID[int(np.argmax(self.improvement))])

    @property
    def best_place(self) -> float:
        """Point of the least observation."""
        return float(self.x[int(np.argmin(self.y))])


def optimise(seed: int = 0, n_evaluations: int = 8) -> list[Stage]:
    """Return the stages of Bayesian optimisation of `unknown`, from the initial design to n_evaluations observations.

    Raises ValueError for fewer evaluations than the initial design has.
    """
    if n_evaluations < N_INITIAL:
        raise ValueError(f"n_evaluations must be at least {N_INITIAL}, the initial design, got {n_evaluations}.")
    rng = np.random.default_rng(seed)
    x = (rng.permutation(N_INITIAL) + rng.random(N_INITIAL)) / N_INITIAL
    y = unknown(x) + NOISE * rng.standard_normal(N_INITIAL)
    stages = [_stage(x, y)]
    while len(stages[-1].x) < n_evaluations:
        place = np.array([stages[-1].next_place])
        x = np.append(x, place)
        y = np.append(y, unknown(place) + NOISE * rng.standard_normal(1))
        stages.append(_stage(x, y))
    return stages


def global_minimum() -> tuple[float, float]:
    """Return point and value of the minimum of `unknown` on the grid."""
    values = unknown(_GRID)
    best = int(np.argmin(values))
    return float(_GRID[best]), float(values[best])


def illustrate(path: Path, seed: int = 0, n_evaluations: int = 8) -> Path:
    """Draw the illustration into a PNG file; return its path.

    Raises ValueError for too few evaluations, FolderError where the file cannot be written.
    """
    return save_png(draw_illustration(optimise(seed, n_evaluations)), path)


def draw_illustration(stages: Sequence[Stage]) -> Figure:
    """Draw posterior and expected improvement of the first stage, one half way and the last, side by side."""
    chosen = [stages[k] for k in sorted({0, (len(stages) - 1) // 2, len(stages) - 1})]
    figure = new_figure(0.6 + 3.4 * len(chosen), 4.6)
    grid: Any = figure.subplots(
        2, len(chosen), sharex=True, sharey="row", squeeze=False, gridspec_kw={"height_ratios": [3, 1]}
    )
    for stage, above, below in zip(chosen, *grid, strict=True):
        _draw_belief(above, stage)
        _draw_acquisition(below, stage)
    grid[0, 0].set_ylabel("objective")
    grid[1, 0].set_ylabel("EI")
    handles = [pair for axes in grid[:, 0] for pair in zip(*axes.get_legend_handles_labels(), strict=True)]
    top_legend(figure, {text: handle for handle, text in handles}, n_columns=7)
    return figure


def _draw_belief(axes: Axes, stage: Stage) -> None:
    tidy(axes)
    low, high = stage.mean - 2.0 * stage.std, stage.mean + 2.0 * stage.std
    axes.fill_between(_GRID, low, high, color=SKY, alpha=0.35, linewidth=0, label=r"mean ± 2$\sigma$")
    axes.plot(_GRID, unknown(_GRID), "--", color=VERMILION, linewidth=1.4, label="unknown function")
    axes.plot(_GRID, stage.mean, color=GREEN, linewidth=1.5, label="posterior mean")
    axes.plot(
        *global_minimum(), "o", color=YELLOW, markeredgecolor=BLACK, markersize=11, linestyle="", label="global minimum"
    )
    axes.plot(
        stage.x, stage.y, "+", color=BLUE, markersize=10, markeredgewidth=2.0, linestyle="", label="observed",
        clip_on=False,
    )  # fmt: skip
    axes.set_title(f"{len(stage.x)} evaluations", fontsize=10)


def _draw_acquisition(axes: Axes, stage: Stage) -> None:
    tidy(axes)
    axes.fill_between(_GRID, stage.improvement, color=PURPLE, alpha=0.25, linewidth=0)
    axes.plot(_GRID, stage.improvement, color=PURPLE, linewidth=1.4, label="expected improvement")
    axes.plot(
        stage.next_place, float(np.max(stage.improvement)), "s", color=GREY, markeredgecolor=BLACK, markersize=8,
        label="next sample", clip_on=False,
    )  # fmt: skip
    axes.set_xlabel("x")
    axes.set_xlim(0.0, 1.0)


def _stage(x: Vector, y: Vector) -> Stage:
    # From so few observations the likelihood alone would take all for noise.
    noise = NOISE**2 / float(np.var(y))
    surrogate = ScalarSurrogate(1, MaternBounds(noise=(noise, noise), lengthscale=LENGTHSCALE_BOUNDS))
    surrogate.fit(x[:, None], y, max_iterations=50)
    mean, variance = surrogate.condition(x[:, None], y).predict(_GRID[:, None])
    improvement = expected_improvement(mean, variance, float(y.min()))
    return Stage(x, y, mean, np.sqrt(variance), improvement)
