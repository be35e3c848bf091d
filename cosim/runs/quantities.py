"""Quantities of a run that pictures and reports show: names, units, inputs, error norm, bands of uncertainty."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final, NamedTuple

import numpy as np

from estimator import METHODS

from ..errors import CosimError
from ..fmi.component import Component, read_component
from ..objectives.choice import chosen
from ..system.fmu_cache import component_path
from ..variable_name import VariableName
from .recorded_events import RecordedEvent
from .result import Run, Series

BASELINES: Final = ("none", "true")
"""Estimators that a run is compared with."""


def short_names(references: Sequence[str]) -> list[str]:
    """Return variable names without their component, unless two of them would be the same."""
    short = [VariableName(r).variable for r in references]
    return short if len(set(short)) == len(short) else list(references)


def inputs_of(run: Run) -> dict[str, str]:
    """Return the column of each connected input of the plant, by the input's name: what the controller did, u."""
    found: dict[str, str] = {}
    for target, source in run.scenario.connections.items():
        component, variable = target.parts
        column = next((c for c in (f"held.{target}", str(source)) if c in run.series), None)
        if component == run.plant.name and column is not None:
            found[variable] = column
    return found


def units_of(run: Run) -> dict[str, str]:
    """Return the unit of each column, as far as scenario and FMUs declare one.

    The FMUs of a stranger's run are not looked for: its manifest may name any file.
    """
    units = {"time": "s"}
    for p in run.scenario.estimation.parameters:
        units |= {run.scenario.held_column(p): p.unit, run.scenario.true_reference(p): p.unit}
    if run.scenario.origin.stranger:
        return units
    for name, settings in run.scenario.components.items():
        with suppress(CosimError):  # a missing FMU
            units = _declared(run, name, read_component(component_path(settings, run.scenario.folder))) | units
    return units


def _declared(run: Run, component: str, found: Component) -> dict[str, str]:
    units: dict[str, str] = {}
    for column in run.series:
        for prefix in ("sampled.", "held.", ""):
            variable = column.removeprefix(f"{prefix}{component}.")
            if variable != column and variable in found.variables and (unit := found.unit(variable)):
                units[column] = unit.name
                break
    return units


def trigger_threshold(run: Run) -> float | None:
    """Return the tracking error [unit of the tracked outputs] that triggers an episode in this run, or None."""
    estimation = run.scenario.estimation
    if run.estimator not in METHODS:
        return estimation.trigger.tracking_error  # a user's own is not loaded
    loop = estimation.loop(run.estimator, by_sample=chosen(run.scenario).kind == "derivative")
    return loop.trigger.tracking_error


def norm(errors: Sequence[Series]) -> Series:
    """Return the Euclidean norm (n,) over the tracked outputs; scaled first, so that huge values do not overflow."""
    table = np.abs(np.array(errors))
    largest = np.max(table, axis=0)
    scale = np.where(np.isfinite(largest) & (largest > 0.0), largest, 1.0)
    return scale * np.sqrt(np.sum((table / scale) ** 2, axis=0))


_RETURNS: Final = ("revert", "undo")
"""Kinds of events by which earlier parameters return."""


class Band(NamedTuple):
    """Band of two standard deviations about each value written, until the next."""

    t: Series
    """Times of the writes, and the end of the run [s] (n,)."""
    low: Series
    """Lower edge (n,), within the bounds of the search."""
    high: Series
    """Upper edge (n,)."""


def uncertainty_band(run: Run, name: str, events: Sequence[RecordedEvent]) -> Band | None:
    """Return the band of a run's parameter, on a log scale a factor; None where no write has a standard deviation.

    It has no width where earlier parameters are in force again.
    """
    i, p = next((k, p) for k, p in enumerate(run.scenario.estimation.parameters) if p.name == name)
    writes = [e for e in events if e.get("kind") in ("write", *_RETURNS)]
    theta, std = event_column(writes, "theta", i), event_column(writes, "std", i)
    if not np.any(np.isfinite(theta + std)):
        return None
    std = np.where([e.get("kind") in _RETURNS for e in writes], 0.0, std)
    if p.scale == "log":
        factor = np.exp(np.minimum(2.0 * std / np.maximum(theta, p.lower), 50.0))
        low, high = theta / factor, theta * factor
    else:
        low, high = theta - 2.0 * std, theta + 2.0 * std
    at = [float(e["t"]) for e in writes]
    times = np.array([*at, max(float(run.time[-1]), at[-1])])  # of a run that goes on, rows may be behind events
    below, above = (np.clip(np.append(edge, edge[-1]), p.lower, p.upper) for edge in (low, high))
    return Band(times, below, above)


def event_column(events: Sequence[RecordedEvent], key: str, i: int) -> Series:
    """Return entry i of a list in each event (n,), NaN where it is absent or null."""
    lists = [e.get(key) for e in events]
    entries = (values[i] if isinstance(values, list) and i < len(values) else None for values in lists)
    return np.array([v if isinstance(v, int | float) else np.nan for v in entries], dtype=float)


def disturbance_sizes(run: Run, events: Sequence[RecordedEvent]) -> dict[str, Mapping[float, float]]:
    """Return the known size of the disturbance by channel, from each time [s] on that it changes.

    One that is over when it is named is known for a macro step.
    """
    sizes: dict[str, dict[float, float]] = {}
    for event in events:
        size = event.get("size")
        if event.get("kind") != "disturbance" or not isinstance(size, dict):
            continue
        for channel in {*sizes, *size}:
            begin = {float(run.time[0]): 0.0} if len(run.time) else {}
            value = size.get(channel, 0.0)
            of, t = sizes.setdefault(channel, begin), float(event["t"])
            before = [*of.values()][-1] if of else 0.0
            of[t] = value if isinstance(value, int | float) else np.nan
            if not event.get("is_known", True):
                of[t + run.scenario.scenario.macro_step] = before
    return {channel: {**of, float(run.time[-1]): [*of.values()][-1]} for channel, of in sizes.items() if len(run.time)}
