"""Checks of a scenario's filter against its steps, its noise and the plant: see `derivative_filter`."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Final

import numpy as np

from estimator import Vector
from estimator.differences import central_differences

from ..findings import Finding, warning
from ..objectives.model import opened_model
from ..sampling.derivative_filter import Kernel, derivative_noise, kernel_of
from ..scenarios.scenario import Scenario
from ..system.plant import Plant
from ..variable_name import VariableName
from .check_wiring import MOST_LISTED, Components, output_refusal

_LITTLE: Final = 0.5  # of the noise of a plain difference
_SHARE: Final = 0.3  # of the derivative's noise: with more the residual's variance is 9 % larger than judged
_FEW: Final = 5  # samples an episode: the first may have a jump in its midst, and others are to tell parameters apart
_LONG: Final = 2.0  # radians or time constants that the plant goes through under the filter

_WHERE: Final = "sampling.filter"


def check_filter(scenario: Scenario, components: Components) -> Iterator[Finding]:
    """Yield states that cannot be read, a filter too long for the run, or one that hardly smooths."""
    settings, plant = scenario.sampling.filter, components.get(scenario.plant)
    if settings is None or plant is None:
        return
    for reference in scenario.sampling.states:
        component, name = reference.parts
        problem = output_refusal(plant, name) if component == scenario.plant else f"no state of {scenario.plant}"
        if problem:
            yield Finding(f'sampling.states."{reference}"', problem)
    without = [state for state in plant.derivatives if state not in plant.outputs]
    for state in without[:MOST_LISTED]:
        yield warning("sampling", f"the state '{state}' is no output: the model is called without it")
    if len(without) > MOST_LISTED:
        yield warning("sampling", f"{len(without) - MOST_LISTED} more states are no outputs")
    kernel = kernel_of(settings, scenario.scenario.macro_step)
    if len(kernel.weights) >= scenario.scenario.n_steps:
        yield Finding(_WHERE, f"it needs {len(kernel.weights) + 1} points, and the run ends before that")
    difference = np.sqrt(2.0) / kernel.macro_step
    if kernel.noise_gain > _LITTLE * difference:
        share = kernel.noise_gain / difference
        yield warning(_WHERE, f"it hardly smooths: {share:.0%} of the noise of a plain difference remains")
    every, loop = settings.every or kernel.independent_after, scenario.estimation
    n_samples = loop.budget // (loop.evaluations_per_step * every)
    if n_samples < _FEW and not loop.trigger.is_endless:
        episode = f"an episode of {loop.budget} evaluations, {loop.evaluations_per_step} per macro step"
        yield warning(
            "estimation.budget", f"{episode}, sees {n_samples} samples, as one is produced every {every} points"
        )
    if settings.every and settings.every < kernel.independent_after:
        text = f"samples every {settings.every} points share noise, up to {kernel.independent_after} points apart"
        yield warning(f"{_WHERE}.every", f"{text}: standard deviations come out too small")


def check_filtered_model(scenario: Scenario, plant: Plant, x: Vector, theta: Vector) -> Iterator[Finding]:
    """Yield a filter too long for the plant, or too much noise on the states, by the model's slopes at x (n,)."""
    settings = scenario.sampling.filter
    if settings is None:
        return
    kernel = kernel_of(settings, scenario.scenario.macro_step)
    slopes = _slopes(scenario, plant, x, theta)
    if not np.all(np.isfinite(slopes)):
        return
    yield from _long(kernel, slopes)
    states = [scenario.sampling.states.get(VariableName(f"{plant.name}.{name}")) for name in plant.states]
    sigma = np.array([s.noise if s else 0.0 for s in states]) * float(np.linalg.norm(kernel.mean))
    of_states = np.linalg.norm(slopes[list(plant.channels)] * sigma, axis=1)
    judged = derivative_noise(scenario.sampling, scenario.scenario.macro_step)
    for name, own, more in zip(scenario.sampling.derivatives, judged, of_states.tolist(), strict=True):
        if more > _SHARE * own:
            text = f"through the model the states' noise adds {more:.3g} to the residual's {own:.3g}"
            yield warning(
                f'sampling.derivatives."{name}"', f"{text} at the start: give noise = {np.hypot(own, more):.3g}"
            )


def _long(kernel: Kernel, slopes: Vector) -> Iterator[Finding]:
    fastest = float(np.abs(np.linalg.eigvals(slopes)).max())
    length = len(kernel.weights) * kernel.macro_step
    if fastest * length > _LONG:
        text = f"it averages over {length:.3g} s, and a time constant of the plant is {1 / fastest:.3g} s at the start"
        yield warning(_WHERE, f"{text}: its output is late, and biased where the plant is not linear")


def _slopes(scenario: Scenario, plant: Plant, x: Vector, theta: Vector) -> Vector:
    """Return df/dx (n, n) at x by central differences; NaN where the model has no value."""
    u = tuple(plant.inputs.values())
    parameters = scenario.estimation.space.named(theta)
    steps = 1e-6 * np.maximum(1.0, np.abs(x))
    with opened_model(scenario, plant) as model, suppress(ArithmeticError, ValueError):
        return central_differences(lambda at: model(tuple(at.tolist()), u, **parameters), x, steps)
    return np.full((len(x), len(x)), np.nan)
