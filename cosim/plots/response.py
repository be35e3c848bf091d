"""Figure of an episode's search: residual over two parameters, and the points where it was evaluated."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from estimator import DerivativeResidual, Sample, Vector

from ..errors import CosimError
from ..objectives.choice import chosen
from ..objectives.model import opened_model
from ..runs.recorded_events import RecordedEvent
from ..runs.result import Run
from ..sampling.derivative_filter import derivative_noise
from ..sampling.sampler import recorded_samples
from .canvas import label, new_figure, set_log, top_legend
from .palette import BLUE, GREEN, VERMILION
from .panels import title_of

_N_GRID: Final = 60
"""Number of grid points for each parameter."""
_N_SAMPLES: Final = 8
"""Number of samples, spread over the episode: the model is called for each of them at each grid point."""


def draw_response(run: Run, events: Sequence[RecordedEvent]) -> Figure | None:
    """Draw the response surface of the first episode; return None without two parameters, an episode or a model."""
    episode = _first_episode(events)
    if chosen(run.scenario).kind != "derivative":
        return None
    if len(run.scenario.estimation.parameters) != 2 or len(episode) < 2:
        return None
    samples = _samples(run, float(episode[0]["t"]), float(episode[-1]["t"]))
    with suppress(CosimError):  # the model may be gone
        return _draw(run, samples, episode) if samples else None
    return None


def _first_episode(events: Sequence[RecordedEvent]) -> list[RecordedEvent]:
    """Return the events from the first trigger to the end of its episode or of the record."""
    episode: list[RecordedEvent] = []
    for event in events:
        if episode or event.get("kind") == "trigger":
            episode.append(event)
        if event.get("kind") == "end":
            break
    return episode


def _samples(run: Run, begin: float, end: float) -> list[Sample]:
    """Return the recorded samples between two times [s]; none if the record lacks a column."""
    rows = np.flatnonzero((run.time >= begin - 1e-9) & (run.time <= end + 1e-9))
    if not len(rows):
        return []
    with suppress(KeyError):
        samples = [s for s in recorded_samples(run.scenario, run.plant, run.series, rows.tolist()) if s is not None]
        some = np.unique(np.linspace(0, len(samples) - 1, _N_SAMPLES).round().astype(int)) if samples else ()
        return [s for s in (samples[i] for i in some) if np.all(np.isfinite([*s.x, *s.u, *s.xdot]))]
    return []


def response_surface(run: Run, samples: Sequence[Sample]) -> tuple[Vector, Vector, Vector]:
    """Return values of both parameters and log10 of the residual's root mean square (n, n), in standard deviations."""
    scenario = run.scenario
    space = scenario.estimation.space
    noise = derivative_noise(scenario.sampling, scenario.scenario.macro_step)
    z = np.linspace(0.0, 1.0, _N_GRID)
    thetas = space.from_unit(np.stack(np.meshgrid(z, z), axis=-1))
    mean_square = np.full((_N_GRID, _N_GRID), np.nan)
    with opened_model(scenario, run.plant) as model:
        residual = DerivativeResidual(model, space, run.plant.channels, noise)
        for place in np.ndindex(mean_square.shape):
            with suppress(Exception):  # whatever a user's model raises: no value there
                r = np.array([residual(thetas[place], sample) for sample in samples])
                mean_square[place] = np.mean(r * r)
    usable = np.isfinite(mean_square)
    level = 0.5 * np.log10(np.maximum(np.where(usable, mean_square, 1.0), 1e-12))
    return thetas[0, :, 0], thetas[:, 0, 1], np.where(usable, level, np.nan)


def _draw(run: Run, samples: Sequence[Sample], episode: Sequence[RecordedEvent]) -> Figure | None:
    first, second, level = response_surface(run, samples)
    if np.sum(np.isfinite(level)) < 2 or np.nanmax(level) - np.nanmin(level) < 1e-9:
        return None
    figure = new_figure(6.6, 5.4)
    axes = figure.subplots()
    steps = MaxNLocator(12, steps=(1, 2, 5, 10)).tick_values(np.nanmin(level), np.nanmax(level))
    filled = axes.contourf(first, second, np.ma.masked_invalid(level), levels=list(steps), cmap="Greys", alpha=0.6)
    figure.colorbar(filled, ax=axes, label=r"$\log_{10}$ rms residual [standard deviations of the noise]")
    _scale(axes, run)
    candidates = [c for e in episode if e.get("kind") == "candidate" and _is_finite(c := e.get("theta"))]
    if candidates:
        x, y = np.array(candidates, dtype=float).T
        dots = axes.scatter(
            x, y, c=np.arange(1, len(x) + 1), cmap="plasma", s=32, edgecolors="black", linewidths=0.5, zorder=3,
            label="candidates", clip_on=False,
        )  # fmt: skip
        figure.colorbar(
            dots, ax=axes, label="evaluation", location="bottom", aspect=40, shrink=0.8, ticks=MaxNLocator(integer=True)
        )
    for text, theta, style in _marks(run, episode):
        axes.plot(*theta, linestyle="", label=text, clip_on=False, **style)
    top_legend(figure, {text: h for h, text in zip(*axes.get_legend_handles_labels(), strict=True)}, n_columns=4)
    axes.set_title(f"{title_of(run)}; samples of t = {samples[0].t:.4g} to {samples[-1].t:.4g} s", fontsize=9)
    return figure


def _scale(axes: Axes, run: Run) -> None:
    """Set both axes over the bounds, on the scale of the search."""
    a, b = run.scenario.estimation.parameters
    axes.set_xlabel(label(a.name, a.unit))
    axes.set_ylabel(label(b.name, b.unit))
    axes.set_xlim(a.lower, a.upper)
    axes.set_ylim(b.lower, b.upper)
    if a.scale == "log":
        set_log(axes, "x", (a.lower, a.upper), margin=0.0)
    if b.scale == "log":
        set_log(axes, "y", (b.lower, b.upper), margin=0.0)


def _marks(run: Run, episode: Sequence[RecordedEvent]) -> Iterator[tuple[str, list[float], dict[str, Any]]]:
    """Yield text, position and style of the marks: start and end of the episode, and the true values."""
    begin, end = (int(np.searchsorted(run.time, float(e["t"]) - 1e-9)) for e in (episode[0], episode[-1]))
    end = min(end, len(run.time) - 1)
    hollow = {"markerfacecolor": "none", "markeredgewidth": 2.0, "zorder": 4}
    marks = [
        ("start", run.estimates, max(begin - 1, 0), {"marker": "s", "markersize": 11, "color": BLUE} | hollow),
        ("truth", run.true_parameters, end, {"marker": "*", "markersize": 22, "color": GREEN, "zorder": 2.5}),
        ("estimate", run.estimates, end, {"marker": "o", "markersize": 15, "color": VERMILION} | hollow),
    ]  # fmt: skip
    for text, values, k, style in marks:
        theta = [float(series[k]) for series in values.values()]
        if _is_finite(theta):
            yield text, theta, style


def _is_finite(theta: Any) -> bool:
    return isinstance(theta, list) and all(isinstance(v, int | float) and np.isfinite(v) for v in theta)
