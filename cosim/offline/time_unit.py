"""Check that a log's time stamps are in the unit that they are taken for, by the steps and the span of the FMU."""

from collections.abc import Mapping, Sequence
from math import log
from typing import Final

import numpy as np

from ..fmi.component import Component
from ..unit_text import understood
from ..units import conversion
from .log_windows import LogWindow
from .logs import LogError

MOST_STEPS: Final = 10_000_000
"""Communication steps of one roll-out, which takes minutes."""
FAR: Final = 100.0
"""Ratio of the rows' distance to the step of the FMU's experiment from which on something is wrong."""
FAR_SPAN: Final = 500.0
"""Ratio of spans, for an FMU that declares no step: a log is often longer than an experiment."""
_LONGER: Final = 1.001
"""Ratio of a step to the rows' distance that is more than rounding."""
_PER_SECOND: Final[Mapping[str, float]] = {
    "s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "min": 1 / 60.0, "h": 1 / 3600.0, "d": 1 / 86400.0,
}  # fmt: skip


def check_time(windows: Sequence[LogWindow], component: Component, step: float | None, is_stated: bool) -> None:
    """Raise LogError where the FMU would have to take far too many steps, or far longer or shorter ones than its own.

    step: the communication step asked for [s]; is_stated: the user has said in which unit the time stamps are, and
    only the number of steps counts.
    """
    for window in windows:
        span = float(window.time[-1] - window.time[0])
        if step is not None and span / step > MOST_STEPS:
            n = f"{span / step:.2g} steps of {step:g} s"
            raise LogError(f"{window.name}: its {span:g} s are {n}; at most {MOST_STEPS:g} are simulated.")
        if not is_stated and (text := _misfit(window, component)):
            raise LogError(f"{window.name}: {text}")


def passed_over(windows: Sequence[LogWindow], step: float | None) -> list[str]:
    """Return a warning for each window whose inputs change more often than the FMU would be stepped, every `step` s."""
    found: list[str] = []
    for window in windows:
        distance = float(np.median(np.diff(window.time)))
        if step is not None and step > distance * _LONGER and window.inputs.shape[1]:
            found.append(
                f"{window.name}: a --step of {step:g} s passes over inputs, which are {distance:g} s apart: "
                "estimates may be biased."
            )
    return found


def _misfit(window: LogWindow, component: Component) -> str | None:
    """Return how a log does not fit the FMU's default experiment, and the unit that it may be in; None if it fits."""
    experiment, name = component.experiment, component.fmu.name
    step = experiment.get("step_size", 0.0)
    span = experiment.get("stop_time", 0.0) - experiment.get("start_time", 0.0)
    if step > 0.0:
        own, far = float(np.median(np.diff(window.time))), FAR
        what, of, expected = "rows are", "apart, and its step is", step
    elif span > 0.0:
        own, far = float(window.time[-1] - window.time[0]), FAR_SPAN
        what, of, expected = "it is", "long, and its experiment", span
    else:
        return None
    ratio = own / expected
    if 1.0 / far < ratio < far:
        return None
    text = f"{what} {own:g} s {of} {expected:g} s".replace("its", f"{name}'s", 1)
    taken = window.time_unit
    ratio *= conversion(understood("s"), understood(taken)).factor  # as if the stamps were in seconds
    unit = min(_PER_SECOND.keys() - {taken}, key=lambda u: (abs(log(ratio / _PER_SECOND[u])), u))
    return f"{text}: is its time in {unit}? Give --time-unit {unit}, or --time-unit {taken} where it is right."
